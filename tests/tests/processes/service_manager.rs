//! Messages to systemd and lines for its journal.

use scanloop_tests::machine::repeat_when_late;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use scanloop_tests::{DEADLINE, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// The next message to the service manager; panics when none comes.
fn next(socket: &UnixDatagram) -> String {
    let mut bytes = [0; 512];
    let length = socket.recv(&mut bytes).expect("a message of the orchestrator");
    String::from_utf8_lossy(&bytes[..length]).trim_end().to_owned()
}

/// Messages up to the first that `is_last` accepts.
fn messages_until(socket: &UnixDatagram, is_last: impl Fn(&str) -> bool) -> Vec<String> {
    let (started, mut messages) = (Instant::now(), Vec::new());
    loop {
        messages.push(next(socket));
        if messages.last().is_some_and(|message| is_last(message)) {
            return messages;
        }
        assert!(started.elapsed() < DEADLINE, "{messages:?}");
    }
}

#[test]
fn the_service_manager_is_notified_of_readiness_status_life_and_stop_also_after_an_adoption() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let path = system.folder().join("notify.sock");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let environment =
            [("NOTIFY_SOCKET", path.to_str().unwrap()), ("WATCHDOG_USEC", "300000"), ("WATCHDOG_PID", "")];
        system.launch(&["run", "--adopt-or-start", "--quiet", "--out", "out", "endless"], &environment);
        let before = messages_until(&socket, |message| message == "READY=1");
        assert!(!before.contains(&"STOPPING=1".to_owned()), "{before:?}");
        system.wait_until_driving();
        messages_until(&socket, |message| message == "WATCHDOG=1");
        let status =
            messages_until(&socket, |message| message.starts_with("STATUS=") && message.contains("m/s"))
                .pop()
                .unwrap();
        assert!(status.contains("goal") && status.contains("con"), "{status}");

        // A service that was killed is started again, and adopts the driving robot.
        let controller = system.pid(Role::Controller);
        system.kill_orchestrator();
        system.launch(&["run", "--adopt-or-start", "--quiet", "--out", "out", "endless"], &environment);
        messages_until(&socket, |message| message == "READY=1");
        assert_eq!(system.pid(Role::Controller), controller);
        // Its variables are not handed on: only the orchestrator may notify the manager.
        let inherited = std::fs::read(format!("/proc/{controller}/environ")).unwrap();
        assert!(!String::from_utf8_lossy(&inherited).contains("NOTIFY_SOCKET"));
        system.signal(system.orchestrator(), Signal::TERM);
        messages_until(&socket, |message| message == "STOPPING=1");
        assert_eq!(system.wait().code(), Some(1));
        system.assert_nothing_left();
    });
}

#[test]
fn lines_for_the_journal_have_a_priority_and_neither_colours_nor_progress() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let log = system.folder().join("stderr.txt");
        let file = std::fs::File::create(&log).unwrap().metadata().unwrap();
        let stream = format!("{}:{}", file.dev(), file.ino());
        system
            .launch(&["run", "--out", "out", "corridor", "--duration", "4"], &[("JOURNAL_STREAM", &stream)]);
        system.wait_until_driving();
        let pid = system.pid(Role::Controller);
        system.signal(pid, Signal::KILL);
        assert_eq!(system.wait().code(), Some(1));
        let text = system.stderr();
        assert!(
            text.lines().all(|line| line.starts_with('<') && line.as_bytes().get(2) == Some(&b'>')),
            "{text}"
        );
        assert!(
            text.lines().any(|line| line.starts_with("<4>controller (nmpc) ended: killed by signal 9")),
            "{text}"
        );
        assert!(text.lines().any(|line| line.starts_with("<5>outcome")), "{text}");
        assert!(!text.contains('\u{1b}') && !text.contains("rob\u{25cf}"), "{text}");
        system.assert_nothing_left();
    });
}

#[test]
fn systemd_finds_nothing_wrong_with_the_unit_file() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("../orchestrator/systemd/scanloop.service");
        let text = std::fs::read_to_string(unit).unwrap();
        let copy = system.folder().join("scanloop.service");
        std::fs::write(&copy, text.replace("/usr/local/bin/scanloop", EXECUTABLE)).unwrap();
        let Ok(output) = Command::new("systemd-analyze").arg("verify").arg(&copy).output() else {
            eprintln!("skipped: there is no systemd-analyze on this machine");
            return;
        };
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    });
}
