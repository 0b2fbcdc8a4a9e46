//! All processes of a run stand still for a while: afterwards it drives on, and nothing is blamed for the pause.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::{Duration, Instant};

use rustix::process::Signal;
use scanloop_tests::{TestSystem, TruthWatch};
use shared_types::Truth;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
/// Longer than every limit of the runs of these tests: orphans would end after 1.0 s, the robot a second later.
const PAUSE: Duration = Duration::from_millis(3500);
/// `status` answers within this time, a busy machine included. A request to an orchestrator takes 12 s to fail.
const STATUS_LIMIT: Duration = Duration::from_secs(5);
const LIMITS: [&str; 6] =
    ["--set", "orphan_timeout_s=1.0", "--set", "orphan_stop_s=0.5", "--set", "timeout_s=600"];

fn driving() -> (TestSystem, TruthWatch) {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&[&["endless"], &LIMITS[..]].concat());
    let watch = TruthWatch::new(&system);
    watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
    (system, watch)
}

fn all(system: &TestSystem) -> Vec<i32> {
    system.processes().into_iter().chain([system.orchestrator()]).collect()
}

fn status(system: &TestSystem) -> String {
    let asked = Instant::now();
    let output = system.run(&["status", "--json"]);
    assert!(asked.elapsed() < STATUS_LIMIT, "{:?}", asked.elapsed());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    json["state"].as_str().unwrap().to_owned()
}

/// Time passes: the pause is what is tested.
fn let_pass(pause: Duration) {
    let until = Instant::now() + pause;
    while Instant::now() < until {
        std::thread::park_timeout(until - Instant::now());
    }
}

/// That the wheels were blocked after scan `paused`, and the robot drives on with the same processes until it is stopped.
fn assert_drives_on(mut system: TestSystem, watch: TruthWatch, processes: &[i32], paused: u64) {
    let after = watch.newest().unwrap().header.scan_id;
    watch
        .wait_for(&system, "it drives on", |truth| truth.header.scan_id > after + 5 && truth.speed_mps > 0.5);
    let blocked = |truth: &Truth| truth.header.scan_id > paused && truth.blocked == 1;
    assert!(watch.all().iter().any(blocked), "the wheels were blocked");
    assert_eq!(status(&system), "driving");
    let mut now = all(&system);
    let mut before = processes.to_vec();
    now.sort_unstable();
    before.sort_unstable();
    assert_eq!(now, before, "{}", system.stderr());
    assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
    let report = system.report();
    assert_eq!((report.reason.as_str(), report.scans.unaccounted), ("stopped by command", 0));
    drop(watch);
    system.assert_nothing_left();
}

#[test]
fn a_run_whose_processes_were_all_suspended_drives_on() {
    repeat_when_late(|| {
        let (system, watch) = driving();
        let processes = all(&system);
        let paused = watch.newest().unwrap().header.scan_id;
        processes.iter().for_each(|pid| system.signal(*pid, Signal::STOP));
        assert_eq!(status(&system), "suspended");
        // Nothing publishes, so no scan is known.
        let json = system.run(&["status", "--json"]).stdout;
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert!(json["scan"].is_null() && json["processes"][0]["rate_hz"].is_null(), "{json}");
        let_pass(PAUSE);
        // The orchestrator last: the others run again while nothing of it can be there yet.
        processes.iter().for_each(|pid| system.signal(*pid, Signal::CONT));
        assert_drives_on(system, watch, &processes, paused);
    });
}

