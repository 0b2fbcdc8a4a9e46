//! A robot behind a Player 3 server: driven, with a guard of its wheels, and with faults of the server.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::cell::RefCell;
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, TcpListener};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use driver::guard::Orders;
use driver::order::GuardOrder;
use emulator::{JudgedBy, Outcome, Scenario};
use player::PlayerConfig;
use player::client::{Client, ClientEvent};
use player::config::Delivery;
use runtime::{Bus, Observer};
use rustix::process::{Pid, Signal, kill_process};
use scanloop_tests::player_server::{PlayerServer, ReceivedCommand, ServerFault};
use scanloop_tests::{DEADLINE, TestSystem, pause};
use shared_types::{BEAMS, Role, Scan};
use urg::DeviceFault;
use vehicle::ScannerDescription;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
/// Scan period [ns].
const PERIOD_NS: u64 = 100_000_000;
/// The wheels are stopped after two periods without an order [ns].
const TIMEOUT_NS: u64 = 2 * PERIOD_NS;
/// More than a busy machine delays a process that is to act at once [ns].
const BUSY_NS: u64 = 150_000_000;
/// The order that drives in these tests: velocity and steering angle.
const DRIVE: [f64; 2] = [0.6, 0.0];

fn server(scenario: &str) -> PlayerServer {
    let scenario = Scenario::parse(Scenario::shipped(scenario).unwrap(), scenario).unwrap();
    PlayerServer::start(&scenario, PERIOD_NS, 0).unwrap()
}

fn start(config: &PlayerConfig) -> Client {
    Client::start(config, ScannerDescription::default(), TIMEOUT_NS, Path::new(EXECUTABLE), || {}).unwrap()
}

/// A connected client of a server, and all that it has reported.
struct Link {
    client: Client,
    orders: Option<Orders>,
    /// Texts of losses.
    lost: Vec<String>,
    /// Sweeps since the newest connection.
    sweeps: usize,
    server: PlayerServer,
}

impl Link {
    fn new(config: PlayerConfig) -> Self {
        let server = server("free");
        let config = PlayerConfig { port: server.port().into(), ..config };
        let client = start(&config);
        let (orders, _) = client.connected(DEADLINE.as_secs_f64()).unwrap();
        Self { client, orders: Some(orders), lost: Vec::new(), sweeps: 0, server }
    }

    /// Drives, with an order each period, until something holds.
    fn drive_until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        self.wait(what, Some(GuardOrder::Drive(DRIVE)), done);
    }

    /// Waits until something holds, and gives an order each period.
    fn wait(&mut self, what: &str, order: Option<GuardOrder>, done: impl Fn(&Self) -> bool) {
        let (started, mut ordered) = (Instant::now(), None::<Instant>);
        while !done(self) {
            assert!(started.elapsed() < DEADLINE, "{what}: not within {DEADLINE:?}: {:?}", self.lost);
            let is_due = ordered.is_none_or(|ordered| ordered.elapsed() >= Duration::from_nanos(PERIOD_NS));
            if let (Some(order), Some(orders), true) = (order, &self.orders, is_due) {
                let _ = orders.give(order);
                ordered = Some(Instant::now());
            }
            self.take();
            pause();
        }
    }

    fn take(&mut self) {
        while let Some(event) = self.client.next() {
            match event {
                ClientEvent::Connected(orders, _) => (self.orders, self.sweeps) = (Some(orders), 0),
                ClientEvent::Sweep { .. } => self.sweeps += 1,
                ClientEvent::Lost(lost) => {
                    self.orders = None;
                    self.lost.push(lost.to_string());
                }
                ClientEvent::State { .. } | ClientEvent::Scanner(_) => {}
            }
        }
    }

    /// Process id of the guard: the only child of this process that is one and guards this server.
    fn guard(&self) -> Pid {
        guards(self.server.port()).pop().expect("a guard")
    }
}

