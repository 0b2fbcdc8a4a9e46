//! Samples that are dropped: their writer and the rule that they fail are named, live and in lock-step.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use audit::ledger::RefusedRow;
use emulator::Outcome;
use report::Report;
use rustix::process::Signal;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, is_ignored, system_file};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");

/// A system in which `role` is filled by a faulty program.
fn system_with(role: Role, fault: &str) -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::write(system.folder().join("system.toml"), system_file(10, &[role], FAULTY, &[fault])).unwrap();
    system
}

fn state_of(report: &Report, role: Role) -> &str {
    &report.processes.iter().find(|process| process.role == role.name()).unwrap().state
}

fn log_of(system: &TestSystem, role: Role) -> String {
    std::fs::read_to_string(system.folder().join("out/logs").join(format!("{role}.log"))).unwrap()
}

/// Drives with a faulty controller until the wheels were blocked for a second; returns the only row of dropped samples.
fn dropped_commands(fault: &str, rule: &str, block: &str) -> RefusedRow {
    let mut system = system_with(Role::Controller, fault);
    system.start(&["--system", "system.toml", "--set", "stop_final_s=2"]);
    system.wait_until("the status names the rule", |system| {
        let refused = system.status().map_or(Vec::new(), |status| status.refused);
        refused.iter().any(|row| row.writer == "controller" && row.reader == "actuator" && row.rule == rule)
    });
    let table = scanloop_tests::printed(&system.run(&["status"]));
    let expected = rule.replace('_', " ");
    assert!(table.contains("dropped by actuator") && table.contains(&expected), "{table}");
    assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
    let report = system.report();
    assert_eq!(report.outcome, Outcome::Stopped, "{}", report.reason);
    assert!(
        report.reason.contains("of controller") && report.reason.contains(&expected),
        "{}",
        report.reason
    );
    assert!(report.stop_reasons.contains_key(block), "{:?}", report.stop_reasons);
    let warnings = system.stderr();
    assert!(warnings.contains("controller (") && warnings.contains(&expected), "{warnings}");
    let log = log_of(&system, Role::Actuator);
    let lines = log.lines().filter(|line| line.contains("dropped") && line.contains("controller"));
    assert!(log.contains(&expected), "{log}");
    assert!((1..=2).contains(&lines.count()), "one line, not one per sample: {log}");
    assert_eq!(state_of(&report, Role::Actuator), "exited");
    system.assert_nothing_left();
    let [row] = report.ledger.refused.as_slice() else { panic!("{:?}", report.ledger.refused) };
    assert!(row.count > 5 && row.count + 5 > report.scans.published, "{row:?} {:?}", report.scans);
    if rule == "not_verified" {
        assert!(report.scans.lost_reasons.contains_key(rule), "{:?}", report.scans);
        assert!(!report.scans.lost_reasons.contains_key("no_command"), "{:?}", report.scans);
    }
    row.clone()
}

#[test]
fn commands_that_are_not_verified_are_laid_to_the_controller() {
    repeat_when_late(|| {
        let row = dropped_commands("unverified", "not_verified", "invalid_command");
        assert_eq!((row.field.as_str(), row.value), ("verified", 0.0));
    });
}

#[test]
fn commands_outside_the_bounds_are_laid_to_the_controller_with_key_and_value() {
    repeat_when_late(|| {
        let row = dropped_commands("too-fast", "outside_bounds", "invalid_command");
        assert_eq!((row.field.as_str(), row.value), ("velocity_mps", 1.5));
    });
}

#[test]
fn an_actuator_that_drives_against_a_command_to_stop_ends_the_run_and_the_robot_stops() {
    repeat_when_late(|| {
        let mut system = system_with(Role::Actuator, "drives-on");
        system.start(&["free", "--system", "system.toml", "--set", "goal.x_m=2", "--duration", "20"]);
        assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
        let report = system.report();
        assert_eq!(report.outcome, Outcome::Failed, "{}", report.reason);
        assert!(
            report.reason.contains("actuator (") && report.reason.contains("it drives although"),
            "{}",
            report.reason
        );
        let [.., last] = report.trajectory.as_slice() else { panic!("no trajectory") };
        // It lands within 0.1 m, disobeys at 0.5 m/s, and the robot blocks its wheels within 0.2 s.
        assert!(last[1] < 2.4, "{last:?}");
        system.assert_nothing_left();
    });
}

