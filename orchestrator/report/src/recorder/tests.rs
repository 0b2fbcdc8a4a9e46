//! The figures of short drives.

use super::*;
use crate::latency::tests::chain;
use crate::report::{DriveReport, Outcome};
use shared_types::{Header, Obstacle, ScannerState};
use vehicle::Surroundings;

fn info(lockstep: bool) -> RunInfo {
    RunInfo {
        run_id: String::new(),
        scenario: "corridor".to_owned(),
        seed: 1,
        surroundings: Surroundings::Open,
        course: None,
        lockstep,
        first_scan: 1,
        period_ns: 100_000_000,
        goals: vehicle::Goals::default(),
    }
}

fn truth(scan_id: u64, x_m: f64) -> Truth {
    let header = chain(scan_id, scan_id * 100_000_000);
    Truth {
        header,
        time_s: (scan_id - 1) as f64 * 0.1,
        x_m,
        goal_distance_m: 10.0 - x_m,
        min_clearance_m: 0.35,
        path_length_m: x_m,
        speed_mps: 0.8,
        ..Truth::default()
    }
}

fn pose(scan_id: u64, x_m: f64, y_m: f64) -> Pose {
    Pose { header: Header { scan_id, ..Header::default() }, x_m, y_m, ..Pose::default() }
}

fn answer(scan_id: u64) -> Actuation {
    Actuation { header: chain(scan_id, scan_id * 100_000_000), answers: 1, kind: 1, ..Actuation::default() }
}

fn drive(lockstep: bool) -> Recorder {
    let mut recorder = Recorder::new(info(lockstep));
    for scan_id in 1..=5 {
        recorder.pose(&pose(scan_id, scan_id as f64, 0.3));
        recorder.truth(&truth(scan_id, scan_id as f64 + 0.4));
        recorder.actuation(&answer(scan_id));
    }
    recorder
}

#[test]
fn the_report_holds_the_figures_of_the_samples() {
    let report = drive(false).report(&RunResult { outcome: Outcome::Timeout, ..RunResult::default() });
    assert_eq!(report.surroundings, Surroundings::Open);
    assert_eq!(
        (report.outcome, report.scenario.as_str(), report.duration_s),
        (Outcome::Timeout, "corridor", 0.4)
    );
    assert_eq!((report.scans.published, report.scans.commanded, report.scans.unaccounted), (5, 5, 0));
    assert_eq!(report.latency_us.scan_to_actuation.max, 2.55);
    assert_eq!(report.trajectory[4], [0.4, 5.4, 0.0, 0.0]);
    assert_eq!((report.drive.truth.unwrap().min_clearance_m, report.drive.path_length_m), (0.35, 5.4));
    assert!((report.drive.final_distance_m - 4.6).abs() < 1e-12);
}

#[test]
fn equal_runs_give_equal_bytes() {
    let report = |recorder: &Recorder| recorder.report(&RunResult::default()).to_json().unwrap();
    assert_eq!(report(&drive(true)), report(&drive(true)));
}

#[test]
fn in_lockstep_the_report_has_no_times_of_this_computer() {
    let mut recorder = drive(true);
    recorder.command(&Command { status: 1, iterations: 4, solve_ns: 5000, ..Command::default() });
    let report = recorder.report(&RunResult::default());
    assert_eq!((report.latency_us.scan_to_actuation.count, report.controller.solve_us.count), (0, 0));
    assert_eq!((report.controller.iterations.p50, report.scans.commanded), (4.0, 5));
    assert_eq!(recorder.view().reaction_ms, None);
}

#[test]
fn a_refused_command_is_the_reason_of_its_lost_scan() {
    let mut recorder = drive(false);
    recorder.truth(&truth(6, 6.4));
    let mut block = Actuation { reason: BlockReason::InvalidCommand.wire(), ..Actuation::default() };
    block.header.scan_id = 6;
    recorder.actuation(&block);
    let scans = recorder.report(&RunResult::default()).scans;
    assert_eq!((scans.lost, scans.lost_reasons["invalid_command"]), (1, 1));
}

#[test]
fn the_view_shows_the_median_and_the_worst_of_the_last_second() {
    let mut recorder = Recorder::new(info(false));
    for (scan_id, actuator_ns) in [(1, 900_000_000), (20, 3_000_000), (21, 2_000_000), (22, 9_000_000)] {
        let mut actuation = answer(scan_id);
        actuation.header.stage_mut(Role::Actuator).published_ns = scan_id * 100_000_000 + actuator_ns;
        recorder.actuation(&actuation);
    }
    assert_eq!(recorder.view().reaction_ms, Some([3.0, 9.0]), "the first answer is older than a second");
}

