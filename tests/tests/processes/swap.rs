//! Processes swapped while the robot drives: without a missed scan, or not at all.

use scanloop_tests::machine::repeat_when_late;
use std::time::{Duration, Instant};

use handover::swap::SwapOutcome;
use rustix::process::Signal;
use scanloop_tests::audit::{Audit, audit};
use scanloop_tests::swaps::{
    BUILT_IN, assert_reached, assert_seamless, assert_seamless_swap, begin, certificate,
    rolls_back_a_hang_in_charge, rows, standby, stop, survives_the_death_of_the_standby, swap_in_vain,
    swap_seamlessly,
};
use scanloop_tests::{SHORT_CORRIDOR, SHORTENED_LONG, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-controller");

#[test]
fn the_controller_is_swapped_within_three_seconds_and_no_scan_is_missed() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let old = system.pid(Role::Controller);
        let started = Instant::now();
        let certificate = swap_seamlessly(&system, &["controller", "--to", "nmpc"]);
        assert!(started.elapsed() < Duration::from_secs(3), "{:?}", started.elapsed());
        assert_eq!((certificate.from.as_str(), certificate.to.as_str()), ("nmpc", "nmpc"));
        assert_eq!(certificate.shadow_scans, 10);
        // The controller itself may change a command by this much in a scan.
        assert!(certificate.command_jump_rad < 0.03 && certificate.command_jump_mps < 0.3, "{certificate:?}");
        assert_ne!(system.pid(Role::Controller), old);
        assert_reached(system, &[certificate]);
    });
}

#[test]
fn all_roles_are_swapped_one_after_the_other_and_their_certificates_are_true() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long"]);
        let observer = Audit::start(&system.domain());
        let mut certificates = Vec::new();
        for (role, implementation) in BUILT_IN {
            certificates.push(swap_seamlessly(&system, &[role.name(), "--to", implementation]));
        }
        let recording = observer.stop();
        for certificate in &certificates {
            audit(certificate, &recording).unwrap();
            let first = certificate.first_scan_new.unwrap();
            let role: Role = certificate.role.parse().unwrap();
            assert!(recording.party(role, first).is_some(), "{role}: no output recorded for scan {first}");
        }
        assert_reached(system, &certificates);
    });
}

#[test]
fn a_bad_process_is_refused_with_the_reason_and_the_robot_does_not_notice() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORTENED_LONG);
        let mut certificates = Vec::new();
        for (command, reason) in [
            (vec!["scanloop-no-such-command"], "command `scanloop-no-such-command` was not found"),
            (vec!["false"], "the new process ended: exit code 1"),
            (vec!["sleep", "60"], "no output within 3 s"),
            (vec![FAULTY, "steer"], "steering angle differs by"),
            (vec![FAULTY, "nan"], "steering_rad is not finite"),
            (vec![FAULTY, "late"], "late: "),
            (vec![FAULTY, "flood"], "not the first for that scan"),
            (vec![FAULTY, "exit-after", "3"], "the new process ended: exit code 1"),
            (vec![FAULTY, "hang-after", "3"], "late: no output for scan"),
            (vec![FAULTY, "hang-preparing-after", "3"], "late: no output for scan"),
        ] {
            let arguments = [vec!["controller", "--"], command].concat();
            certificates.push(swap_in_vain(&system, &arguments, SwapOutcome::Refused, reason));
        }
        assert_reached(system, &certificates);
    });
}

#[test]
fn the_tolerance_can_be_raised_for_a_controller_that_drives_differently() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let arguments = ["controller", "--gate-scans", "5", "--tolerance", "1000", "--", FAULTY, "steer"];
        let certificate = swap_seamlessly(&system, &arguments);
        assert_eq!(certificate.shadow_scans, 5);
        system.wait();
        system.assert_nothing_left();
    });
}

#[test]
fn the_old_one_answers_the_scan_in_which_the_new_one_is_killed() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long"]);
        let observer = Audit::start(&system.domain());
        let mut certificates = Vec::new();
        for (role, implementation) in BUILT_IN {
            let (child, new, old) = standby(&system, role, &["--to", implementation]);
            system.signal(new, Signal::KILL);
            let certificate = certificate(&child.wait_with_output().unwrap());
            assert_eq!(certificate.outcome, SwapOutcome::RolledBack, "{certificate:?}");
            assert!(certificate.reason.contains("killed by signal 9"), "{}", certificate.reason);
            assert_seamless(&certificate);
            assert_eq!(rows(&system, role), [(old, "ready".to_owned())]);
            assert!(certificate.first_scan_back > certificate.first_scan_new, "{certificate:?}");
            certificates.push(certificate);
        }
        let recording = observer.stop();
        certificates.iter().for_each(|certificate| audit(certificate, &recording).unwrap());
        assert_reached(system, &certificates);
    });
}

#[test]
fn a_process_that_hangs_in_charge_is_rolled_back_before_the_wheels_are_blocked() {
    repeat_when_late(|| {
        rolls_back_a_hang_in_charge(TestSystem::new(EXECUTABLE), Role::Controller, FAULTY);
    });
}

#[test]
fn the_new_process_stays_when_the_old_one_is_killed_during_its_standby() {
    repeat_when_late(|| {
        survives_the_death_of_the_standby(TestSystem::new(EXECUTABLE), Role::Controller, "nmpc");
    });
}

