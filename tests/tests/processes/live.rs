//! Runs in real time: processes killed, stopped and interrupted while the robot drives.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::path::Path;
use std::time::{Duration, Instant};

use emulator::Outcome;
use report::Report;
use rustix::process::Signal;
use scanloop_tests::TestSystem;
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// True wheels are blocked at the latest three scan periods after the last actuation.
const MAX_BLIND_S: f64 = 0.3;

/// Sends a signal to a role while it drives and returns the report of the run.
fn disturb(role: Role, signal: Signal) -> Report {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&["--duration", "6"]);
    let pid = system.pid(role);
    system.signal(pid, signal);
    let status = system.wait();
    let report = system.report();
    assert!(status.code().is_some(), "{}", system.stderr());
    assert!(
        report.drive.truth.unwrap().longest_blind_s <= MAX_BLIND_S,
        "blind for {} s",
        report.drive.truth.unwrap().longest_blind_s
    );
    assert!(!report.drive.truth.unwrap().collided);
    assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
    system.assert_nothing_left();
    report
}

/// A killed process is restarted and the robot drives on.
fn survives(role: Role, signal: Signal) {
    let report = disturb(role, signal);
    let process = report.processes.iter().find(|process| process.role == role.name()).unwrap();
    assert_eq!(process.restarts, 1, "{report:?}");
    assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
    let [.., before, last] = report.trajectory.as_slice() else { panic!("no trajectory") };
    // It has driven well beyond the place where the process died.
    assert!(last[1] > 3.0, "{last:?} {before:?}");
}

#[test]
fn the_robot_drives_on_after_the_estimator_was_killed() {
    repeat_when_late(|| {
        survives(Role::Estimator, Signal::KILL);
    });
}

#[test]
fn the_robot_drives_on_after_the_obstacles_were_killed() {
    repeat_when_late(|| {
        survives(Role::Obstacles, Signal::KILL);
    });
}

#[test]
fn the_robot_drives_on_after_the_controller_was_killed() {
    repeat_when_late(|| {
        survives(Role::Controller, Signal::KILL);
    });
}

#[test]
fn the_robot_drives_on_after_the_actuator_was_killed() {
    repeat_when_late(|| {
        survives(Role::Actuator, Signal::KILL);
    });
}

#[test]
fn a_controller_that_hangs_is_killed_and_restarted() {
    repeat_when_late(|| {
        survives(Role::Controller, Signal::STOP);
    });
}

/// Drives the corridor in real time with these keys of the scanner; no process is restarted, and all is accounted for.
fn live(duration_s: &str, keys: &[&str]) -> Report {
    let mut system = TestSystem::new(EXECUTABLE);
    let mut arguments = vec!["--duration", duration_s];
    keys.iter().for_each(|key| arguments.extend(["--set", key]));
    system.start(&arguments);
    system.wait();
    let report = system.report();
    assert!(report.processes.iter().all(|process| process.restarts == 0), "{report:?}");
    assert!(
        report.drive.truth.unwrap().longest_blind_s <= MAX_BLIND_S && !report.drive.truth.unwrap().collided
    );
    assert_eq!((report.scans.unaccounted, report.ledger.residual, report.ledger.reordered), (0, 0, 0));
    system.assert_nothing_left();
    report
}

fn x_at(report: &Report, time_s: f64) -> f64 {
    report.trajectory.iter().rfind(|place| place[0] <= time_s).map_or(0.0, |place| place[1])
}

/// There is nothing to answer for longer than a hang takes: no process hangs, the wheels are blocked, and then the
/// drive continues.
#[test]
fn a_scanner_that_is_silent_for_a_second_restarts_no_process() {
    repeat_when_late(|| {
        let report = live("12", &["scanner.period_s=[0.005, 3.0]", "scanner.from_s=2.0", "scanner.to_s=6.0"]);
        assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
        let longest = report.trajectory.windows(2).map(|pair| pair[1][0] - pair[0][0]).fold(0.0, f64::max);
        assert!(longest > 1.0, "{longest} s without any scan");
        assert!(report.stop_reasons["gap"] >= 1, "{:?}", report.stop_reasons);
        assert!(x_at(&report, 12.0) > x_at(&report, 9.5) + 0.5, "{:?}", report.trajectory);
    });
}