/// Guards that are connected to a port, by their standard output.
fn guards(port: u16) -> Vec<Pid> {
    let sockets = std::fs::read_to_string("/proc/net/tcp").unwrap();
    let remote = format!(":{port:04X}");
    let inodes: Vec<String> = sockets
        .lines()
        .filter_map(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            fields.get(2)?.ends_with(&remote).then(|| format!("socket:[{}]", fields[9]))
        })
        .collect();
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    processes
        .filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok())
        .filter(|pid| {
            let is_guard = std::fs::read(format!("/proc/{pid}/cmdline"))
                .is_ok_and(|line| line.windows(12).any(|text| text == b"player-guard"));
            let output = std::fs::read_link(format!("/proc/{pid}/fd/1"));
            is_guard && output.is_ok_and(|output| inodes.iter().any(|inode| output == Path::new(inode)))
        })
        .filter_map(Pid::from_raw)
        .collect()
}

/// Time from a moment to the first stop that the server received after it [ns].
fn stopped_after_ns(server: &PlayerServer, since_ns: u64) -> Option<u64> {
    let received = server.received();
    let stop = received
        .iter()
        .find(|(at_ns, what)| *at_ns >= since_ns && !matches!(what, ReceivedCommand::Drive(..)));
    stop.map(|(at_ns, _)| at_ns - since_ns)
}

fn last_drive_ns(server: &PlayerServer) -> u64 {
    let received = server.received();
    let drive = received.iter().rev().find(|(_, what)| matches!(what, ReceivedCommand::Drive(..)));
    drive.expect("a command to drive").0
}

#[test]
fn a_server_that_is_not_there_or_none_is_named() {
    repeat_when_late(|| {
        let message = |config: &PlayerConfig| {
            let (client, started) = (start(config), Instant::now());
            loop {
                assert!(started.elapsed() < DEADLINE, "no event");
                match client.next() {
                    Some(ClientEvent::Lost(lost)) => break lost.to_string(),
                    Some(event) => panic!("{event:?}"),
                    None => pause(),
                }
            }
        };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let port = u32::from(listener.local_addr().unwrap().port());
        let talker = std::thread::spawn(move || {
            for stream in listener.incoming().take(1).flatten() {
                let _ = (&stream).write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n");
                std::thread::park_timeout(Duration::from_millis(300));
            }
        });
        let local = PlayerConfig { port, ..PlayerConfig::default() };
        let no_player = message(&local);
        assert_eq!(
            no_player,
            format!("127.0.0.1:{port}: this is no Player 3 server: it sent `HTTP/1.1 400 Bad Request`")
        );
        talker.join().unwrap();
        let refused = message(&local);
        assert!(
            refused.starts_with(&format!("no Player server at 127.0.0.1:{port}: Connection refused")),
            "{refused}"
        );
        let unknown = message(&PlayerConfig { host: "not a host".to_owned(), ..local });
        assert!(unknown.starts_with("host `not a host` is unknown: "), "{unknown}");
    });
}

#[test]
fn the_guard_stops_the_wheels_after_a_silence_of_two_periods() {
    repeat_when_late(|| {
        let mut link = Link::new(PlayerConfig::default());
        link.drive_until("it drives", |link| link.server.speed_mps() > 0.3);
        link.wait("it stands", None, |link| link.server.speed_mps() == 0.0);
        let silent_ns = stopped_after_ns(&link.server, last_drive_ns(&link.server)).unwrap();
        assert!((TIMEOUT_NS - PERIOD_NS / 2..TIMEOUT_NS + BUSY_NS).contains(&silent_ns), "{silent_ns} ns");
        // The next order ends the block.
        link.drive_until("it drives again", |link| link.server.speed_mps() > 0.3);
        assert_eq!(link.lost, [""; 0]);
    });
}

/// Disturbs the guard while it drives; returns how long the server followed the last command before a stop [ns].
fn disturb_guard(signal: Signal) -> (Link, u64) {
    let mut link = Link::new(PlayerConfig::default());
    link.drive_until("it drives", |link| link.server.speed_mps() > 0.3);
    let (guard, since_ns) = (link.guard(), runtime::monotonic_ns());
    kill_process(guard, signal).unwrap();
    link.drive_until("the driver notices", |link| !link.lost.is_empty());
    link.wait("the wheels are stopped", None, |link| stopped_after_ns(&link.server, since_ns).is_some());
    let blind_ns = stopped_after_ns(&link.server, since_ns).unwrap();
    let received: Vec<_> =
        link.server.received().into_iter().filter(|(at_ns, _)| *at_ns >= since_ns).collect();
    let stops = received.iter().filter(|(_, what)| !matches!(what, ReceivedCommand::Drive(..))).take(2);
    let stops: Vec<ReceivedCommand> = stops.map(|(_, what)| *what).collect();
    assert_eq!(
        stops,
        [ReceivedCommand::Stop; 2],
        "both forms, before the connection is closed: {received:?}"
    );
    // With another guard it drives again.
    link.drive_until("it drives again", |link| link.orders.is_some() && link.server.speed_mps() > 0.3);
    assert_ne!(link.guard(), guard);
    (link, blind_ns)
}

