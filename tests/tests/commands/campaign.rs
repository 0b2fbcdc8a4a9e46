//! `scanloop campaign`: a few courses of hostile families, and a failure that `run` replays from its file.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

fn results(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, Value) {
    let output = system.run(&[&["campaign", "--json", "--out", "out"], arguments].concat());
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let results = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {text}"));
    (output.status.code(), results)
}

#[test]
fn hostile_courses_are_driven_without_contact_and_each_drive_has_one_verdict() {
    let system = TestSystem::new(EXECUTABLE);
    let chosen = ["--family", "gap", "--family", "clutter", "--family", "crossing", "--family", "closed"];
    let (_, results) = results(&system, &[&chosen[..], &["--runs", "3", "--robot", "summit"]].concat());
    let families = results["families"].as_array().unwrap();
    let names: Vec<&str> = families.iter().map(|family| family["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["gap", "clutter", "crossing", "closed"]);
    for family in families {
        let number = |key: &str| family[key].as_u64().unwrap();
        let verdicts =
            ["reached", "stopped_rightly", "stopped_wrongly", "missed", "collision", "collision_excused"];
        assert_eq!((verdicts.map(number).iter().sum::<u64>(), number("collision")), (3, 0), "{family}");
        // 1 - 0.05^(1 / 3).
        assert!((family["collision_bound_95"].as_f64().unwrap() - 0.6316).abs() < 1e-4);
    }
    assert_eq!((&families[3]["impassable"], &families[3]["stopped_rightly"]), (&3.into(), &3.into()));
    let picture = std::fs::read_to_string(system.folder().join("out/gaps.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("Share passed over the width of the gap"));
}

#[test]
fn a_bad_course_is_a_file_in_the_folder_of_its_cause_that_run_replays() {
    // The processes of a run in lock-step have limits on the clock of the machine.
    repeat_when_late(replay_a_bad_course);
}

fn replay_a_bad_course() {
    let system = TestSystem::new(EXECUTABLE);
    // No robot with encoders alone lands within 1 cm of the true goal, and the speed is no part of a scenario.
    let set = [
        ["--set", "goal.tolerance_m=0.01"],
        ["--set", "controller.cruise_mps=0.9"],
        ["--set", "estimator.laser=off"],
    ]
    .concat();
    let chosen = ["--family", "anywhere", "--robot", "random", "--runs", "2"];
    let (code, results) = results(&system, &[&chosen[..], &set].concat());
    assert_eq!(code, Some(1), "{results}");
    let bad = &results["bad"][0];
    let (file, cause) = (bad["scenario"].as_str().unwrap(), bad["cause"].as_str().unwrap());
    assert!(cause.starts_with("missed-") && file.starts_with(&format!("out/{cause}/anywhere-")), "{bad}");
    assert_eq!(results["causes"][cause].as_u64().map(|count| count > 0), Some(true));

    let replay = [&["run", "--lockstep", "--quiet", "--out", "replay", file], &set[..]].concat();
    let replayed = system.run(&replay);
    assert_eq!(replayed.status.code(), Some(1), "{}", String::from_utf8_lossy(&replayed.stderr));
    let report = std::fs::read_to_string(system.folder().join("replay/report.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!((&report["outcome"], &report["reason"]), (&bad["outcome"], &bad["reason"]));
    let text = std::fs::read_to_string(system.folder().join(file)).unwrap();
    let command =
        "FILE --set 'goal.tolerance_m=0.01' --set 'controller.cruise_mps=0.9' --set 'estimator.laser=off'";
    assert!(text.contains(command), "{text}");
}

#[test]
fn unknown_families_and_keys_are_refused_before_the_first_drive() {
    let system = TestSystem::new(EXECUTABLE);
    for (arguments, expected) in [
        (["--family", "easy"], "[possible values: plain, symmetric"),
        (["--robot", "perfect"], "[possible values: ideal, summit, worn, random]"),
        (["--set", "robot.mass_kg=0"], "robot.mass_kg = 0 is not allowed: 0.001 to 1000000"),
        (["--set", "robot.colour=1"], "colour"),
        (["--set", "robot"], "expected KEY=VALUE"),
    ] {
        let output = system.run(&[&["campaign"], &arguments[..]].concat());
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(expected), "{arguments:?}: {text}");
    }
}

#[test]
fn each_class_of_failures_on_the_page_has_a_file_that_reproduces_it() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/campaign");
    let page = std::fs::read_to_string(format!("{folder}.md")).unwrap();
    let system = TestSystem::new(EXECUTABLE);
    for file in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        let name = file.file_name().unwrap().to_str().unwrap();
        assert!(page.contains(&format!("(campaign/{name})")), "the page does not name {name}");
        // The first line is `# outcome: reason`.
        let text = std::fs::read_to_string(&file).unwrap();
        let expected = text.trim_start_matches("# ").split(':').next().unwrap();
        system.run(&["run", "--lockstep", "--quiet", "--out", "out", file.to_str().unwrap()]);
        let report = std::fs::read_to_string(system.folder().join("out/report.json")).unwrap();
        let report: Value = serde_json::from_str(&report).unwrap();
        let again = "if the stack got better, take the file and its row from the page";
        assert_eq!(report["outcome"], expected, "{name} ({}): {again}", report["reason"]);
    }
}
