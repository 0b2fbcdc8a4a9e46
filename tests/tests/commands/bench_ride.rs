//! `scanloop bench ride` on one scenario, and the same figures in the report of a run.

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

#[test]
fn a_scenario_has_its_regret_and_a_run_reports_the_same_figures() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["bench", "ride", "corridor", "--json", "--problems", "problems"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("second differences") && text.contains("\ncorridor "), "{text}");
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    let row = &results["scenarios"][0];
    let objective = |side: &str| row[side]["objective"].as_f64().unwrap();
    let regret = row["regret"].as_f64().unwrap();
    assert!((regret - objective("driven") / objective("optimum")).abs() < 1e-12 && regret > 0.99, "{row}");
    assert_eq!((&row["outcome"], &results["faults"]), (&Value::from("reached"), &Value::Array(Vec::new())));
    assert_eq!(results["summary"]["regret"]["max"], row["regret"]);
    let goals = [
        ("steering_total_variation_rad", "driven", "steering_total_variation_rad"),
        ("optimum_total_variation_rad", "optimum", "steering_total_variation_rad"),
        ("second_difference_rad", "driven", "steering_second_difference_rad"),
        ("optimum_second_difference_rad", "optimum", "steering_second_difference_rad"),
        ("step_max_rad", "driven", "steering_step_max_rad"),
        ("clearance_m", "driven", "min_clearance_m"),
        ("optimum_clearance_m", "optimum", "min_clearance_m"),
    ];
    for (goal, side, figure) in goals {
        assert!(row[goal].is_number() && row[goal] == row[side][figure], "{goal}: {row}");
    }
    let count = |key: &str| row[key].as_u64().unwrap();
    let (plans, active) = (count("plans"), count("active_ellipse_plans"));
    assert!(20 < active && active < plans && plans < 200, "{active} of {plans}");

    let problems = std::fs::read_to_string(system.folder().join("problems/corridor.json")).unwrap();
    let problems: Value = serde_json::from_str(&problems).unwrap();
    let last = problems["plans"].as_array().unwrap().last().unwrap();
    assert_eq!(last["ellipses"].as_array().unwrap().len(), 1);
    assert_eq!(last["states"].as_array().unwrap().len(), last["intervals_s"].as_array().unwrap().len() + 1);

    let ideal = ["--lockstep", "--quiet", "--set", "robot.preset=ideal", "--out", "out"];
    let output = system.run(&[&["run", "corridor"], &ideal[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value =
        serde_json::from_str(&std::fs::read_to_string(system.folder().join("out/report.json")).unwrap())
            .unwrap();
    assert_eq!(report["ride"], row["driven"]);
}

#[test]
fn random_courses_have_seeds_and_a_summary_of_their_families() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["bench", "ride", "--random", "2", "--seed", "134", "--json"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(results["scenarios"].as_array().unwrap().len(), 2);
    assert_eq!(
        (&results["scenarios"][0]["seed"], &results["scenarios"][0]["family"]),
        (&134.into(), &"plain".into())
    );
    let [regret, families] = ["regret", "families"].map(|key| &results["summary"][key]);
    assert!(
        regret["mean"].as_f64() <= regret["max"].as_f64() && families["plain"]["p95"].is_number(),
        "{results}"
    );
    assert!(text.contains("worst           course-"), "{text}");
}

#[test]
fn a_drive_that_stops_before_its_goal_has_no_regret() {
    let system = TestSystem::new(EXECUTABLE);
    let output = system.run(&["bench", "ride", "blocked", "--json"]);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.contains("no regret       blocked: stopped"), "{text}");
    let results: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&results["scenarios"][0]["regret"], &results["summary"]), (&Value::Null, &Value::Null));
}