#[test]
fn the_driver_stops_the_wheels_when_the_guard_is_killed_and_starts_another() {
    repeat_when_late(|| {
        let (link, blind_ns) = disturb_guard(Signal::KILL);
        assert_eq!(link.lost, ["the guard of the wheels has ended: the driver has stopped the wheels"]);
        assert!(blind_ns < BUSY_NS, "{blind_ns} ns");
    });
}

#[test]
fn the_driver_stops_the_wheels_when_the_guard_hangs_and_starts_another() {
    repeat_when_late(|| {
        let (link, blind_ns) = disturb_guard(Signal::STOP);
        assert!(
            link.lost[0].starts_with("the guard of the wheels has not answered for 2"),
            "{:?}",
            link.lost
        );
        assert!(blind_ns < TIMEOUT_NS + PERIOD_NS + BUSY_NS, "{blind_ns} ns");
    });
}

/// Switches a fault of the server on while the robot drives; returns the first text of the loss.
fn disturb_server(fault: ServerFault, config: PlayerConfig) -> String {
    let mut link = Link::new(config);
    link.drive_until("it drives", |link| link.server.speed_mps() > 0.3 && link.sweeps > 3);
    link.server.set_fault(fault);
    link.drive_until("the driver notices", |link| !link.lost.is_empty());
    link.wait("it stands", None, |link| link.server.speed_mps() == 0.0);
    link.server.set_fault(ServerFault::None);
    link.drive_until("it drives again", |link| link.server.speed_mps() > 0.3 && link.sweeps > 3);
    link.lost.swap_remove(0)
}

#[test]
fn a_server_that_falls_silent_is_left_and_the_wheels_are_stopped() {
    repeat_when_late(|| {
        for (fault, delivery) in [
            (ServerFault::Stalls, Delivery::Push),
            (ServerFault::Stalls, Delivery::Pull),
            (ServerFault::HalfSweep, Delivery::Push),
        ] {
            let lost =
                disturb_server(fault, PlayerConfig { delivery, silence_s: 0.3, ..PlayerConfig::default() });
            assert!(lost.starts_with("no data of the ") && lost.ends_with(" ms"), "{lost}");
        }
    });
}

#[test]
fn a_server_that_sends_garbage_is_left_and_the_wheels_are_stopped() {
    repeat_when_late(|| {
        let lost = disturb_server(ServerFault::Garbage, PlayerConfig::default());
        assert!(lost.contains("garbage in the stream: `\\xa5\\xa5"), "{lost}");
    });
}

#[test]
fn a_server_that_floods_is_left_and_the_wheels_are_stopped() {
    repeat_when_late(|| {
        let lost = disturb_server(ServerFault::Floods, PlayerConfig::default());
        assert!(lost.starts_with("the server floods: "), "{lost}");
    });
}

/// A system file for a server, with more keys of `[player]`.
fn system_file(system: &TestSystem, port: u16, more: &str) -> String {
    let text = include_str!("../../../examples/player/system.toml");
    let text = text.replace("port = 6665", &format!("port = {port}\ndelay_s = 0.0333\n{more}"));
    let path = system.folder().join("system.toml");
    std::fs::write(&path, text.replace("sweep_s = 0.0 ", "sweep_s = 0.0667 ")).unwrap();
    path.to_str().unwrap().to_owned()
}

/// Keys of `[player]` for the Hokuyo scanner of a server.
fn hokuyo(server: &PlayerServer) -> String {
    format!("scan = \"urg\"\nurg = \"{}\"", server.scanner())
}