#[test]
fn irregular_scans_are_no_hang_and_late_or_out_of_order_for_no_process() {
    repeat_when_late(|| {
        let report = live("8", &["scanner.period_s=[0.005, 0.255]", "scanner.stamp_jitter_s=0.02"]);
        assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
        assert_eq!((report.scans.lost, report.scans.late), (0, 0), "{:?}", report.scans);
        assert!(report.stop_reasons["gap"] >= 1, "{:?}", report.stop_reasons);
        assert_eq!(report.stop_reasons.get("no_command"), None, "{:?}", report.stop_reasons);
        assert!(x_at(&report, 8.0) > 4.0, "{:?}", report.trajectory.last());
    });
}

#[test]
fn late_scans_block_the_wheels_and_the_drive_continues_after_them() {
    repeat_when_late(|| {
        let report = live("9", &["scanner.late_s=0.3", "scanner.from_s=2.0", "scanner.to_s=4.0"]);
        assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
        assert!(x_at(&report, 4.0) < x_at(&report, 3.0) + 0.02, "it stands");
        assert!(x_at(&report, 9.0) > x_at(&report, 5.0) + 1.0, "{:?}", report.trajectory.last());
        assert_eq!(report.scans.lost, report.scans.lost_reasons["too_old"], "{:?}", report.scans);
    });
}

#[test]
fn a_swap_while_all_scans_are_late_is_refused_with_the_reason() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let late = ["--set", "scanner.late_s=0.3", "--set", "scanner.from_s=1.0", "--set", "stop_final_s=60"];
        system.start(&late);
        system.wait_until("scans are late", |system| system.status().is_some_and(|status| status.scan > 15));
        let swap = system.run(&["swap", "controller", "--to", "nmpc"]);
        let message = scanloop_tests::printed(&swap);
        assert_eq!(swap.status.code(), Some(1), "{message}");
        assert!(message.contains("the old process had none either: valid inputs do not come"), "{message}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
        let report = system.report();
        assert!(report.processes.iter().all(|process| process.restarts == 0), "{report:?}");
        assert_eq!(report.drive.final_speed_mps, 0.0);
        system.assert_nothing_left();
    });
}

/// As when a host suspends its guest: the orchestrator wakes first and has received no heartbeat.
#[test]
fn a_machine_that_was_suspended_restarts_no_process() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        // At 5 Hz a hang is 600 ms: a resumed process has the time to publish a heartbeat.
        system.start(&["--duration", "6", "--set", "rate_hz=5"]);
        let all: Vec<i32> = [Role::Robot, Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator]
            .map(|role| system.pid(role))
            .into();
        system.signal(system.orchestrator(), Signal::STOP);
        all.iter().for_each(|pid| system.signal(*pid, Signal::STOP));
        let stopped = Instant::now();
        system.wait_until("longer than a hang takes", |_| stopped.elapsed() > Duration::from_millis(800));
        system.signal(system.orchestrator(), Signal::CONT);
        system.wait_until("it is awake", |system| system.status().is_some());
        all.iter().for_each(|pid| system.signal(*pid, Signal::CONT));
        system.wait();
        let report = system.report();
        assert_eq!(report.outcome, Outcome::Timeout, "{}", report.reason);
        let restarts: Vec<u32> = report.processes.iter().map(|process| process.restarts).collect();
        assert_eq!(restarts, [0; 5], "{}", system.stderr());
        assert!(
            report.drive.truth.unwrap().longest_blind_s <= 2.0 * MAX_BLIND_S,
            "blind for {} s",
            report.drive.truth.unwrap().longest_blind_s
        );
        assert_eq!(report.scans.unaccounted, 0, "{:?}", report.scans);
        system.assert_nothing_left();
    });
}

#[test]
fn the_death_of_the_robot_ends_the_run() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[]);
        let pid = system.pid(Role::Robot);
        system.signal(pid, Signal::KILL);
        assert_eq!(system.wait().code(), Some(4));
        assert_eq!(system.report().outcome, Outcome::Failed);
        assert!(system.stderr().contains("killed by signal 9"), "{}", system.stderr());
        system.assert_nothing_left();
    });
}

#[test]
fn an_interrupt_stops_the_wheels_and_leaves_nothing() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[]);
        system.signal(system.orchestrator(), Signal::INT);
        assert_eq!(system.wait().code(), Some(1));
        let report = system.report();
        assert_eq!(report.outcome, Outcome::Interrupted);
        assert_eq!(report.drive.final_speed_mps, 0.0, "the robot stands at the end");
        assert_eq!(report.scans.unaccounted, 0);
        system.assert_nothing_left();
    });
}