/// Its silence blocks the wheels: the run is over then, if that takes longer than it may stand.
#[test]
fn a_run_that_ends_because_its_orchestrator_was_suspended_says_so() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let limits = ["--set", "orphan_stop_s=0.5", "--set", "stop_final_s=1.0"];
        system.start(&[&["endless"], &limits[..]].concat());
        let watch = TruthWatch::new(&system);
        watch.wait_for(&system, "it drives", |truth| truth.speed_mps > 0.5);
        system.signal(system.orchestrator(), Signal::STOP);
        let_pass(PAUSE);
        system.signal(system.orchestrator(), Signal::CONT);
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        let reason = system.report().reason;
        assert!(reason.contains("the orchestrator stood still for 3."), "{reason}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_run_whose_processes_ended_while_its_orchestrator_was_suspended_says_so() {
    for mode in [&["endless"][..], &["endless", "--lockstep"]] {
        repeat_when_late(|| {
            let mut system = TestSystem::new(EXECUTABLE);
            system.start(&[mode, &LIMITS[..]].concat());
            system.wait_until("it drives", |system| system.status().is_some_and(|status| status.scan > 10));
            system.signal(system.orchestrator(), Signal::STOP);
            system.wait_until("they have ended", |system| system.processes().is_empty());
            system.signal(system.orchestrator(), Signal::CONT);
            assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
            let reason = system.report().reason;
            assert!(reason.starts_with("the orchestrator stood still for "), "{mode:?}: {reason}");
            assert!(reason.contains("`orphan_timeout_s`, 1 s"), "{reason}");
            assert!(!system.stderr().contains("ended by itself"), "{}", system.stderr());
            system.assert_nothing_left();
        });
    }
}

#[test]
fn what_is_kept_in_memory_is_not_said_to_be_absent_while_the_orchestrator_is_suspended() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        system.wait_until("it drives", |system| system.status().is_some_and(|status| status.scan > 20));
        system.signal(system.orchestrator(), Signal::STOP);
        let refused = system.run(&["why", "10"]);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(4), "{text}");
        assert!(text.contains("keeps of its drive in memory can't be read"), "{text}");
        assert!(text.contains(&format!("process {} was suspended", system.orchestrator())), "{text}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn a_recorder_that_is_suspended_keeps_no_run_from_its_report() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--record"]);
        system.wait_until("it drives", |system| system.status().is_some_and(|status| status.scan > 10));
        let (orchestrator, processes) = (system.orchestrator(), system.processes());
        let children = format!("/proc/{orchestrator}/task/{orchestrator}/children");
        let children = std::fs::read_to_string(children).unwrap();
        let mut children = children.split_whitespace().map(|pid| pid.parse().unwrap());
        system.signal(children.find(|pid| !processes.contains(pid)).unwrap(), Signal::STOP);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        assert_eq!(system.report().reason, "stopped by command");
        system.assert_nothing_left();
    });
}

#[test]
fn a_request_to_a_suspended_orchestrator_says_so() {
    repeat_when_late(|| {
        let (mut system, watch) = driving();
        system.signal(system.orchestrator(), Signal::STOP);
        let refused = system.run(&["restart", "controller"]);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(4), "{text}");
        assert!(text.contains(&format!("process {} was suspended", system.orchestrator())), "{text}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        drop(watch);
        system.assert_nothing_left();
    });
}

#[test]
fn commands_that_observe_say_that_the_orchestrator_stands_still_and_that_the_system_has_ended() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let observe = |name: &str, arguments: &[&str]| {
            let log = std::fs::File::create(system.folder().join(name)).unwrap();
            system.command(arguments).stdout(Stdio::null()).stderr(log).spawn().unwrap()
        };
        let mut commands = [
            ("hz", observe("hz", &["topic", "hz", "pose", "--duration", "600"]), 0),
            ("echo", observe("echo", &["topic", "echo", "pose", "-n", "1000000"]), 1),
            ("record", observe("record", &["record", "drive.mcap"]), 0),
        ];
        let said = |name: &str| std::fs::read_to_string(system.folder().join(name)).unwrap();
        let all_say = |part: &str| ["hz", "echo", "record"].iter().all(|name| said(name).contains(part));
        system.signal(system.orchestrator(), Signal::STOP);
        let suspended = format!("process {} was suspended", system.orchestrator());
        system.wait_until("they say that it stands still", |_| all_say(&suspended));
        let json = system.run(&["status", "--json"]).stdout;
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert!(json["state"] == "suspended" && json["scan"].as_u64().is_some_and(|scan| scan > 0), "{json}");
        system.signal(system.orchestrator(), Signal::CONT);
        system.wait_until("they say that it runs", |_| all_say("no longer stands still"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        for (name, child, code) in &mut commands {
            assert_eq!(child.wait().unwrap().code(), Some(*code), "{name}: {}", said(name));
        }
        assert!(said("hz").contains("has ended") && said("echo").contains("has ended"), "{}", said("echo"));
        system.wait();
        system.assert_nothing_left();
    });
}

