//! Robots that publish no truth: judged by the estimate, and by the same drive with the truth.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use emulator::{JudgedBy, Outcome, Scenario};
use report::Report;
use scanloop_tests::{TestSystem, system_file};
use serde_json::Value;
use shared_types::Role;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY: &str = env!("CARGO_BIN_EXE_faulty");
const HIDDEN: [&str; 2] = ["--set", "robot.publish_truth=false"];
/// What `report.json` has of a drive only where the truth is known.
const OF_TRUTH: [&str; 7] = [
    "collided",
    "struck",
    "min_clearance_m",
    "estimate_error_max_m",
    "estimate_error_rms_m",
    "covariance_coverage",
    "longest_blind_s",
];

/// A drive in lock-step: exit code, report, and the report as JSON.
fn drive(arguments: &[&str]) -> (i32, Report, Value) {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&[&["run", "--lockstep", "--quiet", "--out", "out"], arguments].concat());
    let path = system.folder().join("out/report.json");
    let text = std::fs::read_to_string(&path).unwrap();
    system.assert_nothing_left();
    let is_noted = String::from_utf8_lossy(&output.stderr).contains("no truth");
    let report: Report = serde_json::from_str(&text).unwrap();
    assert_eq!(
        is_noted,
        report.judged_by == JudgedBy::Estimate,
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    (output.status.code().unwrap(), report, serde_json::from_str(&text).unwrap())
}

/// Drives with and without the truth, and checks what holds for each pair.
fn drive_both(arguments: &[&str]) -> [(i32, Report); 2] {
    let (code, with, json) = drive(arguments);
    assert!(OF_TRUTH.iter().all(|key| json["drive"].get(key).is_some()));
    let has_course = Scenario::shipped(arguments[0]).is_some_and(|text| text.contains("[course]"));
    assert_eq!(json.get("ride").is_none(), has_course, "a course has no figures of the ride");
    assert_eq!(json["judged_by"], "truth");
    let (blind_code, without, json) = drive(&[arguments, &HIDDEN].concat());
    for key in OF_TRUTH {
        assert_eq!(json["drive"].get(key), None, "{key}");
    }
    assert_eq!((&json["judged_by"], json.get("ride")), (&Value::from("estimate"), None));
    assert_eq!((without.scans.unaccounted, without.ledger.residual), (0, 0), "{:?}", without.ledger.faults);
    [(code, with), (blind_code, without)]
}

/// Asserts that the same drive was judged in the same way, up to the error of the estimate.
fn assert_same(name: &str, [(code, with), (blind_code, without)]: &[(i32, Report); 2]) {
    assert_eq!((code, with.outcome), (blind_code, without.outcome), "{name}: {}", without.reason);
    let mut digests = with.digests.clone();
    assert!(digests.remove("truth").is_some() && digests.len() >= 4, "{name}: {digests:?}");
    assert_eq!(digests, without.digests, "{name}: every sample of the stages is the same to the last bit");
    assert_eq!(with.scans, without.scans, "{name}");
    assert_eq!(with.trajectory.len(), without.trajectory.len(), "{name}: one row per scan");
    // A stamp may err by some milliseconds.
    assert!((with.duration_s - without.duration_s).abs() < 0.02, "{name}: {}", without.duration_s);
    let error_m = with.drive.truth.unwrap().estimate_error_max_m + 1e-9;
    let (drive, blind) = (&with.drive, &without.drive);
    assert!((drive.final_distance_m - blind.final_distance_m).abs() <= error_m, "{name}: {blind:?}");
    assert!((drive.max_abs_lateral_m - blind.max_abs_lateral_m).abs() <= 2.0 * error_m, "{name}: {blind:?}");
    assert!((drive.path_length_m / blind.path_length_m - 1.0).abs() < 0.03, "{name}: {blind:?}");
    for ([time_s, x_m, y_m, _], [blind_s, blind_x_m, blind_y_m, _]) in
        with.trajectory.iter().zip(&without.trajectory)
    {
        assert!((time_s - blind_s).abs() < 0.02, "{name}: {time_s} {blind_s}");
        assert!((x_m - blind_x_m).hypot(y_m - blind_y_m) <= error_m, "{name}: at {time_s} s");
    }
}

#[test]
fn every_shipped_scenario_ends_as_with_the_truth() {
    let mut outcomes = Vec::new();
    for name in Scenario::names() {
        let endless: &[&str] = if name == "endless" { &["--duration", "15"] } else { &[] };
        let both = drive_both(&[&[name], endless].concat());
        assert_same(name, &both);
        outcomes.push(both[1].1.outcome);
    }
    for outcome in [Outcome::Reached, Outcome::Stopped, Outcome::Timeout] {
        assert!(outcomes.contains(&outcome), "{outcome} in {outcomes:?}");
    }
}