#[test]
fn in_lockstep_the_run_ends_with_the_writer_of_a_dropped_sample_and_the_rule() {
    repeat_when_late(|| {
        for (role, fault, expected) in [
            (
                Role::Controller,
                "unverified",
                "its command for scan 1 was dropped by actuator: not verified (verified = 0)",
            ),
            (Role::Controller, "not-finite", "dropped by actuator: not finite (steering_rad)"),
            (Role::Estimator, "nan", "its pose for scan 7 was dropped by "),
        ] {
            let system = system_with(role, fault);
            let output =
                system.run(&["run", "--lockstep", "--quiet", "--system", "system.toml", "--out", "out"]);
            let message = scanloop_tests::printed(&output);
            assert_eq!(output.status.code(), Some(4), "{message}");
            let report = system.report();
            assert_eq!(report.outcome, Outcome::Failed, "{}", report.reason);
            assert!(report.reason.starts_with(&format!("{role} (")), "{}", report.reason);
            assert!(
                report.reason.contains(expected) && message.contains(expected),
                "{} {message}",
                report.reason
            );
            assert_eq!(state_of(&report, role), "failed");
            let failed = report.processes.iter().filter(|process| process.state == "failed").count();
            assert_eq!(failed, 1, "{:?}", report.processes);
            system.assert_nothing_left();
        }
    });
}

#[test]
fn a_process_that_had_to_drop_all_its_inputs_is_not_blamed_for_having_no_output() {
    repeat_when_late(|| {
        let system = system_with(Role::Estimator, "infinite");
        let output = system.run(&[
            "run",
            "--quiet",
            "--system",
            "system.toml",
            "--out",
            "out",
            "--set",
            "process.estimator.start_timeout_s=1.5",
            "--set",
            "process.obstacles.start_timeout_s=1",
            "--set",
            "process.controller.start_timeout_s=1",
            "--set",
            "stop_final_s=20",
        ]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{message}");
        let report = system.report();
        for expected in
            ["estimator (", "had no valid output within 1500 ms", "its pose for scan", "not finite"]
        {
            assert!(report.reason.contains(expected), "{expected}: {}", report.reason);
        }
        assert_eq!(state_of(&report, Role::Estimator), "failed");
        assert_eq!(
            (state_of(&report, Role::Obstacles), state_of(&report, Role::Controller)),
            ("exited", "exited")
        );
        system.assert_nothing_left();
    });
}

/// What the processes of a running system may read.
#[test]
fn a_stage_can_not_read_the_scenario_and_finds_all_its_settings() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["--duration", "30"]);
        let domain = system.domain();
        let directory = domain.directory();
        for role in Role::ALL.iter().copied() {
            let path = directory.join(runtime::settings_file(role));
            let text = std::fs::read_to_string(&path).unwrap();
            assert_eq!(text.contains("[[scenario.obstacle]]"), role == Role::Robot, "{}", path.display());
            assert!(text.contains(&format!("[{}", runtime::settings_table(role))), "{text}");
        }
        assert!(!directory.join("settings.toml").exists());
        let estimator = std::fs::read_to_string(directory.join("settings-estimator.toml")).unwrap();
        for key in
            ["odometry_longitudinal = 0.01", "odometry_lateral_rate = 0.0", "gate = true", "correction = "]
        {
            assert!(estimator.contains(key), "{key}: {estimator}");
        }
        // Another orchestrator finds the scenario elsewhere.
        system.kill_orchestrator();
        system.adopt(&[]);
        assert_eq!(system.status().unwrap().scenario, "corridor");
        assert!(system.run(&["stop"]).status.success());
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn an_interrupt_at_any_moment_of_the_start_leaves_nothing() {
    repeat_when_late(|| {
        for delay_us in (0..40_000).step_by(2_000) {
            let mut system = TestSystem::new(EXECUTABLE);
            system.launch(&["run", "--quiet", "--out", "out"], &[]);
            let started = std::time::Instant::now();
            while started.elapsed().as_micros() < delay_us {
                std::hint::spin_loop();
            }
            // A background process of a script ignores INT until it has installed its handlers.
            let signal = if is_ignored(Signal::INT) { Signal::TERM } else { Signal::INT };
            system.signal(system.orchestrator(), signal);
            let status = system.wait();
            // Before the handlers are there the signal ends the process, which has made nothing yet.
            assert!(status.code() == Some(1) || status.code().is_none(), "{status}: {}", system.stderr());
            system.assert_nothing_left();
        }
    });
}