/// A control group that can be frozen, removed at the end of the test.
struct Freezer {
    folder: PathBuf,
    switch: [(&'static str, &'static str); 2],
}

impl Freezer {
    /// `None` where the test may not make one.
    fn new(name: &str) -> Option<Self> {
        let first = [("freezer.state", "FROZEN"), ("freezer.state", "THAWED")];
        let second = [("cgroup.freeze", "1"), ("cgroup.freeze", "0")];
        let places = [
            ("/sys/fs/cgroup/freezer", first),
            ("/sys/fs/cgroup", second),
            ("/sys/fs/cgroup/unified", second),
        ];
        places.into_iter().find_map(|(root, switch)| {
            let folder = PathBuf::from(root).join(format!("scanloop-{name}"));
            std::fs::create_dir(&folder).ok()?;
            let made = Self { folder, switch };
            made.folder.join(made.switch[0].0).exists().then_some(made)
        })
    }

    fn add(&self, pid: i32) {
        std::fs::write(self.folder.join("cgroup.procs"), pid.to_string()).unwrap();
    }

    fn freeze(&self) {
        std::fs::write(self.folder.join(self.switch[0].0), self.switch[0].1).unwrap();
    }

    fn thaw(&self) {
        let _ = std::fs::write(self.folder.join(self.switch[1].0), self.switch[1].1);
    }
}

impl Drop for Freezer {
    fn drop(&mut self) {
        self.thaw();
        let until = Instant::now() + Duration::from_secs(5);
        // A group with processes can't be removed; those of the test are about to end.
        while std::fs::remove_dir(&self.folder).is_err() && Instant::now() < until {
            scanloop_tests::pause();
        }
    }
}

#[test]
fn a_run_whose_control_group_was_frozen_drives_on() {
    repeat_when_late(|| {
        let (system, watch) = driving();
        let Some(freezer) = Freezer::new(system.id()) else {
            eprintln!("skipped a_run_whose_control_group_was_frozen_drives_on: no control group can be made");
            return;
        };
        let processes = all(&system);
        processes.iter().for_each(|pid| freezer.add(*pid));
        let paused = watch.newest().unwrap().header.scan_id;
        freezer.freeze();
        assert_eq!(status(&system), "suspended");
        let_pass(PAUSE);
        freezer.thaw();
        assert_drives_on(system, watch, &processes, paused);
    });
}

#[test]
fn a_stop_of_a_frozen_run_is_not_confirmed_and_holds_once_it_runs_again() {
    repeat_when_late(|| {
        let (mut system, watch) = driving();
        let Some(freezer) = Freezer::new(system.id()) else {
            eprintln!("skipped a_stop_of_a_frozen_run: no control group can be made");
            return;
        };
        all(&system).iter().for_each(|pid| freezer.add(*pid));
        freezer.freeze();
        let stopped = system.run(&["stop"]);
        let text = String::from_utf8_lossy(&stopped.stderr).into_owned();
        assert_eq!(stopped.status.code(), Some(4), "{text}");
        assert!(text.contains("is not confirmed"), "{text}");
        freezer.thaw();
        watch.wait_for(&system, "it rests", |truth| truth.blocked == 1 && truth.speed_mps <= 0.0);
        system.wait();
        assert_eq!(system.report().reason, "stopped by command");
        drop(watch);
        system.assert_nothing_left();
    });
}
