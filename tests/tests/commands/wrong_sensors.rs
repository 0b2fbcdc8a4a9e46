//! A scanner that shows where nothing is leads the robot into nothing, and does not move its pose; wheels that slip do not stop it.

use emulator::Outcome;
use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Its scans are those of a robot that was lifted and turned: such a robot finds itself and drives on, and met the box.
#[test]
fn a_scanner_that_turns_on_its_mount_is_no_robot_that_was_lifted() {
    let system = TestSystem::new(EXECUTABLE);
    let course = "[goal]\nx_m = 8.5\n[robot]\npreset = \"summit\"\n\
         [[obstacle]]\nshape = \"box\"\nx_m = 4.0\ny_m = -0.15\nlength_m = 0.1\nwidth_m = 0.4\n";
    std::fs::write(system.folder().join("course.toml"), course).unwrap();
    for (index, yaw_rad) in [-0.3, -0.2, -0.1, 0.1, 0.15, 0.2, 0.25, 0.3, 0.5].into_iter().enumerate() {
        for from_s in [2.0, 2.4, 2.8, 3.2].map(|from_s| from_s + 0.03 * index as f64) {
            let [yaw, from] = [format!("scanner.yaw_rad={yaw_rad}"), format!("scanner.from_s={from_s}")];
            let report = system.lockstep(&["course.toml", "--set", &yaw, "--set", &from]);
            let truth = report.drive.truth.unwrap();
            let drive = format!("{yaw_rad} rad at {from_s} s: {}, {truth:?}", report.reason);
            assert!(!truth.collided && !truth.struck && truth.min_clearance_m > 0.0, "{drive}");
            assert_eq!(report.outcome, Outcome::Stopped, "{drive}");
        }
    }
}

/// Ranges from before it moved say that the robot has not moved: it was half a metre wrong.
#[test]
fn a_scanner_that_is_stuck_does_not_hold_the_pose() {
    let system = TestSystem::new(EXECUTABLE);
    let stuck = ["scanner.stuck_s=3", "scanner.from_s=3", "scanner.to_s=6.2", "goal.x_m=15"];
    for preset in ["ideal", "summit", "worn"] {
        let preset = format!("robot.preset={preset}");
        let sets: Vec<&str> = stuck.into_iter().chain([&*preset]).flat_map(|set| ["--set", set]).collect();
        let report = system.lockstep(&[&["free"][..], &sets].concat());
        let truth = report.drive.truth.unwrap();
        assert!(truth.estimate_error_max_m < 0.03, "{preset}: {truth:?}");
        assert_eq!(report.outcome, Outcome::Reached, "{preset}: {}", report.reason);
    }
}

/// Wheels that slip by 10 cm in a metre, and a gyro that turns by 50 mrad in a second: by them alone it is lost after a few
/// metres, and the self-check stopped it.
#[test]
fn a_robot_whose_wheels_are_described_to_slip_reaches_its_goal_and_its_recording_is_replayed() {
    let system = TestSystem::new(EXECUTABLE);
    let mut arguments = vec!["corridor".to_owned(), "--record=slips.mcap".to_owned()];
    for of in ["robot", "vehicle"] {
        for (key, value) in [("encoder_slip_m", 0.1), ("gyro_noise_rad", 0.05)] {
            arguments.extend(["--set".to_owned(), format!("{of}.{key}={value}")]);
        }
    }
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let report = system.lockstep(&arguments);
    let truth = report.drive.truth.unwrap();
    assert_eq!(report.outcome, Outcome::Reached, "{}", report.reason);
    assert!(!truth.collided && truth.min_clearance_m > 0.05, "{truth:?}");
    let output = system.run(&["replay", "slips.mcap"]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
}
