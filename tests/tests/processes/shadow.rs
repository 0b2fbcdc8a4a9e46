//! Processes in the shadow of the live ones: compared, and without effect on the drive.

use handover::shadow::ShadowOutcome;
use rustix::process::Signal;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{
    BUILT_IN, assert_every_scan_answered_once, begin_shadow, more_scans, rows, shadow, shadow_report,
};
use scanloop_tests::{SHORT_CORRIDOR, SHORTENED_LONG, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty-controller");

/// Asserts that the run reached its goal as without a shadow, and left nothing.
fn assert_undisturbed(mut system: TestSystem) {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    assert_every_scan_answered_once(&system);
    let report = system.report();
    assert!(report.swaps.is_empty() && report.processes.iter().all(|process| process.restarts == 0));
    system.assert_nothing_left();
}

#[test]
fn a_shadow_of_each_role_at_once_publishes_the_same_as_the_live_process() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let shadows = BUILT_IN
            .map(|(role, name)| (role, begin_shadow(&system, &[role.name(), "--to", name, "--for", "4s"])));
        system.wait_until("all shadows", |system| {
            BUILT_IN.iter().all(|(role, _)| rows(system, *role).iter().any(|(_, state)| state == "shadow"))
        });
        for (role, child) in shadows {
            let report = shadow_report(&child.wait_with_output().unwrap());
            assert_eq!((report.outcome, report.role.as_str()), (ShadowOutcome::Completed, role.name()));
            assert!(report.scans >= 25 && report.answered_share > 0.95, "{report}");
            assert_eq!((report.invalid, report.repeated), (0, 0), "{report}");
            for difference in &report.differences {
                assert!(difference.mean_interval.is_some(), "{report}");
                // Both run the same code; they differ because the shadow started later.
                assert!(difference.mean.abs() < 0.02, "{report}");
            }
            assert!(report.reaction_ms.shadow_p50 > 0.0 && report.compute_ms.ratio_p50_interval.is_some());
        }
        assert_undisturbed(system);
    });
}

#[test]
fn a_shadow_that_steers_more_is_found_and_drives_nothing() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["slalom"]);
        // The option `--for` may be the last argument.
        let report = shadow(&system, &["controller", "--", FAULTY, "steer", "--for", "5s"]);
        assert_eq!(report.outcome, ShadowOutcome::Completed, "{report}");
        let steering =
            report.differences.iter().find(|difference| difference.quantity == "steering angle").unwrap();
        assert!(steering.max_abs > 1e-3, "a fifth of what the slalom asks for: {report}");
        let reaction = &report.reaction_ms;
        assert!(reaction.live_p50 > 0.0 && reaction.live_p99 >= reaction.live_p50, "{report}");
        assert_undisturbed(system);
    });
}

#[test]
fn a_shadow_that_floods_its_topic_costs_no_scan() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let report = shadow(&system, &["controller", "--for", "4s", "--", FAULTY, "flood"]);
        assert_eq!(report.outcome, ShadowOutcome::Completed, "{report}");
        assert!(report.repeated > 10_000, "thousands a second: {report}");
        assert!(report.answered_share > 0.95, "{report}");
        assert_undisturbed(system);
    });
}

#[test]
fn a_shadow_that_hangs_or_dies_is_reported_and_costs_no_scan() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORTENED_LONG);
        let child = begin_shadow(&system, &["controller", "--to", "nmpc", "--for", "4s"]);
        system.wait_until("a shadow", |system| rows(system, Role::Controller).len() == 2);
        more_scans(&system, 8);
        system.signal(rows(&system, Role::Controller)[1].0, Signal::STOP);
        let report = shadow_report(&child.wait_with_output().unwrap());
        assert_eq!(report.outcome, ShadowOutcome::Silent, "{report}");
        assert!(report.reason.starts_with("no output in the last "), "{report}");
        assert!(report.answered > 0 && report.answered_share < 0.8, "{report}");
        let report = shadow(&system, &["controller", "--", FAULTY, "exit-after", "5"]);
        assert_eq!((report.outcome, report.answered), (ShadowOutcome::Died, 5), "{report}");
        assert!(report.reason.contains("exit code 1"), "{report}");
        let report = shadow(&system, &["controller", "--", "scanloop-no-such-command"]);
        assert!(report.reason.contains("was not found"), "{report}");
        let report = shadow(&system, &["controller", "--for", "1s", "--", "sleep", "60"]);
        assert_eq!((report.outcome, report.reason.as_str()), (ShadowOutcome::Silent, "it gave no output"));
        let report = shadow(&system, &["controller", "--for", "1s", "--", FAULTY, "nan"]);
        assert!(report.invalid > 0 && report.compared == 0, "{report}");
        assert_undisturbed(system);
    });
}

#[test]
fn an_interrupt_ends_it_early_with_the_report_so_far_and_so_does_the_end_of_the_run() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let child = begin_shadow(&system, &["estimator", "--to", "ekf", "--for", "1h"]);
        system.wait_until("a shadow", |system| rows(system, Role::Estimator).len() == 2);
        more_scans(&system, 10);
        system.signal(child.id().cast_signed(), Signal::INT);
        let report = shadow_report(&child.wait_with_output().unwrap());
        assert_eq!(report.outcome, ShadowOutcome::Interrupted);
        assert!(report.answered >= 3, "{report}");
        assert_eq!(rows(&system, Role::Estimator).len(), 1);
        let child = begin_shadow(&system, &["estimator", "--to", "ekf", "--for", "1h"]);
        system.wait_until("a shadow", |system| rows(system, Role::Estimator).len() == 2);
        let output = child.wait_with_output().unwrap();
        assert_eq!(shadow_report(&output).outcome, ShadowOutcome::RunEnded);
        assert_undisturbed(system);
    });
}

#[test]
fn a_role_has_one_candidate_at_most() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let refusal = |system: &TestSystem, arguments: &[&str]| {
            let output = system.run(arguments);
            assert_eq!(output.status.code(), Some(2));
            String::from_utf8_lossy(&output.stderr).into_owned()
        };
        assert!(refusal(&system, &["shadow", "controller", "--to", "nmpc"]).contains("is not running"));
        system.start(&SHORT_CORRIDOR);
        let child = begin_shadow(&system, &["controller", "--to", "nmpc", "--for", "1h"]);
        system.wait_until("a shadow", |system| rows(system, Role::Controller).len() == 2);
        for (arguments, message) in [
            (
                vec!["shadow", "controller", "--to", "nmpc"],
                "a process runs in the shadow of controller already",
            ),
            (
                vec!["swap", "controller", "--to", "nmpc"],
                "a process runs in the shadow of controller: end that first",
            ),
            (vec!["shadow", "controller", "--to", "ekf"], "one of nmpc for role controller"),
            (vec!["shadow", "pilot", "--to", "nmpc"], "unknown role `pilot`"),
            (vec!["shadow", "estimator", "--to", "ekf", "--for", "0s"], "0s is not allowed: 1s to 24h"),
            (vec!["shadow", "estimator"], "required"),
        ] {
            let printed = refusal(&system, &arguments);
            assert!(printed.contains(message), "{printed}");
        }
        system.signal(child.id().cast_signed(), Signal::INT);
        shadow_report(&child.wait_with_output().unwrap());
        assert_undisturbed(system);
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless", "--lockstep", "--duration", "9000"]);
        assert!(refusal(&system, &["shadow", "controller", "--to", "nmpc"]).contains("in real time"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        system.wait();
    });
}
