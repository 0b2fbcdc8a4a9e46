//! Live systems whose robot publishes no truth: driven to the goal, swapped, compared and adopted.

use emulator::{JudgedBy, Outcome};
use handover::shadow::ShadowOutcome;
use handover::swap::SwapOutcome;
use report::Report;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::{BUILT_IN, shadow, swap_in_vain, swap_seamlessly};
use scanloop_tests::{SHORT_CORRIDOR, SHORTENED_LONG, TestSystem};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");
const HIDDEN: [&str; 2] = ["--set", "robot.publish_truth=false"];

/// A system that drives without a truth.
fn driving(arguments: &[&str]) -> TestSystem {
    let mut system = TestSystem::new(EXECUTABLE);
    system.start(&[arguments, &HIDDEN].concat());
    system
}

/// Waits for a run that reaches its goal by the estimate.
fn reached(mut system: TestSystem) -> Report {
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    let report = system.report();
    assert_eq!((report.outcome, report.judged_by), (Outcome::Reached, JudgedBy::Estimate));
    assert_eq!((report.drive.truth, report.ride, report.scans.unaccounted), (None, None, 0));
    assert!(report.drive.final_distance_m <= 0.1 && report.drive.final_speed_mps <= 0.05);
    system.assert_nothing_left();
    report
}

#[test]
fn each_process_is_swapped_and_every_scan_answered() {
    repeat_when_late(|| {
        let system = driving(&SHORTENED_LONG);
        let swaps = BUILT_IN.map(|(role, name)| swap_seamlessly(&system, &[role.name(), "--to", name]));
        let report = reached(system);
        assert_eq!(report.swaps, swaps);
        assert_eq!(
            (report.scans.lost, report.scans.duplicates, report.ledger.residual),
            (0, 0, 0),
            "{report:?}"
        );
        assert_eq!(report.trajectory.len() as u64, report.scans.published);
        assert_eq!(report.latency_us.scan_to_actuation.count, report.scans.commanded);
    });
}

#[test]
fn a_shadow_of_the_robot_agrees_with_it_and_a_restart_loses_no_scan() {
    repeat_when_late(|| {
        let system = driving(&SHORT_CORRIDOR);
        let report = shadow(&system, &["robot", "--to", "emulator", "--for", "2s"]);
        assert_eq!((report.outcome, report.invalid), (ShadowOutcome::Completed, 0), "{report}");
        assert!(report.scans >= 10 && report.answered_share > 0.9, "{report}");
        let restarted = system.run(&["restart", "estimator"]);
        assert_eq!(restarted.status.code(), Some(0), "{}", String::from_utf8_lossy(&restarted.stderr));
        let report = reached(system);
        assert_eq!(
            (report.scans.lost, report.scans.duplicates, report.ledger.residual),
            (0, 0, 0),
            "{report:?}"
        );
        assert_eq!(report.processes.iter().map(|process| process.restarts).sum::<u32>(), 1);
    });
}

#[test]
fn an_adopted_run_is_still_judged_by_the_estimate_from_its_start() {
    repeat_when_late(|| {
        let mut system = driving(&SHORT_CORRIDOR);
        system.kill_orchestrator();
        system.adopt(&[]);
        let report = reached(system);
        let first = report.adopted_from_scan.unwrap();
        assert!(report.adopted && first > 3);
        // Scans come every 0.1 s from the start of the run on.
        let newest = first + report.scans.published - 1;
        assert!(
            (report.duration_s - newest as f64 * 0.1).abs() < 0.05,
            "{} s, scan {newest}",
            report.duration_s
        );
    });
}

#[test]
fn a_robot_without_a_truth_does_not_take_over_from_one_with_it() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&SHORT_CORRIDOR);
        let robot = system.pid(Role::Robot);
        let truthless = ["robot", "--", FAULTY, "robot", "truthless"];
        let reason = "it publishes no truth, by which this run is judged";
        swap_in_vain(&system, &truthless, SwapOutcome::Refused, reason);
        assert_eq!(system.pid(Role::Robot), robot);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert_eq!(system.report().judged_by, JudgedBy::Truth);
        system.assert_nothing_left();
    });
}
