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

/// A box that appears where a little less clearance, or a little more way, would do.
const NEAR: [&str; 5] = ["sudden", "--set", "obstacle.0.appears_ahead_m=0.9", "--set", "obstacle.0.y_m=0.3"];
/// The margin with which these drives are such.
const MARGIN: [&str; 2] = ["--set", "controller.margin.latency_share=1"];

/// The value by which something would have changed a decision.
fn named(why: &Value, by: &str) -> f64 {
    let all = why["alternatives"].as_array().expect("alternatives");
    let found = all.iter().find(|other| other["by"] == by).unwrap_or_else(|| panic!("{by}: {why}"));
    assert_ne!(found["drives"], why["drives"], "{why}");
    found["value"].as_f64().expect("a value")
}

#[test]
fn a_fork_with_the_clearance_that_would_have_changed_a_decision_decides_otherwise() {
    repeat_when_late(|| {
        // Another kind of command: 1 drives, 0 stops.
        for (drive, scan, kind) in [(&SHORT_CORRIDOR[..], "35", "0"), (&NEAR, "42", "1")] {
            let (system, file) = recorded(&[drive, &MARGIN].concat());
            let why = json(&system.run(&["why", text(&file), scan, "--json"]));
            let set = format!("controller.clearance_m={}", named(&why, "controller.clearance_m"));
            let fork = ["fork", text(&file), "--json", "--at", scan, "--duration", "1", "--set", &set];
            let forked = json(&system.run(&fork));
            let parts = &forked["forks"][0]["parts"];
            assert_eq!(
                (&parts["scan"], &parts["field"], &parts["replayed"]),
                (&why["scan"], &"kind".into(), &kind.into()),
                "{forked}"
            );
        }
    });
}

#[test]
fn a_replay_of_a_robot_that_is_so_much_earlier_or_later_on_its_way_decides_otherwise() {
    repeat_when_late(|| {
        for (drive, scan, by, sign) in
            [(&NEAR[..], 42, "earlier_s", -1.0), (&["corridor"], 28, "later_s", 1.0)]
        {
            let (system, file) = recorded(&[drive, &MARGIN].concat());
            let at = scan.to_string();
            let why = json(&system.run(&["why", text(&file), &at, "--json"]));
            let moved_s = sign * named(&why, by);
            let other = system.folder().join("other.mcap");
            // One pose a scan, behind the encapsulation.
            rewrite(&file, &other, "/scanloop/pose", |number, data| {
                if number + 1 == scan {
                    shift(&mut data[4..], moved_s);
                }
            });
            let replay = ["--stage", "controller", "--from", &at, "--to", &at];
            let difference = replayed(&system, &other, &replay).0["differences"][0].clone();
            assert_eq!((&difference["field"], &difference["scan"]), (&"kind".into(), &why["scan"]), "{by}");
            // A replay of the pose as it was decides as recorded.
            assert_eq!(replayed(&system, &file, &replay).0["identical"], 1, "{by}");
        }
    });
}

/// Moves a pose by a time on its way.
fn shift(data: &mut [u8], moved_s: f64) {
    let mut pose: Pose = bytemuck::pod_read_unaligned(&data[..size_of::<Pose>()]);
    let way_m = moved_s * pose.speed_mps;
    (pose.x_m, pose.y_m) = (pose.x_m + way_m * pose.yaw_rad.cos(), pose.y_m + way_m * pose.yaw_rad.sin());
    pose.predicted_x_m += way_m * pose.predicted_yaw_rad.cos();
    pose.predicted_y_m += way_m * pose.predicted_yaw_rad.sin();
    assert_eq!(pose.check(), Ok(()));
    data[..size_of::<Pose>()].copy_from_slice(bytemuck::bytes_of(&pose));
}