#[test]
fn without_truth_the_distance_to_the_goal_is_the_estimated_one() {
    let mut recorder = Recorder::new(info(false));
    recorder.pose(&pose(1, 7.0, 4.0));
    assert_eq!(recorder.view().goal_distance_m, Some(5.0));
    let drive = recorder.report(&RunResult::default()).drive;
    let clearance_m = drive.truth.map(|truth| truth.min_clearance_m);
    assert_eq!((drive.final_distance_m, clearance_m), (5.0, Some(crate::report::NO_OBSTACLE_M)));
}

#[test]
fn a_robot_without_a_truth_has_the_drive_of_its_estimate() {
    let mut recorder = Recorder::new(RunInfo { first_scan: 0, ..info(false) });
    recorder.expect_no_truth();
    // The first scan that is seen is the 21st of the run.
    for scan_id in 21..=25 {
        let header = chain(scan_id, scan_id * 100_000_000);
        recorder.scan(&header);
        let x_m = 0.08 * scan_id as f64;
        recorder.pose(&Pose { header, x_m, y_m: 0.1 * x_m, speed_mps: 0.8, ..Pose::default() });
        recorder.actuation(&answer(scan_id));
    }
    let report = recorder.report(&RunResult::default());
    assert_eq!((report.judged_by, report.drive.truth, report.ride), (JudgedBy::Estimate, None, None));
    assert_eq!((report.scans.published, report.scans.commanded, report.scans.unaccounted), (5, 5, 0));
    let DriveReport { final_distance_m, final_speed_mps, path_length_m, max_abs_lateral_m, .. } =
        report.drive;
    // The front beam is a microsecond before the time of the scan.
    let figures = [report.duration_s, final_distance_m, path_length_m, max_abs_lateral_m];
    for (figure, expected) in figures.into_iter().zip([2.5, 8.002_499, 0.32, 0.032]) {
        assert!((figure - expected).abs() < 2e-6, "{figures:?}");
    }
    assert_eq!((final_speed_mps, recorder.view().speed_mps), (0.8, 0.8));
    let [time_s, x_m, y_m, _] = report.trajectory[0];
    assert!((time_s - 2.1).abs() < 2e-6 && (x_m, y_m) == (1.68, 0.168), "{:?}", report.trajectory);
}

#[test]
fn the_obstacle_of_the_last_stop_is_reported_and_shown_while_it_lasts() {
    let mut recorder = drive(true);
    let blocking = Blocking { x_m: 6.0, y_m: 0.1, gap_m: 0.12, needed_m: 0.62, id: 17, reserved: 0 };
    let stop = Command { reason: StopReason::Blocked.wire(), blocking, ..Command::default() };
    recorder.command(&stop);
    assert_eq!((recorder.stopped_for(), recorder.view().blocking), (Some(blocking), Some(blocking)));
    recorder.command(&Command { reason: StopReason::SelfCheck.wire(), ..Command::default() });
    assert_eq!((recorder.stopped_for(), recorder.view().blocking), (None, None));
    let report = recorder.report(&RunResult::default());
    assert_eq!(report.blocking, Some(blocking.into()));
    assert_eq!(drive(true).report(&RunResult::default()).blocking, None);
}

#[test]
fn a_stop_for_the_scanner_is_shown_with_its_state_while_it_lasts() {
    let mut recorder = drive(true);
    let scanner = ScannerHealth { state: ScannerState::Stuck.wire(), ..ScannerHealth::healthy(0.0) };
    let obstacles = Obstacles { scanner, ..Obstacles::default() };
    recorder.obstacles(&obstacles);
    assert_eq!((recorder.stopped_for_scanner(), recorder.view().scanner), (None, None));
    recorder.command(&Command { reason: StopReason::Scanner.wire(), ..Command::default() });
    assert_eq!(recorder.stopped_for_scanner(), Some(obstacles.scanner));
    assert_eq!(recorder.view().scanner, Some(obstacles.scanner));
    recorder.command(&Command { reason: StopReason::Blocked.wire(), ..Command::default() });
    assert_eq!((recorder.stopped_for_scanner(), recorder.scanner()), (None, Some(obstacles.scanner)));
    assert_eq!(recorder.report(&RunResult::default()).scanner.stuck_scans, 1);
}

#[test]
fn the_last_version_of_each_ellipse_is_drawn() {
    let mut recorder = Recorder::new(info(false));
    let mut obstacles = Obstacles { count: 2, ..Obstacles::default() };
    for (x_m, count) in [(5.0, 2), (5.1, 1)] {
        obstacles.items[0] = Obstacle { id: 7, x_m, a_m: 1.2, b_m: 0.8, ..Obstacle::default() };
        obstacles.items[1] = Obstacle { id: 9, x_m: 8.0, a_m: 1.2, b_m: 0.8, ..Obstacle::default() };
        obstacles.count = count;
        recorder.obstacles(&obstacles);
    }
    let centres: Vec<f64> = recorder.drive().ellipses.iter().map(|ellipse| ellipse.x_m).collect();
    assert_eq!(centres, [5.1, 8.0]);
}
