//! `scanloop analyse` gives the figures of the source and of the independent computation, and refuses bad options.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// What an analysis answers: exit code, table and data.
struct Answer {
    code: i32,
    table: String,
    data: Value,
}

/// Runs an analysis with `--json` and checks that it has drawn its picture and printed its definition.
fn ask(arguments: &[&str]) -> Answer {
    let system = TestSystem::new(EXECUTABLE);
    let all = [&["analyse"], arguments, &["--json", "--out", "pictures"]].concat();
    let output = system.run(&all);
    let table = String::from_utf8(output.stderr).unwrap();
    let data: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {table}"));
    let picture = system.folder().join("pictures").join(format!("{}.svg", arguments[0]));
    assert!(std::fs::read_to_string(&picture).unwrap().starts_with("<svg"), "{arguments:?}");
    assert!(table.contains("definition") && table.contains(".svg"), "{table}");
    assert!(data["definition"].as_str().is_some_and(|text| text.len() > 40), "{data}");
    Answer { code: output.status.code().unwrap(), table, data }
}

#[test]
fn full_measurement_has_rank_three_and_yaw_alone_is_refused_with_the_reason() {
    let full = ask(&["observability"]);
    assert_eq!((full.code, full.data["rank"].as_u64()), (0, Some(3)), "{}", full.table);
    let position = ask(&["observability", "--measure", "x,y", "--moving"]);
    assert_eq!((position.code, position.data["rank"].as_u64()), (0, Some(3)), "{}", position.table);
    let standing = ask(&["observability", "--measure", "x,y", "--standing"]);
    assert_eq!((standing.code, standing.data["rank"].as_u64()), (1, Some(2)), "{}", standing.table);
    assert_eq!(standing.data["open"], serde_json::json!(["yaw"]));
    let yaw = ask(&["observability", "--measure", "yaw"]);
    assert_eq!((yaw.code, yaw.data["rank"].as_u64()), (1, Some(1)), "{}", yaw.table);
    assert!(yaw.table.contains("rank 1 of 3") && yaw.table.contains("x is open"), "{}", yaw.table);
}

#[test]
fn the_controls_are_not_correlated_at_the_operating_point_of_the_source() {
    let answer = ask(&["correlation", "--velocity", "0.5", "--steering", "-0.0074"]);
    let number = |key: &str| answer.data[key].as_f64().unwrap();
    assert_eq!(answer.code, 0, "{}", answer.table);
    assert!((number("angle_deg") - 95.4).abs() < 0.3, "{}", answer.table);
    assert!((number("min_angle_deg") - 84.6).abs() < 0.3, "{}", answer.table);
    // 52 to 128 degrees over the box.
    assert!((number("box_min_angle_deg") - 52.0).abs() < 1.0, "{}", answer.table);
    assert_eq!(answer.data["bfgs_admissible"], true);
    assert!(answer.table.contains("BFGS is admissible"), "{}", answer.table);
}

#[test]
fn six_intervals_are_found_by_the_definition_of_the_source() {
    let source = ["--scheme", "gauss-2", "--error", "position-ends", "--controls", "constant"];
    let answer = ask(&[&["intervals"], source.as_slice(), &["--tf", "2.72", "--tol", "2.5e-4"]].concat());
    assert_eq!((answer.code, answer.data["n"].as_u64()), (0, Some(6)), "{}", answer.table);
    assert!((answer.data["max_error"].as_f64().unwrap() / 2.418e-4 - 1.0).abs() < 0.01, "{}", answer.table);
    let errors: Vec<f64> =
        answer.data["errors"].as_array().unwrap().iter().map(|error| error.as_f64().unwrap()).collect();
    for (error, oracle) in errors.iter().zip([5.2e-4, 4.47e-4, 3.96e-4, 3.39e-4, 2.87e-4, 2.418e-4, 2.03e-4])
    {
        assert!((error / oracle - 1.0).abs() < 0.01, "{errors:?}");
    }
    let worst = &answer.data["worst_controls"][0];
    assert!((worst["velocity_mps"].as_f64().unwrap() - 1.0).abs() < 1e-6, "{worst}");
    assert!((worst["steering_rad"].as_f64().unwrap().abs() - 0.06).abs() < 1e-6, "{worst}");
    // The other definitions are printed too, and none but those of held positions is near the tolerance.
    let others = answer.data["other_definitions"].as_array().unwrap();
    assert_eq!(others.len(), 6);
    let largest = |error: &str, controls: &str| {
        let found =
            others.iter().find(|other| other["error"] == error && other["controls"] == controls).unwrap();
        found["max_error"].as_f64().unwrap()
    };
    assert!(largest("all-states-ends", "constant") > 1e-3 && largest("position-ends", "piecewise") > 1e-3);
    let schemes = answer.data["other_schemes"].as_array().unwrap();
    for (name, n) in [("radau-2", 4), ("gauss-3", 3), ("radau-3", 1)] {
        let found = schemes.iter().find(|scheme| scheme["scheme"] == name).unwrap();
        assert_eq!(found["n"].as_u64(), Some(n), "{name}");
    }
}

