//! Why a robot did what it did, by its recording.

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{SHORT_CORRIDOR, printed};
use serde_json::Value;

use super::{json, recorded, text};

#[test]
fn a_stop_is_explained_at_the_scan_that_decided_it() {
    repeat_when_late(|| {
        let (system, file) = recorded(&["sudden", "--set", "stop_final_s=0.5"]);
        let ask = |arguments: &[&str]| {
            let output = system.run(&[&["why", text(&file), "--json"], arguments].concat());
            assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
            json(&output)
        };
        let stops = ask(&["--stops"]);
        let first = stops[0]["scan"].as_u64().expect("a stop");
        assert!(stops[0]["text"].as_str().expect("a text").contains("blocked by obstacle"), "{stops}");
        let [before, at, later] = [first - 1, first, first + 3].map(|scan| ask(&[&scan.to_string()]));
        assert_eq!((&before["drives"], &at["drives"]), (&true.into(), &false.into()));
        assert_eq!((&at["reason"][1], &later["decided_at"]), (&"blocked".into(), &first.into()), "{later}");
        let about = |why: &Value, about: &str| {
            let all = why["sentences"].as_array().expect("sentences").clone();
            all.iter().any(|sentence| sentence["about"] == about)
        };
        assert!(about(&at, "stop") && about(&at, "otherwise") && !about(&before, "stop"), "{at}");
        assert!(about(&before, "margin") && about(&before, "shaped by"), "{before}");
        assert_ne!(at["alternatives"][0], Value::Null, "{at}");
        assert_eq!(at["alternatives"], later["alternatives"], "they are those of the decision");
        for alternative in at["alternatives"].as_array().expect("alternatives") {
            assert_eq!(alternative["drives"], true, "{at}");
        }
        for (scan, reason) in
            [("999", "it has the scans 1 to"), ("x", "is not allowed: a whole number from 1")]
        {
            let output = system.run(&["why", text(&file), scan]);
            assert_eq!(output.status.code(), Some(2));
            assert!(printed(&output).contains(reason), "{}", printed(&output));
        }
        system.assert_nothing_left();
    });
}

#[test]
fn a_stop_that_was_decided_long_before_is_known_from_its_first_scan() {
    repeat_when_late(|| {
        // Of a recording only some seconds around a scan are read, unless its stop began before them.
        let closed = ["corridor", "--set", "obstacle.0.width_m=3.5", "--set", "stop_final_s=45"];
        let (system, file) = recorded(&closed);
        let ask =
            |arguments: &[&str]| json(&system.run(&[&["why", text(&file), "--json"], arguments].concat()));
        let stops = ask(&["--stops"]);
        let first = stops[0]["scan"].as_u64().expect("a stop");
        assert_eq!(stops[0]["lasted_scans"].as_u64().map(|scans| scans > 440), Some(true), "{stops}");
        let [at, later] = [first, first + 430].map(|scan| ask(&[&scan.to_string()]));
        assert_eq!(
            (&later["decided_at"], &later["alternatives"]),
            (&first.into(), &at["alternatives"]),
            "{later}"
        );
        system.assert_nothing_left();
    });
}

#[test]
fn a_fork_with_the_value_that_would_have_changed_a_decision_decides_otherwise() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let why = json(&system.run(&["why", text(&file), "35", "--json"]));
        let found = &why["alternatives"][0];
        assert_eq!(
            (&found["by"], &found["drives"]),
            (&"controller.clearance_m".into(), &false.into()),
            "{why}"
        );
        let set = format!("controller.clearance_m={}", found["value"]);
        let fork = ["fork", text(&file), "--json", "--at", "35", "--duration", "1", "--set", &set];
        let forked = json(&system.run(&fork));
        let parts = &forked["forks"][0]["parts"];
        assert_eq!(
            (&parts["scan"], &parts["field"], &parts["replayed"]),
            (&35.into(), &"kind".into(), &"0".into())
        );
    });
}