#[test]
fn a_process_that_took_over_is_supervised_like_the_one_before() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        swap_seamlessly(&system, &["controller", "--", FAULTY, "none"]);
        let pid = system.pid(Role::Controller);
        system.signal(pid, Signal::KILL);
        system.wait_until("it is started again", |system| {
            rows(system, Role::Controller).first().is_some_and(|(new, state)| state == "ready" && *new != pid)
        });
        let status = system.status().unwrap();
        let process = status.processes.iter().find(|process| process.role == Role::Controller).unwrap();
        assert!(process.implementation.ends_with("faulty-controller none"), "{}", process.implementation);
        assert_eq!(process.restarts, 1);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        system.assert_nothing_left();
    });
}

#[test]
fn wrong_usage_has_exit_code_2_and_disturbs_no_process() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let exit = |system: &TestSystem, arguments: &[&str]| {
            let output = system.run(&[&["swap"], arguments].concat());
            (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
        };
        let (code, message) = exit(&system, &["controller", "--to", "nmpc"]);
        assert_eq!(code, Some(2));
        assert!(message.contains("is not running"), "{message}");
        system.start(&SHORT_CORRIDOR);
        for (arguments, message) in [
            (vec!["pilot", "--to", "nmpc"], "unknown role `pilot`"),
            (vec!["robot", "--to", "ekf"], "one of emulator, player, ros2 for role robot"),
            (vec!["controller", "--to", "ekf"], "one of nmpc for role controller"),
            (vec!["controller"], "required"),
            (vec!["controller", "--to", "nmpc", "--", "sleep", "1"], "cannot be used with"),
            (vec!["controller", "--to", "nmpc", "--shadow-scans", "0"], "shadow-scans"),
            (vec!["controller", "--to", "nmpc", "--gate-scans", "10001"], "10001 is not in 1..=10000"),
            (
                vec!["controller", "--to", "nmpc", "--tolerance", "nan"],
                "--tolerance NaN is not allowed: 0 to 1000",
            ),
            (vec!["controller", "--to", "nmpc", "--tolerance", "1001"], "--tolerance 1001 is not allowed"),
        ] {
            let (code, printed) = exit(&system, &arguments);
            assert_eq!(code, Some(2), "{printed}");
            assert!(printed.contains(message), "{printed}");
        }
        let first = begin(&system, &["controller", "--to", "nmpc"]);
        system.wait_until("a shadow", |system| {
            rows(system, Role::Controller).get(1).is_some_and(|(_, state)| state == "shadow")
        });
        let (code, message) = exit(&system, &["estimator", "--to", "ekf"]);
        assert_eq!(code, Some(2));
        assert!(message.contains("another swap is in progress"), "{message}");
        assert_eq!(system.run(&["restart", "controller"]).status.code(), Some(2));
        let certificate = certificate(&first.wait_with_output().unwrap());
        assert_seamless_swap(&certificate);
        assert_reached(system, &[certificate]);
    });
}

#[test]
fn a_run_that_ends_takes_the_new_process_with_it() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["corridor"]);
        let shadow = begin(&system, &["controller", "--to", "nmpc", "--shadow-scans", "1000"]);
        system.wait_until("a shadow", |system| rows(system, Role::Controller).len() == 2);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        let certificate = certificate(&shadow.wait_with_output().unwrap());
        assert_eq!(
            (certificate.outcome, certificate.reason.as_str()),
            (SwapOutcome::Refused, "the run ends")
        );
        system.wait();
        system.assert_nothing_left();
        // When it is in charge, its last message blocks the wheels.
        system.start(&["corridor"]);
        let (child, ..) = standby(&system, Role::Actuator, &["--to", "actuation"]);
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(self::certificate(&child.wait_with_output().unwrap()).outcome, SwapOutcome::Swapped);
        system.wait();
        assert_eq!(system.report().drive.final_speed_mps, 0.0, "the robot stands at the end");
        system.assert_nothing_left();
    });
}

#[test]
fn swaps_in_lock_step_miss_no_scan_and_change_no_bit_of_the_drive() {
    repeat_when_late(|| {
        let undisturbed = TestSystem::new(EXECUTABLE).lockstep(&["endless", "--duration", "300"]);
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep", "--duration", "300"]);
        let mut certificates = Vec::new();
        for (role, implementation) in [BUILT_IN, BUILT_IN].concat() {
            certificates.push(swap_seamlessly(&system, &[role.name(), "--to", implementation]));
        }
        system.wait();
        let report = system.report();
        assert_eq!(report.swaps, certificates);
        assert_eq!(report.trajectory, undisturbed.trajectory);
        assert_eq!(
            report.digests, undisturbed.digests,
            "all samples of all topics, except their incarnations"
        );
        assert_eq!((report.scans.lost, report.scans.duplicates, report.scans.unaccounted), (0, 0, 0));
        system.assert_nothing_left();
    });
}

#[test]
fn bad_processes_are_refused_or_rolled_back_in_lock_step_too() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep", "--duration", "9000"]);
        for (command, outcome) in [
            (vec!["false"], SwapOutcome::Refused),
            (vec![FAULTY, "nan"], SwapOutcome::Refused),
            (vec![FAULTY, "hang-after", "20"], SwapOutcome::RolledBack),
            (vec![FAULTY, "exit-after", "20"], SwapOutcome::RolledBack),
        ] {
            let standby = ["controller", "--standby-scans", "40", "--"];
            swap_in_vain(&system, &[standby.to_vec(), command].concat(), outcome, "");
        }
        stop(&mut system);
    });
}