#[test]
fn six_intervals_carry_2_81_seconds_and_more_on_a_free_grid() {
    let equal = ask(&["intervals", "--n", "6"]);
    let longest = |answer: &Answer| answer.data["max_tf_s"].as_f64().unwrap();
    assert!((longest(&equal) - 2.81).abs() < 0.01, "{}", equal.table);
    assert_eq!(equal.data["n"].as_u64(), Some(6));
    let free = ask(&["intervals", "--n", "3", "--grid", "free"]);
    assert!(longest(&free) > longest(&ask(&["intervals", "--n", "3"])), "{}", free.table);
    let sum: f64 =
        free.data["lengths_s"].as_array().unwrap().iter().map(|length| length.as_f64().unwrap()).sum();
    assert!((sum - 2.72).abs() < 1e-9, "{}", free.table);
}

#[test]
fn a_tolerance_that_no_number_keeps_ends_with_exit_code_one() {
    let answer = ask(&["intervals", "--error", "all-states-ends", "--limit", "4"]);
    assert_eq!(answer.code, 1);
    assert!(answer.data["n"].is_null() && answer.table.contains("more than 4"), "{}", answer.table);
    assert_eq!(answer.data["errors"].as_array().unwrap().len(), 4);
}

#[test]
fn the_forms_of_the_correction_are_compared_on_three_robots() {
    let answer = ask(&["drift"]);
    assert_eq!(answer.code, 0);
    let left = |robot: usize, form: usize, time: usize| {
        answer.data["robots"][robot]["forms"][form]["largest_error_m"][time].as_f64().unwrap()
    };
    // The source's robot after 5 s: at most 0.08 m with the printed form, more than 0.5 m without.
    assert!(left(0, 0, 0) > 0.5 && left(0, 1, 0) <= 0.08, "{}", answer.table);
    // Play without a mean is made worse, after 20 s, by every form.
    assert!((1..5).all(|form| left(1, form, 2) > left(1, 0, 2)), "{}", answer.table);
}

#[test]
fn the_same_question_has_the_same_answer() {
    let question = ["intervals", "--controls", "piecewise", "--limit", "3"];
    assert_eq!(ask(&question).data, ask(&question).data);
}

#[test]
fn bad_options_are_named_with_value_and_range() {
    let system = TestSystem::new(EXECUTABLE);
    let refused = |arguments: &[&str], names: &[&str]| {
        let output = system.run(&[&["analyse"], arguments].concat());
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        for name in names {
            assert!(message.contains(name), "{arguments:?}: `{name}` is missing in: {message}");
        }
    };
    refused(&["observability", "--measure", "speed"], &["--measure", "speed", "yaw"]);
    refused(&["observability", "--measure", "x,x"], &["--measure", "x,x", "at most once"]);
    refused(&["observability", "--velocity", "0"], &["--velocity", "0.1 to 1"]);
    refused(&["correlation", "--steering", "0.5"], &["--steering", "0.5", "-0.06 to 0.06"]);
    refused(&["correlation", "--velocity", "nan"], &["--velocity", "NaN", "0.1 to 1"]);
    refused(&["correlation", "--n", "0"], &["--n", "0", "1 to 100"]);
    refused(&["intervals", "--tf", "-1"], &["--tf", "-1", "0.05 to 60"]);
    refused(&["intervals", "--tol", "0"], &["--tol", "0", "to 1"]);
    refused(&["intervals", "--n", "41"], &["--n", "41", "1 to 40"]);
    refused(&["intervals", "--n", "11", "--grid", "free"], &["--n", "11", "1 to 10"]);
    refused(&["intervals", "--limit", "0"], &["--limit", "0"]);
    refused(&["intervals", "--scheme", "gauss-9"], &["--scheme", "gauss-9", "radau-3"]);
    refused(&["intervals", "--grid", "odd"], &["--grid", "odd", "uniform"]);
}