/// What `status` shows of the robot's devices: state and reason.
fn device(system: &TestSystem) -> Option<(String, String)> {
    let robot = system.status()?.processes.into_iter().find(|process| process.role == Role::Robot)?;
    assert_eq!(robot.device.is_some(), robot.device_for_s.is_some());
    Some((robot.device?, robot.device_reason?))
}

fn shows(system: &TestSystem, state: &str, reason: &str) -> bool {
    device(system).is_some_and(|(its_state, its_reason)| its_state == state && its_reason.contains(reason))
}

/// Drives a scenario through the shipped orchestrator to its end.
fn drives(scenario: &str, more: impl Fn(&PlayerServer) -> String) {
    let server = server(scenario);
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system_file(&system, server.port(), &more(&server));
    system.start(&["--system", &file, scenario, "--record"]);
    system.wait_until("base and scanner run", |system| shows(system, "running", ""));
    assert_eq!(system.status().unwrap().judged_by, Some(JudgedBy::Estimate));
    let status = system.wait();
    let report = system.report();
    let truth = server.truth();
    assert_eq!((status.code(), report.outcome), (Some(0), Outcome::Reached), "{}", system.stderr());
    assert_eq!((truth.collided, report.scans.unaccounted), (0, 0), "{:?}", report.scans);
    assert_eq!(report.differences, [], "the scenario tells nothing about this robot");
    assert!(truth.goal_distance_m < 0.15 && truth.min_clearance_m > 0.05, "{truth:?}");
    // What the devices measured follows from no recorded input; all other stages are recomputed.
    let replay = system.run(&["replay", "out/recording.mcap", "--json"]);
    let found: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert_eq!((replay.status.code(), &found["identical"]), (Some(0), &found["compared"]), "{found}");
    let left_out = found["not_compared"].as_array().unwrap();
    assert!(left_out.len() == 1 && left_out[0]["with"].is_null(), "{found}");
    assert_eq!((&left_out[0]["role"], &left_out[0]["program"]), (&"robot".into(), &"player".into()));
    system.assert_nothing_left();
    assert!(guards(server.port()).is_empty());
}

#[test]
fn a_robot_behind_a_player_server_drives_the_corridor() {
    repeat_when_late(|| {
        drives("corridor", |_| String::new());
    });
}

#[test]
fn a_robot_behind_a_player_server_drives_past_two_obstacles_in_pull_mode_by_laser_and_yaw_rate() {
    repeat_when_late(|| {
        let keys = "delivery = \"pull\"\nscanner = \"laser\"\ncommand = \"velocity\"";
        drives("two-obstacles", |_| keys.to_owned());
    });
}

#[test]
fn a_base_at_the_server_and_a_hokuyo_scanner_drive_past_two_obstacles() {
    repeat_when_late(|| {
        drives("two-obstacles", hokuyo);
    });
}

/// Drives with a Hokuyo scanner, damages one scan, then all for a while; the run reaches its goal.
fn survives_damage(damage: DeviceFault, reason: &str) {
    let server = server("corridor");
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system_file(&system, server.port(), &hokuyo(&server));
    system.start(&["--system", &file, "corridor"]);
    let bus = Bus::open(&system.domain(), "test").unwrap();
    let (observer, scans) = (Observer::<Scan>::new(&bus).unwrap(), RefCell::new(Vec::new()));
    let poll = || _ = observer.poll(|scan| scans.borrow_mut().push(*scan)).unwrap();
    system.wait_until("it drives", |_| {
        poll();
        server.speed_mps() > 0.5
    });
    server.damage_scans(damage, 1);
    system.wait_until("a scan is damaged", |system| {
        poll();
        shows(system, "running", "damaged on the way")
    });
    let x_m = server.truth().x_m;
    system.wait_until("it drives on", |_| {
        poll();
        server.truth().x_m > x_m + 0.3 && server.speed_mps() > 0.5
    });
    let since_ns = runtime::monotonic_ns();
    server.damage_scans(damage, usize::MAX);
    system.wait_until("it stands", |_| {
        poll();
        server.speed_mps() == 0.0
    });
    let stopped_ns = stopped_after_ns(&server, since_ns).unwrap();
    // The first damaged scan comes within a period; three are tolerated.
    assert!(stopped_ns < 5 * PERIOD_NS + BUSY_NS, "{stopped_ns} ns");
    system.wait_until("the fault is shown", |system| shows(system, "fault", reason));
    server.damage_scans(damage, 0);
    system.wait_until("the scanner runs again", |system| {
        poll();
        shows(system, "running", "")
    });
    system.wait_until("it is near the goal", |_| {
        poll();
        server.truth().goal_distance_m < 2.0
    });
    let status = system.wait();
    assert_eq!((status.code(), system.report().outcome), (Some(0), Outcome::Reached), "{}", system.stderr());
    assert_eq!(server.truth().collided, 0);
    let scans = scans.into_inner();
    let (missing, whole): (Vec<&Scan>, Vec<&Scan>) = scans.iter().partition(|scan| scan.missing.is_set());
    assert!(
        !missing.is_empty() && missing.iter().all(|scan| scan.ranges() == [0; BEAMS]),
        "{}",
        missing.len()
    );
    let measured = server.measured();
    let is_as_measured = |scan: &&Scan| measured.iter().any(|ranges_mm| ranges_mm[..] == *scan.ranges());
    let others = whole.iter().filter(|scan| !is_as_measured(scan)).count();
    assert!(whole.len() > 30 && others == 0, "{others} of {} scans have other ranges", whole.len());
    drop((observer, bus));
    system.assert_nothing_left();
}

