//! `scanloop bench solver` on a handful of cases: what it prints, never how long it takes.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

const FIVE: &str = "\
note,x5,x4,x3,x2,x1
free,0.0,0.5,0,0,0
off the line,0.6,1.0,0,0.1,0
ahead,-0.05,2.2,0,0,0
beside,-0.75,4.2,-0.1,-0.1,0.002
near the goal,0.1,8.5,0,0,0
";

/// Runs the benchmark on these cases and returns its JSON and its text.
fn bench(text: &str, arguments: &[&str]) -> (Value, String) {
    let system = TestSystem::new(EXECUTABLE);
    std::fs::write(system.folder().join("cases.csv"), text).unwrap();
    let output = system.run(&[&["bench", "solver", "--json", "--cases", "cases.csv"], arguments].concat());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{message}");
    (serde_json::from_slice(&output.stdout).unwrap(), message)
}

#[test]
fn every_hessian_and_qp_solver_is_reported_for_every_number_of_intervals() {
    let (results, text) = bench(FIVE, &["--intervals", "6,12"]);
    assert_eq!(results["profile"], scanloop_tests::PROFILE);
    assert_eq!((&results["cases"], &results["start"]), (&Value::from(5), &Value::from("cold")));
    let solvers = results["solvers"].as_array().unwrap();
    for n in [6, 12] {
        for name in ["active-set", "clarabel"] {
            for hessian in ["gauss-newton", "bfgs", "exact"] {
                let of = |row: &&Value| row["name"] == name && row["hessian"] == hessian && row["n"] == n;
                assert!(solvers.iter().any(|row| of(&row)), "{name} {hessian} {n}");
            }
        }
    }
    for row in solvers {
        assert_eq!(row["converged"].as_u64().unwrap() + row["failed"].as_u64().unwrap(), 5, "{row}");
        for key in ["step_us", "feedback_us", "solve_us", "iterations"] {
            for figure in ["count", "p50", "p90", "p99", "p999", "max"] {
                assert!(row[key][figure].is_number(), "{key}.{figure}: {row}");
            }
        }
        assert_eq!(row["step_us"]["count"], 5);
        assert!(row["allocations"].is_u64(), "the executable counts allocations: {row}");
    }
    let default = &solvers[0];
    assert_eq!((&default["name"], &default["refine"]), (&Value::from("active-set"), &Value::from(true)));
    assert_eq!((&default["converged"], &default["allocations"]), (&Value::from(5), &Value::from(0)));
    assert!(text.contains("active-set, gauss-newton") && text.contains("straight on"), "{text}");
}

#[test]
fn an_executable_without_its_laboratory_names_the_command_that_builds_it() {
    let system = TestSystem::new(EXECUTABLE);
    let alone = system.executable_alone("scanloop");
    for arguments in [
        &["campaign", "--runs", "3"][..],
        &["faults", "--list"],
        &["price", "--help"],
        &["analyse", "correlation"],
        &["bench", "solver"],
        &["bench", "compare"],
        &["bench", "ride"],
        &["bench", "transport", "--help"],
        &["bench", "latency", "--compute", "none", "--duration", "1"],
        &["bench", "latency", "--load", "--duration", "1"],
    ] {
        let output =
            std::process::Command::new(&alone).args(arguments).current_dir(system.folder()).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {message}");
        assert!(message.contains("`cargo build") && message.contains("-p scanloop-lab`"), "{message}");
    }
}

#[test]
fn a_laboratory_without_its_product_names_the_command_that_builds_it() {
    let system = TestSystem::new(EXECUTABLE);
    let laboratory = system.folder().join("scanloop-lab");
    std::fs::copy(env!("CARGO_BIN_EXE_scanloop-under-test-lab"), &laboratory).unwrap();
    let faults = ["faults", "--only", "process-actuator-dies/start"];
    let mut command = std::process::Command::new(&laboratory);
    let output = command.args(faults).current_dir(system.folder()).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(4), "{message}");
    assert!(message.contains("`cargo build") && message.contains("-p scanloop`"), "{message}");
}

#[test]
fn consecutive_cases_of_a_lap_start_from_the_solution_before() {
    let laps = "lap,x1,x2,x3,x4,x5\n1,0,0,0,0.5,0.1\n1,0,0,0,0.59,0.1\n1,0,0,0,0.68,0.1\n";
    let (results, text) = bench(laps, &["--intervals", "6"]);
    assert_eq!((&results["start"], &results["laps"]), (&Value::from("warm"), &Value::from(1)));
    assert!(text.contains("1 laps"), "{text}");
}

#[test]
fn growth_is_fitted_over_three_numbers_of_intervals_from_24_on() {
    let (results, _) = bench("x1,x2,x3,x4,x5\n0,0,0,0.5,0.1\n", &["--intervals", "24,30,36"]);
    let growth = results["growth"].as_array().unwrap();
    assert!(growth.iter().all(|row| row["step"]["slope_us"].is_number()), "{growth:?}");
    assert!(!growth.is_empty());
}

#[test]
fn peers_that_cannot_be_run_are_skipped_with_the_command_that_installs_them() {
    // Peers are compared with other numbers of intervals: nothing is started here, whatever is installed.
    let (results, text) = bench(FIVE, &["--intervals", "7", "--peer"]);
    assert_eq!(results["peers"], Value::Array(Vec::new()));
    assert_eq!(results["skipped"][0]["name"], "peers");
    assert!(text.contains("skipped"), "{text}");
}

#[test]
fn bad_cases_are_refused_with_file_line_and_column() {
    let system = TestSystem::new(EXECUTABLE);
    for (text, names) in [
        ("x1,x2,x3,x4,x5\n0,0,0,0,0\n0,0,NaN,0,0\n", ["bad.csv", "line 3", "x3"]),
        ("x1,x2,x3,x4\n0,0,0,0\n", ["bad.csv", "line 1", "x5"]),
        ("x1,x2,x3,x4,x5,obstacle_a_m\n0,0,0,0,0,-1\n", ["bad.csv", "line 2", "obstacle_a_m"]),
    ] {
        std::fs::write(system.folder().join("bad.csv"), text).unwrap();
        let output = system.run(&["bench", "solver", "--cases", "bad.csv"]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(names.iter().all(|name| message.contains(name)), "{message}");
    }
    let output = system.run(&["bench", "solver", "--cases", "nowhere.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere.csv"));
}