#[test]
fn a_run_after_the_orchestrator_was_killed_needs_no_cleaning() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[]);
        let orphans = system.processes();
        assert!(orphans.len() >= 5, "{orphans:?}");
        system.signal(system.orchestrator(), Signal::KILL);
        system.wait();
        let report = system.lockstep(&["free"]);
        assert_eq!(report.outcome, Outcome::Reached);
        system.assert_nothing_left();
    });
}

#[test]
fn processes_without_an_orchestrator_stop_and_end_by_themselves() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["--set", "orphan_timeout_s=1"]);
        system.signal(system.orchestrator(), Signal::KILL);
        system.wait();
        system.wait_until("all processes have ended", |system| system.processes().is_empty());
    });
}

#[test]
fn a_second_run_of_the_same_system_is_refused_and_the_first_drives_on() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["--duration", "2"]);
        let second = system.run(&["run", "--quiet", "--out", "second"]);
        assert_eq!(second.status.code(), Some(2));
        let message = String::from_utf8_lossy(&second.stderr).into_owned();
        assert!(message.contains("is already running"), "{message}");
        system.wait();
        assert_eq!(system.report().outcome, Outcome::Timeout);
        system.assert_nothing_left();
    });
}

#[test]
fn a_running_system_can_be_inspected_restarted_and_stopped() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[]);
        let status: serde_json::Value =
            serde_json::from_slice(&system.run(&["status", "--json"]).stdout).expect("status prints JSON");
        assert_eq!(status["scenario"], "corridor");
        let roles: Vec<&str> = status["processes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|process| process["role"].as_str().unwrap())
            .collect();
        assert_eq!(roles, ["robot", "estimator", "obstacles", "controller", "actuator"]);

        let echo = system.run(&["topic", "echo", "pose", "-n", "2"]);
        let lines: Vec<serde_json::Value> = String::from_utf8_lossy(&echo.stdout)
            .lines()
            .map(|line| serde_json::from_str(line).expect("one JSON object per line"))
            .collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0]["header"]["scan_id"].as_u64() < lines[1]["header"]["scan_id"].as_u64());
        assert_eq!((&lines[0]["suspect"], &lines[0]["alarm"]), (&"none".into(), &"none".into()));

        let latency: serde_json::Value =
            serde_json::from_slice(&system.run(&["latency", "--duration", "0.5", "--json"]).stdout).unwrap();
        let latency = &latency["latency_us"];
        assert!(latency["scan_to_actuation"]["count"].as_u64() > Some(0));
        assert_eq!(latency["incomplete_chains"], 0);
        for arguments in [["latency", "--duration", "0"], ["latency", "--duration", "nan"]] {
            let refused = system.run(&arguments);
            assert_eq!(refused.status.code(), Some(2));
            assert!(String::from_utf8_lossy(&refused.stderr).contains("--duration"), "{refused:?}");
        }

        assert_eq!(system.run(&["restart", "pilot"]).status.code(), Some(2));
        assert_eq!(system.run(&["restart", "robot"]).status.code(), Some(2));
        let before = system.pid(Role::Controller);
        assert_eq!(system.run(&["restart", "controller"]).status.code(), Some(0));
        system.wait_until("a new controller", |system| {
            let pid = system.pid(Role::Controller);
            pid != 0 && pid != before
        });

        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1));
        assert_eq!(system.report().outcome, Outcome::Interrupted);
        assert_eq!(system.run(&["status"]).status.code(), Some(2));
        system.assert_nothing_left();
    });
}

#[test]
fn driving_processes_wait_for_no_disk() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["--duration", "5"]);
        for role in Role::ALL {
            let log = system.folder().canonicalize().unwrap().join(format!("out/logs/{role}.log"));
            let open = std::fs::read_dir(format!("/proc/{}/fd", system.pid(*role))).unwrap();
            let paths = open.flatten().filter_map(|file| std::fs::read_link(file.path()).ok());
            let in_memory =
                |path: &Path| path.starts_with("/dev") || path.to_string_lossy().starts_with("/memfd:");
            let on_disk: Vec<_> = paths.filter(|path| path.is_absolute() && !in_memory(path)).collect();
            // The directory of the system is held open, and a file in it for its lock: neither is read nor written.
            let domain = system.domain();
            let living = domain.directory().join("living");
            let expected = [log.as_path(), domain.directory(), &living];
            assert!(on_disk.iter().all(|path| expected.contains(&path.as_path())), "{role}: {on_disk:?}");
        }
        system.signal(system.orchestrator(), Signal::INT);
        system.wait();
        system.assert_nothing_left();
    });
}
