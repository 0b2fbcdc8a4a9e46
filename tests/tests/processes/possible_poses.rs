//! Poses that no robot can have are not published, and the wheels stand still then: through real runs.

use emulator::Outcome;
use report::Report;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{TestSystem, system_file};
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");

/// The true robot has not moved during the last second of a run, and no number of its way is wild.
fn assert_wheels_stand(report: &Report) {
    let ways = &report.trajectory;
    let [.., last] = ways.as_slice() else { panic!("no trajectory") };
    assert!(ways.iter().flatten().all(|value| value.is_finite() && value.abs() < 100.0), "{last:?}");
    let rest: Vec<_> = ways.iter().filter(|place| place[0] > last[0] - 1.0).collect();
    assert!(rest.len() >= 9, "{}", ways.len());
    assert!(rest.iter().all(|place| place[1..] == last[1..]), "{rest:?}");
}

#[test]
fn odometry_from_where_no_track_is_gives_no_pose_and_the_wheels_stop() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        let robot = system_file(10, &[Role::Robot], FAULTY, &["astray"]);
        std::fs::write(system.folder().join("system.toml"), robot).unwrap();
        system.start(&["--system", "system.toml", "--set", "stop_final_s=2"]);
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        let report = system.report();
        assert_eq!(report.outcome, Outcome::Stopped, "{}", report.reason);
        let row = report.ledger.refused.iter().find(|row| row.field == "x_m").expect("it is counted");
        assert!(row.count > 10 && row.value > 3e5, "{row:?}");
        assert_wheels_stand(&report);
        // Ten scans of 0.1 m each at most, and the way to stop.
        let [.., last] = report.trajectory.as_slice() else { panic!("no trajectory") };
        assert!((0.5..2.6).contains(&last[1]), "it drove until its odometry went astray: {last:?}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_described_vehicle_that_turns_round_by_itself_stops_the_robot_and_is_named() {
    let system = TestSystem::new(EXECUTABLE);
    // What the estimator alone believes: heavy and short, with most of it in front.
    let keys = [
        "estimator.vehicle.mass_kg=1e6",
        "estimator.vehicle.rear_m=0.001",
        "estimator.vehicle.front_m=0.003",
        "estimator.vehicle.stiffness_n_per_rad=1e4",
        "estimator.vehicle.inertia_kgm2=0.001",
    ];
    let mut arguments = vec!["run", "--lockstep", "--quiet", "--out", "out"];
    arguments.extend(keys.iter().flat_map(|key| ["--set", key]));
    let output = system.run(&arguments);
    let message = scanloop_tests::printed(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    let report = system.report();
    assert_eq!(
        (report.outcome, report.self_check.suspect.as_str()),
        (Outcome::Stopped, "vehicle"),
        "{}",
        report.reason
    );
    assert!(report.self_check.rejected > 0, "{:?}", report.self_check);
    assert_wheels_stand(&report);
    system.assert_nothing_left();
}

/// The values at which an explicit method diverged, and the smallest lags.
#[test]
fn the_stiffest_robots_that_are_allowed_drive_as_the_shipped_one() {
    for key in [
        "robot.stiffness_n_per_rad=1e6",
        "robot.inertia_kgm2=1e-3",
        "vehicle.stiffness_n_per_rad=1e6",
        "vehicle.inertia_kgm2=1e-3",
        "vehicle.mass_kg=1e-3",
        "robot.steering_lag_s=1e-6",
    ] {
        let system = TestSystem::new(EXECUTABLE);
        let output = system.run(&["run", "--lockstep", "--quiet", "--out", "out", "--set", key]);
        let message = scanloop_tests::printed(&output);
        assert_eq!(output.status.code(), Some(0), "{key}: {message}");
        let report = system.report();
        assert!(report.drive.truth.unwrap().estimate_error_max_m < 0.1, "{key}: {message}");
    }
}
