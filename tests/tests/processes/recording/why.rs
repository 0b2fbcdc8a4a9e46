//! Why a robot did what it did, by its recording.

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{SHORT_CORRIDOR, printed};
use serde_json::Value;
use shared_types::{Pose, Sample};

use super::{json, recorded, replayed, rewrite, text};

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
        for (scan, reason) in [("999", "it has the scans 1 to"), ("x", "invalid value")] {
            let output = system.run(&["why", text(&file), scan]);
            assert_eq!(output.status.code(), Some(2));
            assert!(printed(&output).contains(reason), "{}", printed(&output));
        }
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

#[test]
fn a_replay_with_each_value_that_why_names_decides_otherwise() {
    repeat_when_late(|| {
        let near = ["sudden", "--set", "obstacle.0.appears_ahead_m=0.9", "--set", "obstacle.0.y_m=0.3"];
        for (drive, scan, by) in
            [(&near[..], 42, &["controller.clearance_m", "earlier_s"][..]), (&["corridor"], 30, &["later_s"])]
        {
            let (system, file) = recorded(drive);
            let why = json(&system.run(&["why", text(&file), &scan.to_string(), "--json"]));
            let named = why["alternatives"].as_array().expect("alternatives");
            for by in by {
                let found =
                    named.iter().find(|other| other["by"] == *by).unwrap_or_else(|| panic!("{by}: {why}"));
                let value = found["value"].as_f64().expect("a value");
                let other = system.folder().join("other.mcap");
                // One message a scan.
                rewrite(&file, &other, "/scanloop/pose", |number, data| {
                    if number + 1 == scan {
                        changed(&mut data[4..], by, value);
                    }
                });
                let scan = scan.to_string();
                let set = format!("controller.clearance_m={value}");
                let mut replay = vec!["--stage", "controller", "--from", &scan, "--to", &scan];
                if *by == "controller.clearance_m" {
                    replay.extend(["--set", &set]);
                }
                let (report, _) = replayed(&system, &other, &replay);
                let difference = report["differences"][0].clone();
                assert_eq!(
                    (&difference["field"], &difference["scan"]),
                    (&"kind".into(), &why["scan"]),
                    "{report}"
                );
                assert_ne!(difference["recorded"], difference["replayed"], "{by}: {report}");
            }
        }
    });
}

/// Another pose: the robot so much earlier or later on its way.
fn changed(data: &mut [u8], by: &str, value: f64) {
    let mut pose: Pose = bytemuck::pod_read_unaligned(&data[..size_of::<Pose>()]);
    let way_m = match by {
        "earlier_s" => -value * pose.speed_mps,
        "later_s" => value * pose.speed_mps,
        // The clearance is a key.
        _ => return,
    };
    (pose.x_m, pose.y_m) = (pose.x_m + way_m * pose.yaw_rad.cos(), pose.y_m + way_m * pose.yaw_rad.sin());
    pose.predicted_x_m += way_m * pose.predicted_yaw_rad.cos();
    pose.predicted_y_m += way_m * pose.predicted_yaw_rad.sin();
    assert_eq!(pose.check(), Ok(()));
    data[..size_of::<Pose>()].copy_from_slice(bytemuck::bytes_of(&pose));
}
