//! `scanloop faults`: a sample of the matrix, with real processes among it.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::machine::repeat_when_late;
use std::collections::BTreeSet;

use scanloop_tests::TestSystem;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// Runs `scanloop faults` and returns its exit code and what it printed.
fn faults(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, Value) {
    let output = system.run(&[&["faults", "--json", "--out", "out"], arguments].concat());
    let printed = serde_json::from_slice(&output.stdout);
    let printed =
        printed.unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
    (output.status.code(), printed)
}

/// Asserts that all cells pass; returns how many there are.
fn assert_passed((code, matrix): (Option<i32>, Value)) -> usize {
    let cells = matrix["cells"].as_array().unwrap();
    let failed: Vec<&Value> = cells.iter().filter(|cell| cell["verdict"] != "pass").collect();
    assert!(failed.is_empty() && code == Some(0), "{code:?}: {failed:#?}");
    assert_eq!((&matrix["passed"], &matrix["failed"]), (&Value::from(cells.len()), &Value::from(0)));
    cells.len()
}

#[test]
fn a_sample_of_simulated_faults_is_detected_and_nothing_is_touched() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let output = system.run(&["faults", "--list"]);
        let names = String::from_utf8(output.stdout).unwrap();
        let of_processes = ["process-", "machine-", "orchestrator-", "shared-memory-"];
        let is_simulated = |name: &&str| !of_processes.iter().any(|start| name.starts_with(start));
        assert!(names.lines().count() >= 500, "{names}");
        assert_eq!(names.lines().collect::<BTreeSet<_>>().len(), names.lines().count());
        let simulated: Vec<&str> = names.lines().filter(is_simulated).collect();
        let (mut cells, step) = (0, simulated.len() / 10);
        for name in simulated.iter().step_by(step) {
            let fault = name.split('/').next().unwrap();
            cells += assert_passed(faults(&system, &["--only", &format!("{fault}/*")]));
        }
        assert!(cells >= 48, "{cells}");
        let page = std::fs::read_to_string(system.folder().join("out/faults.html")).unwrap();
        assert!(page.contains("</table>") && page.contains("<td>pass</td>"), "{page}");
        system.assert_nothing_left();
    });
}

#[test]
fn processes_that_die_hang_and_flood_are_detected_and_nothing_is_touched() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        for name in [
            "process-controller-dies/beside",
            "process-estimator-hangs/straight",
            "process-actuator-dies/landing",
            "process-obstacles-floods/start",
            "process-controller-hangs/swap",
            "orchestrator-dies/straight",
            "machine-stalls-500ms/beside",
        ] {
            assert_eq!(assert_passed(faults(&system, &["--only", &format!("{name}*")])), 1, "{name}");
        }
        system.assert_nothing_left();
    });
}

#[test]
fn a_full_shared_memory_does_not_disturb_the_drive_where_it_may_be_filled() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (code, matrix) = faults(&system, &["--only", "shared-memory-full/beside"]);
        let skipped = matrix["skipped"].as_array().unwrap();
        if skipped.is_empty() {
            assert_eq!(assert_passed((code, matrix)), 1);
        } else {
            eprintln!("skipped {skipped:?}");
        }
    });
}

#[test]
fn a_pattern_that_no_cell_has_is_refused() {
    repeat_when_late(|| {
        let output = TestSystem::new(EXECUTABLE).run(&["faults", "--only", "nothing"]);
        assert_eq!(output.status.code(), Some(2));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.contains("--only nothing: no cell has such a name"), "{message}");
    });
}

#[test]
fn other_vehicles_pass_with_what_is_expected_otherwise_of_them() {
    let system = TestSystem::new(EXECUTABLE);
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    for (name, scale) in [("racecar", "2"), ("turtlebot", "1"), ("car", "2")] {
        let (vehicle, expect) =
            (format!("{root}/examples/vehicles/{name}.toml"), format!("{root}/benches/vehicles/{name}.toml"));
        let with = ["--system", &vehicle, "--scale", scale, "--only", "odometry-speed-*/s*"];
        // A speed that contradicts the way is found with each, also where it is beyond what the robot can drive.
        let found = faults(&system, &[&with[..], &["--expect", &expect]].concat());
        assert!(found.1["cells"].as_array().unwrap().iter().all(|cell| cell["outcome"] == "stopped"));
        assert_eq!(assert_passed(found), 6, "{name}");
    }
    let expect = system.folder().join("expect.toml");
    std::fs::write(&expect, "[odometry-sped-double.start]\nskip = true\nbecause = \"x\"\n").unwrap();
    let vehicle = format!("{root}/examples/vehicles/car.toml");
    let output = system.run(&["faults", "--system", &vehicle, "--expect", "expect.toml"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let names = "no fault is named odometry-sped-double. Did you mean";
    assert!(output.status.code() == Some(2) && message.contains(names), "{message}");
}

#[test]
fn a_stage_in_a_program_of_its_own_gives_the_cells_of_the_built_in_one() {
    let system = TestSystem::new(EXECUTABLE);
    let only = ["--only", "command-too-*"];
    let mut built_in = faults(&system, &[&only[..], &["--simulated"]].concat());
    // Programs of one's own need not follow courses: they are not driven in the bend and backwards.
    let cells = built_in.1["cells"].as_array_mut().unwrap();
    cells.retain(|cell| cell["phase"] != "bend" && cell["phase"] != "reverse");
    assert!(cells.len() >= 5);
    let passed = cells.len();
    built_in.1["passed"] = passed.into();
    for with in ["estimator=ekf", "obstacles=ellipses", "controller=nmpc", "actuator=actuation"] {
        assert_eq!(faults(&system, &[&only[..], &["--with", with]].concat()), built_in, "{with}");
    }
    system.assert_nothing_left();
}

#[test]
fn a_stage_of_your_own_meets_the_matrix() {
    let system = TestSystem::new(EXECUTABLE);
    let with = format!("estimator={}", env!("CARGO_BIN_EXE_dead-reckoning-under-test"));
    // It trusts its odometer, so it misses what a filter finds.
    let passed = faults(&system, &["--with", &with, "--only", "pose-frozen"]);
    assert!(assert_passed(passed) >= 5);
    let (code, matrix) = faults(&system, &["--with", &with, "--only", "odometry-*/straight"]);
    assert_eq!(code, Some(1), "{matrix:#}");
    assert!(matrix["failed"].as_u64() > Some(0));
}

#[test]
fn a_program_that_is_no_stage_of_the_role_or_ends_is_named() {
    let system = TestSystem::new(EXECUTABLE);
    let dead_reckoning = env!("CARGO_BIN_EXE_dead-reckoning-under-test");
    let dies = format!("controller=timeout -s KILL 0.2 {EXECUTABLE} service nmpc");
    for (with, code, expected) in [
        (&*format!("controller={dead_reckoning}"), 2, "it is a stage of the role estimator"),
        ("controller=/bin/true", 2, "the program ended: exit status: 0"),
        ("controller=/no/such/program", 2, "No such file or directory"),
        ("robot=/bin/true", 2, "the robot is emulated"),
        ("controller", 2, "expected ROLE=COMMAND"),
        (&*dies, 4, "controller: the program"),
    ] {
        let output = system.run(&["faults", "--only", "pose-*", "--out", "out", "--with", with]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{with}: {message}");
        assert!(message.contains(expected), "{with}: {message}");
    }
    system.assert_nothing_left();
}