#[test]
fn a_timeout_and_another_goal_are_judged_alike() {
    for arguments in [
        &["free", "--set", "timeout_s=3.0"][..],
        &["free", "--set", "goal.x_m=4.0", "--set", "stop_final_s=1.0"],
    ] {
        assert_same(&arguments.join(" "), &drive_both(arguments));
    }
}

#[test]
fn gaps_of_an_irregular_scanner_are_no_stop() {
    let irregular = ["corridor", "--set", "scanner.period_s=[0.005, 0.255]", "--set", "stop_final_s=0.5"];
    for (code, report) in drive_both(&irregular) {
        assert!(report.stop_reasons["gap"] > 5, "{:?}", report.stop_reasons);
        assert_eq!((code, report.outcome), (0, Outcome::Reached), "{}", report.reason);
    }
}

#[test]
fn a_collision_that_only_the_truth_shows_is_not_claimed() {
    // It appears where no stop is possible.
    let sudden = ["sudden", "--set", "obstacle.0.appears_ahead_m=0.1"];
    let [(code, with), (blind_code, without)] = drive_both(&sudden);
    assert_eq!((code, with.outcome), (3, Outcome::Collision), "{}", with.reason);
    assert!(with.drive.truth.unwrap().collided);
    assert_eq!((blind_code, without.outcome), (1, Outcome::Stopped), "{}", without.reason);
    assert_eq!(without.drive.truth, None);
}

#[test]
fn a_robot_that_promises_a_truth_and_publishes_none_ends_the_run_with_its_name() {
    for (fault, since) in [("withholding", 1), ("forgetful", 20)] {
        let system = TestSystem::new(EXECUTABLE);
        let path = system.folder().join("system.toml");
        std::fs::write(&path, system_file(10, &[Role::Robot], FAULTY, &[fault])).unwrap();
        // At 1 kHz lock-step grants fewer scans than a delay may explain.
        for mode in [&["--lockstep"][..], &["--lockstep", "--set", "rate_hz=1000"], &[]] {
            let arguments = ["run", "--quiet", "--out", "out", "endless", "--system", path.to_str().unwrap()];
            let output = system.run(&[&arguments, mode].concat());
            let report = Report::read(&system.folder().join("out/report.json")).unwrap();
            assert_eq!(
                (output.status.code(), report.outcome),
                (Some(4), Outcome::Failed),
                "{}",
                report.reason
            );
            let found = report.reason.split("since scan ").nth(1).and_then(|rest| rest.split(';').next());
            let found = found.and_then(|scan| scan.parse::<u64>().ok());
            let found = found.unwrap_or_else(|| panic!("{fault}: {}", report.reason));
            // On a busy machine the orchestrator finds several scans at once when it looks for the first time.
            let is_near = (since..since + 10).contains(&found);
            let named = report.reason.contains(FAULTY) && is_near;
            assert!(named && report.judged_by == JudgedBy::Truth, "{fault}: {}", report.reason);
            system.assert_nothing_left();
        }
    }
}

#[test]
fn a_program_that_opens_no_truth_is_judged_by_the_estimate_too() {
    let system = TestSystem::new(EXECUTABLE);
    let path = system.folder().join("system.toml");
    std::fs::write(&path, system_file(10, &[Role::Robot], FAULTY, &["truthless"])).unwrap();
    let report = system.lockstep(&["free", "--system", path.to_str().unwrap()]);
    assert_eq!(
        (report.outcome, report.judged_by),
        (Outcome::Reached, JudgedBy::Estimate),
        "{}",
        report.reason
    );
    assert_eq!((report.scans.unaccounted, report.scans.lost, report.drive.truth), (0, 0, None));
    system.assert_nothing_left();
}

#[test]
fn latency_is_measured_without_a_truth() {
    let system = TestSystem::new(EXECUTABLE);
    let short = ["bench", "latency", "--rate", "50", "--duration", "1.2", "--quiet", "--json"];
    let output = system.run(&[&short, &HIDDEN[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    let count = |key: &str| results[key].as_u64().unwrap_or_else(|| panic!("{key}: {results}"));
    assert!(count("published") >= 60 && count("commanded") > 50, "{results}");
    assert_eq!((count("unaccounted"), count("complete_chains")), (0, count("commanded")));
    assert_eq!(results["scan_to_actuation_us"]["count"], results["commanded"]);
    system.assert_nothing_left();
}