#[test]
fn scans_with_wrong_checksums_are_named_and_stop_the_wheels_if_they_last() {
    repeat_when_late(|| {
        survives_damage(DeviceFault::Checksum, "wrong checksum");
    });
}

#[test]
fn half_scans_are_named_and_stop_the_wheels_if_they_last() {
    repeat_when_late(|| {
        survives_damage(DeviceFault::HalfScan, "");
    });
}

#[test]
fn a_scanner_that_is_not_there_is_named_in_the_status() {
    repeat_when_late(|| {
        let server = server("free");
        let mut system = TestSystem::new(EXECUTABLE);
        let closed = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap();
        let file = system_file(&system, server.port(), &format!("scan = \"urg\"\nurg = \"{closed}\""));
        system.launch(&["run", "--quiet", "--out", "out", "--system", &file, "free"], &[]);
        system.wait_until("the fault is shown", |system| shows(system, "fault", "Connection refused"));
        let (_, reason) = device(&system).unwrap();
        assert!(reason.starts_with(&format!("scanner: {closed}: ")), "{reason}");
        let text = scanloop_tests::printed(&system.run(&["status"]));
        assert!(text.contains("device fault for ") && text.contains(&reason), "{text}");
        assert_eq!(server.speed_mps(), 0.0);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn the_run_goes_on_after_the_server_was_silent() {
    repeat_when_late(|| {
        let server = server("corridor");
        let mut system = TestSystem::new(EXECUTABLE);
        let file = system_file(&system, server.port(), "silence_s = 0.3");
        system.start(&["--system", &file, "corridor", "--set", "stop_final_s=60"]);
        system.wait_until("it drives", |_| server.truth().x_m > 1.0 && server.speed_mps() > 0.5);
        let silent_since_ns = runtime::monotonic_ns();
        server.set_fault(ServerFault::Stalls);
        system.wait_until("it stands", |_| server.speed_mps() == 0.0);
        let stopped_ns = stopped_after_ns(&server, silent_since_ns).unwrap();
        // The actuator blocks the wheels 1.5 periods after the last command.
        assert!(stopped_ns < 2 * PERIOD_NS + BUSY_NS, "{stopped_ns} ns");
        system.wait_until("the driver has left the server", |_| guards(server.port()).is_empty());
        system.wait_until("the fault is shown", |system| shows(system, "fault", "base: no data of the "));
        server.set_fault(ServerFault::None);
        system.wait_until("the base runs again", |system| shows(system, "running", ""));
        let status = system.wait();
        assert_eq!(
            (status.code(), system.report().outcome),
            (Some(0), Outcome::Reached),
            "{}",
            system.stderr()
        );
        let truth = server.truth();
        assert!(
            truth.goal_distance_m < 0.15 && truth.collided == 0,
            "what it slid is not forgotten: {truth:?}"
        );
    });
}

/// Drives 10 m with outages, each from a place on for a time [m, s]; the goal is reached by the truth.
fn survives_outages(watchdog_ns: Option<u64>, outages: &[(ServerFault, f64, u64)]) {
    let server = server("free");
    watchdog_ns.into_iter().for_each(|after_ns| server.set_watchdog(after_ns));
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system_file(&system, server.port(), "");
    system.start(&["--system", &file, "free", "--set", "stop_final_s=30"]);
    for (fault, from_m, for_ms) in outages {
        system.wait_until("it drives", |_| server.truth().x_m > *from_m && server.speed_mps() > 0.8);
        let until_ns = runtime::monotonic_ns() + for_ms * 1_000_000;
        server.set_fault(*fault);
        system.wait_until("the outage is over", |_| runtime::monotonic_ns() >= until_ns);
        server.set_fault(ServerFault::None);
    }
    let status = system.wait();
    assert_eq!((status.code(), system.report().outcome), (Some(0), Outcome::Reached), "{}", system.stderr());
    let truth = server.truth();
    assert!(truth.goal_distance_m < 0.15, "{truth:?}: {}", system.stderr());
    system.assert_nothing_left();
}

#[test]
fn after_outages_the_pose_is_where_the_robot_is_and_it_drives_on() {
    repeat_when_late(|| {
        // The robot has a watchdog of 0.3 s, and the driver forwards what comes late.
        let outages =
            [(ServerFault::Held, 1.0, 500), (ServerFault::Held, 3.0, 1_000), (ServerFault::Held, 5.5, 1_500)];
        survives_outages(Some(300_000_000), &outages);
    });
}

#[test]
fn after_outages_without_their_data_it_drives_on() {
    repeat_when_late(|| {
        let outages = [
            (ServerFault::Cut, 1.0, 300),
            (ServerFault::Cut, 2.5, 700),
            (ServerFault::Cut, 4.5, 1_300),
            (ServerFault::Cut, 6.5, 2_500),
        ];
        survives_outages(Some(300_000_000), &outages);
    });
}

#[test]
fn a_base_that_drives_on_for_more_than_a_metre_in_an_outage_has_not_jumped() {
    repeat_when_late(|| {
        // The wheels follow the last command, as those of Stage; the driver leaves the server after a second.
        survives_outages(None, &[(ServerFault::Cut, 2.0, 1_200), (ServerFault::Held, 5.0, 1_500)]);
    });
}

#[test]
fn a_second_driver_of_the_same_wheels_is_refused_and_the_first_drives_on() {
    repeat_when_late(|| {
        let server = server("free");
        let mut system = TestSystem::new(EXECUTABLE);
        let file = system_file(&system, server.port(), "");
        system.start(&["--system", &file, "free"]);
        system.wait_until("it drives", |_| server.speed_mps() > 0.5);
        let output = system.run(&["swap", "robot", "--to", "player"]);
        let message = scanloop_tests::printed(&output);
        assert_ne!(output.status.code(), Some(0), "{message}");
        assert!(message.contains("the wheels have one driver"), "{message}");
        assert!(server.received().iter().all(|(_, what)| *what != ReceivedCommand::Closed));
        let x_m = server.truth().x_m;
        system.wait_until("it drives on", |_| server.truth().x_m > x_m + 0.5);
    });
}

#[test]
fn a_hokuyo_scanner_at_this_computer_and_a_base_at_the_server_are_one_robot() {
    // The second one gives a quarter of its scans, with all its beams.
    let ust = "[vehicle.scanner]\nbeams = 1081\nincrement_rad = 0.004363323\nrange_m = 10.0";
    for (model, more, described) in [("urg-04lx", "", ""), ("ust-10lx", "\nurg_skip = 3", ust)] {
        with_a_hokuyo_scanner(model, more, described);
    }
}

fn with_a_hokuyo_scanner(model: &str, more: &str, described: &str) {
    repeat_when_late(|| {
        let server = server("free");
        let system = TestSystem::new(EXECUTABLE);
        let emulate = ["urg", "emulate", "--model", model, "--duration", "60", "--tcp", "127.0.0.1:0"];
        let mut scanner =
            system.command(&emulate).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut place = String::new();
        BufReader::new(scanner.stdout.as_mut().unwrap()).read_line(&mut place).unwrap();
        let keys = format!("scan = \"urg\"\nurg = \"{}\"{more}", place.trim());
        let file = system_file(&system, server.port(), &keys);
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, format!("{text}\n{described}\n")).unwrap();
        let cases = ["scans", "header", "valid-values", "increments", "drives", "dead-man"];
        let mut arguments = vec!["conformance", "robot", "--to", "player", "--system", &file, "--jobs", "1"];
        cases.iter().for_each(|case| arguments.extend(["--only", case]));
        let output = system.run(&arguments);
        let _ = (scanner.kill(), scanner.wait());
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    });
}

/// Kills the driver while it drives, after the guard if that is asked for; returns the server and the time of the kill.
fn kill_driver(with_guard: bool) -> (PlayerServer, u64) {
    let server = server("free");
    let mut system = TestSystem::new(EXECUTABLE);
    let file = system_file(&system, server.port(), "");
    system.start(&["--system", &file, "free"]);
    system.wait_until("it drives", |_| server.speed_mps() > 0.5);
    let (driver, guard) = (system.pid(Role::Robot), guards(server.port()).pop().unwrap());
    if with_guard {
        // Suspended, so that neither can act for the other.
        system.signal(driver, Signal::STOP);
        kill_process(guard, Signal::KILL).unwrap();
    }
    let since_ns = runtime::monotonic_ns();
    system.signal(driver, Signal::KILL);
    system.wait_until("it stands", |_| server.speed_mps() == 0.0);
    system.wait();
    system.assert_nothing_left();
    assert!(guards(server.port()).is_empty());
    (server, since_ns)
}

#[test]
fn the_guard_stops_the_wheels_when_the_driver_is_killed() {
    repeat_when_late(|| {
        let (server, since_ns) = kill_driver(false);
        let blind_ns = stopped_after_ns(&server, since_ns).unwrap();
        assert!(blind_ns < BUSY_NS, "{blind_ns} ns");
        let received = server.received();
        let after: Vec<_> =
            received.iter().filter(|(at_ns, _)| *at_ns >= since_ns).map(|(_, what)| *what).collect();
        assert_eq!(
            after[..2],
            [ReceivedCommand::Stop; 2],
            "both forms, before the connection is closed: {after:?}"
        );
    });
}

#[test]
fn the_closed_connection_stops_the_wheels_when_driver_and_guard_are_killed() {
    repeat_when_late(|| {
        let (server, since_ns) = kill_driver(true);
        let received = server.received();
        let after: Vec<_> =
            received.iter().filter(|(at_ns, _)| *at_ns >= since_ns).map(|(_, what)| *what).collect();
        assert_eq!(
            after,
            [ReceivedCommand::Stop, ReceivedCommand::Closed],
            "the server stops its robot by itself"
        );
        assert!(stopped_after_ns(&server, since_ns).unwrap() < BUSY_NS);
    });
}

#[test]
fn the_driver_meets_what_is_required_of_a_robot() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        // One robot: one case at a time.
        let test = |more: &[&str]| {
            let server = server("free");
            let file = system_file(&system, server.port(), "");
            let arguments =
                ["conformance", "robot", "--to", "player", "--system", &file, "--jobs", "1", "--json"];
            let output = system.run(&[&arguments[..], more].concat());
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            (serde_json::from_slice::<conformance::SuiteReport>(&output.stdout).unwrap(), text)
        };
        let (mut report, text) = test(&[]);
        // The robot drives on from case to case, until nothing is in reach of its scanner: each of the last ones gets a new robot.
        let is_unseen =
            |case: &conformance::CaseReport| case.outcome == conformance::CaseOutcome::NotObserved;
        let unseen = report.cases.iter().filter(|case| is_unseen(case));
        let again: Vec<String> = unseen.map(|case| case.name.clone()).collect();
        report.cases.retain(|case| !is_unseen(case));
        for case in &again {
            let (once_more, _) = test(&["--only", case]);
            report.cases.extend(once_more.cases);
        }
        assert_eq!(report.failed, 0, "{text}");
        let missed = report.cases.iter().filter(|case| case.outcome != conformance::CaseOutcome::Passed);
        let missed: Vec<&str> = missed.map(|case| case.name.as_str()).collect();
        assert_eq!(
            missed,
            ["truth", "grants", "repeatable"],
            "a real robot has no truth and no lock-step: {text}"
        );
    });
}
