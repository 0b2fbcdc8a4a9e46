//! No client of the control socket can delay the loop or other clients.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use scanloop_tests::{TestSystem, pause, printed};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Every connection is closed within this time: one second of the socket, and what a busy machine adds.
const CLOSED_LIMIT: Duration = Duration::from_secs(8);

/// A connection to the control socket as any client has it.
fn connect(system: &TestSystem) -> UnixStream {
    let stream = UnixStream::connect(system.domain().directory().join("control.sock")).unwrap();
    stream.set_read_timeout(Some(CLOSED_LIMIT)).unwrap();
    stream
}

/// Ends the run and checks that it lost no scan.
fn end(mut system: TestSystem) {
    system.signal(system.orchestrator(), Signal::INT);
    assert_eq!(system.wait().code(), Some(1));
    let scans = system.report().scans;
    assert_eq!((scans.lost, scans.unaccounted), (0, 0), "{scans:?}");
    system.assert_nothing_left();
}

/// A value of /proc/PID/status [KiB].
fn kib(system: &TestSystem, key: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", system.orchestrator())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap();
    line.trim_start_matches(':').split_whitespace().next().unwrap().parse().unwrap()
}

/// Sends a byte every 100 ms until the connection is closed; returns how long that took.
fn dribble(mut client: UnixStream) -> Duration {
    let started = Instant::now();
    while client.write_all(b"x").is_ok() && started.elapsed() < CLOSED_LIMIT {
        let sent = Instant::now();
        while sent.elapsed() < Duration::from_millis(100) {
            pause();
        }
    }
    started.elapsed()
}

#[test]
fn a_client_that_sends_a_byte_now_and_then_holds_up_nothing_and_is_closed() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let clients: Vec<_> = (0..4).map(|_| connect(&system)).collect();
        let clients: Vec<_> =
            clients.into_iter().map(|client| std::thread::spawn(|| dribble(client))).collect();
        while !clients.iter().all(std::thread::JoinHandle::is_finished) {
            let asked = Instant::now();
            assert!(system.status().is_some());
            assert!(asked.elapsed() < Duration::from_secs(2), "an answer took {:?}", asked.elapsed());
            pause();
        }
        for client in clients {
            let served = client.join().unwrap();
            assert!(served < CLOSED_LIMIT, "served for {served:?}");
        }
        end(system);
    });
}

#[test]
fn an_endless_line_is_cut_and_takes_no_memory() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let before_kib = kib(&system, "VmHWM");
        let mut client = connect(&system);
        let piece = [b'x'; 4096];
        let (started, mut taken) = (Instant::now(), 0);
        while client.write_all(&piece).is_ok() {
            taken += piece.len();
            // The limit of 64 KiB, and what the kernel holds for a socket.
            assert!(taken < 4 << 20 && started.elapsed() < CLOSED_LIMIT, "{taken} bytes were taken");
        }
        let mut answer = vec![0; 200];
        let count = client.read(&mut answer).unwrap();
        let answer = String::from_utf8_lossy(&answer[..count]).into_owned();
        assert!(answer.contains("longer than 65536 bytes"), "{answer}");
        let more_kib = kib(&system, "VmHWM") - before_kib;
        assert!(more_kib < 16 << 10, "{more_kib} KiB more");
        end(system);
    });
}

#[test]
fn many_idle_connections_stop_no_command_for_long() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let mut clients: Vec<_> = (0..40).map(|_| connect(&system)).collect();
        let started = Instant::now();
        assert_eq!(system.run(&["status"]).status.code(), Some(0));
        assert!(started.elapsed() < CLOSED_LIMIT, "{:?}", started.elapsed());
        let refused = clients.iter_mut().filter_map(|client| {
            let mut answer = String::new();
            client.read_to_string(&mut answer).unwrap();
            answer.contains("too many connections").then_some(())
        });
        assert!(refused.count() >= 40 - 16);
        end(system);
    });
}

#[test]
fn what_was_reported_as_failed_is_not_carried_out_later() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let (controller, orchestrator) = (system.pid(Role::Controller), system.orchestrator());
        for command in [
            &["restart", "controller"][..],
            &["set", "controller.cruise_mps=0.9", "--shadow-scans", "1", "--standby-scans", "1"],
        ] {
            system.signal(orchestrator, Signal::STOP);
            system.wait_until("it is suspended", |system| {
                printed(&system.run(&["status"])).contains("suspended")
            });
            let refused = system.run(command);
            system.signal(orchestrator, Signal::CONT);
            assert_eq!(refused.status.code(), Some(4), "{}", printed(&refused));
            assert!(printed(&refused).contains("was suspended by a signal"), "{}", printed(&refused));
            let scan = system.status().unwrap().scan;
            system.wait_until("forty scans", |system| {
                system.status().is_some_and(|status| status.scan > scan + 40)
            });
            assert_eq!(system.pid(Role::Controller), controller, "{command:?}: {}", system.stderr());
        }
        system.run(&["stop"]);
        system.wait();
        system.assert_nothing_left();
    });
}
