//! A robot is calibrated from its own runs and then reaches its goal; what cannot be calibrated is refused.

use scanloop_tests::TestSystem;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn the_imperfect_robot_reaches_its_goal_with_its_own_calibration() {
    let system = TestSystem::new(EXECUTABLE);
    for kind in ["velocity", "steering", "drift"] {
        let output = system.run(&[
            "calibrate",
            kind,
            "--drive",
            "--scenario",
            "imperfect-robot",
            "--out",
            "cal",
            "--json",
        ]);
        assert!(output.status.success(), "{kind}: {}", String::from_utf8_lossy(&output.stderr));
        let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(json[kind]["runs"].as_u64().unwrap() >= 4, "{json}");
        assert!(system.folder().join(format!("cal/{kind}.svg")).is_file());
        // The table that was driven is one that can be recorded.
        let table = format!("cal/{kind}.csv");
        let again = system.run(&["calibrate", kind, &table, "--out", "again", "--json"]);
        let again: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
        assert_eq!(json[kind]["runs"], again[kind]["runs"]);
    }
    let report = system.lockstep(&["imperfect-robot", "--calibration", "cal/calibration.toml"]);
    assert_eq!(report.outcome, emulator::Outcome::Reached, "{}", report.reason);
    // The robot of the default scenario stands when the run begins.
    let output = system.run(&["calibrate", "drift", "--drive", "--out", "default", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let longitudinal = json["drift"]["longitudinal"]["value"].as_f64().unwrap();
    assert!((longitudinal - 0.01).abs() < 0.001, "{json}");
}

#[test]
fn runs_and_files_that_cannot_be_used_are_refused_with_the_reason() {
    let system = TestSystem::new(EXECUTABLE);
    let runs = system.folder().join("runs.csv");
    let refused = |arguments: &[&str], names: &[&str]| {
        let output = system.run(arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        for name in names {
            assert!(message.contains(name), "`{name}` is missing in: {message}");
        }
    };
    std::fs::write(&runs, "sent_velocity_mps,distance_m,time_s\n1.0,6.0,8.4\n1.3,6.0,x\n").unwrap();
    refused(&["calibrate", "velocity", "runs.csv"], &["runs.csv: line 3", "time_s"]);
    std::fs::write(&runs, "sent_velocity_mps,distance_m,time_s\n1.0,6.0,8.4\n1.3,6.0,6.5\n").unwrap();
    refused(&["calibrate", "velocity", "runs.csv"], &["2 straight runs are too few", "5"]);
    refused(&["calibrate", "velocity"], &["CSV"]);
    refused(&["calibrate", "steering", "--drive", "--set", "robot.steering_backlash_rad=9"], &["0 to 0.1"]);
    std::fs::write(&runs, "schema = 1\n").unwrap();
    refused(&["run", "--calibration", "runs.csv"], &["runs.csv", "nothing is calibrated"]);
    system.assert_nothing_left();
}
