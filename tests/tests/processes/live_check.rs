//! `scanloop check --live`, with the emulator, and faulty robots, as the real robot.

use std::collections::BTreeMap;

use scanloop_tests::TestSystem;
use scanloop_tests::machine::repeat_when_late;
use serde_json::Value;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");
const FAULTY_ROBOT: &str = env!("CARGO_BIN_EXE_faulty-robot");

/// [`check_once`], again when the machine was too busy for the robot: scans then come late.
fn check(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, BTreeMap<String, String>, Value) {
    let mut found = check_once(system, arguments);
    for _ in 0..3 {
        if found.1["jitter"] != "failed" {
            break;
        }
        found = check_once(system, arguments);
    }
    found
}

/// The exit code of a check, the outcome of each of its checks, and the whole report.
fn check_once(system: &TestSystem, arguments: &[&str]) -> (Option<i32>, BTreeMap<String, String>, Value) {
    let output = system.run(&[&["check", "--live", "--json", "--observe", "1"], arguments].concat());
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{message}"));
    let text = |value: &Value| value.as_str().expect("a text").to_owned();
    let checks = report["checks"].as_array().expect("a list").iter();
    let outcomes = checks.map(|check| (text(&check["name"]), text(&check["outcome"]))).collect();
    (output.status.code(), outcomes, report)
}

/// A system file whose robot is the emulator with this fault.
fn faulty(system: &TestSystem, fault: &[&str]) -> String {
    let command: Vec<String> =
        [&[FAULTY_ROBOT], fault].concat().iter().map(|text| format!("{text:?}")).collect();
    let others =
        [("estimator", "ekf"), ("obstacles", "ellipses"), ("controller", "nmpc"), ("actuator", "actuation")];
    let others =
        others.map(|(role, name)| format!("[[process]]\nrole = \"{role}\"\nimplementation = \"{name}\"\n"));
    let text =
        format!("[[process]]\nrole = \"robot\"\ncommand = [{}]\n{}", command.join(", "), others.concat());
    let file = system.folder().join("faulty.toml");
    std::fs::write(&file, text).expect("a system file");
    file.to_str().expect("a readable path").to_owned()
}

#[test]
fn a_robot_that_works_passes_and_its_deceleration_is_measured() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (code, outcomes, report) = check(&system, &["--drive", "--speed", "0.8"]);
        assert_eq!(code, Some(0), "{report:#}");
        assert_eq!(outcomes.len(), 10, "{report:#}");
        assert!(outcomes.values().all(|outcome| outcome == "ok"), "{report:#}");
        assert_eq!((&report["system"], report["failed"].as_u64()), (&Value::from("started"), Some(0)));
        let deceleration = report["blocked_deceleration_mps2"].as_f64().unwrap();
        let estimate = report["deceleration_estimate_mps2"].as_f64().unwrap();
        // It decelerates with 5 m/s^2: a distance of 3 cm from 0.57 m/s, in which a delay by 1 ms is 2 %.
        assert!((4.5..=5.5).contains(&estimate), "{report:#}");
        assert!((3.8..=estimate).contains(&deceleration), "{report:#}");
        assert!(
            report["checks"][9]["measured"].as_str().unwrap().contains(" in 4 stops from "),
            "{report:#}"
        );
        system.assert_nothing_left();
    });
}

#[test]
fn a_stop_that_is_longer_than_described_fails_with_the_value_to_enter() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let weak = [
            "--set",
            "robot.blocked_deceleration_mps2=1.0",
            "--set",
            "vehicle.blocked_deceleration_mps2=5.0",
        ];
        let (code, outcomes, report) = check(&system, &[&["--drive", "--speed", "0.6"], &weak[..]].concat());
        assert_eq!((code, outcomes["stop"].as_str(), outcomes["ahead"].as_str()), (Some(1), "failed", "ok"));
        let deceleration = report["blocked_deceleration_mps2"].as_f64().unwrap();
        assert!((0.7..=1.1).contains(&deceleration), "{report:#}");
    });
}

#[test]
fn an_odometry_of_the_wrong_sign_fails_when_the_robot_drives() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = faulty(&system, &["backwards"]);
        let (code, outcomes, report) = check(&system, &["--drive", "--system", &file]);
        assert_eq!((code, outcomes["ahead"].as_str()), (Some(1), "failed"), "{report:#}");
        assert_eq!((outcomes["left"].as_str(), outcomes["stop"].as_str()), ("skipped", "skipped"));
        assert!(report["blocked_deceleration_mps2"].is_null());
        system.assert_nothing_left();
    });
}

#[test]
fn wheels_that_slide_uncounted_are_measured_by_the_scans() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = faulty(&system, &["locked"]);
        let (code, outcomes, report) = check(&system, &["--drive", "--speed", "0.8", "--system", &file]);
        assert_eq!((code, outcomes["stop"].as_str()), (Some(0), "ok"), "{report:#}");
        let measured = report["checks"][9]["measured"].as_str().unwrap();
        assert!(measured.contains("by the scans, of which the odometry counted"), "{report:#}");
        let estimate = report["deceleration_estimate_mps2"].as_f64().unwrap();
        let entered = report["blocked_deceleration_mps2"].as_f64().unwrap();
        // 64 mm from 0.8 m/s at 5 m/s^2, seen to some millimetres.
        assert!((4.2..=6.0).contains(&estimate) && (2.5..=estimate).contains(&entered), "{report:#}");
    });
}

#[test]
fn a_way_to_rest_that_friction_forbids_gives_no_advice() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = faulty(&system, &["locked"]);
        // Nothing stands around that would show the motion.
        let open =
            ["track.surroundings=open", "obstacle.0.appears_s=1000"].map(|set| ["--set", set]).concat();
        let arguments = [&["--drive", "--speed", "0.8", "--system", &file], &open[..]].concat();
        let (code, outcomes, report) = check(&system, &arguments);
        assert_eq!((code, outcomes["stop"].as_str()), (Some(1), "failed"), "{report:#}");
        assert!(report["blocked_deceleration_mps2"].is_null(), "{report:#}");
        let stop = &report["checks"][9];
        assert!(stop["measured"].as_str().unwrap().contains("shorter than friction allows"), "{report:#}");
        assert_eq!(stop["allowed"], "up to 7.8 m/s^2 by vehicle.tyre_friction = 0.8");
    });
}

#[test]
fn wheels_that_turn_faster_than_the_body_drives_fail() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = faulty(&system, &["spinning"]);
        let (code, outcomes, report) = check(&system, &["--drive", "--speed", "0.8", "--system", &file]);
        assert_eq!((code, outcomes["ahead"].as_str()), (Some(1), "failed"), "{report:#}");
        assert!(report["checks"][7]["measured"].as_str().unwrap().contains("by the scans"), "{report:#}");
    });
}

#[test]
fn motions_by_hand_show_the_direction_of_the_odometry() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        for (sign, expected) in [("1", "ok"), ("-1", "failed")] {
            let file = faulty(&system, &["rolled", sign]);
            let (_, outcomes, report) = check(&system, &["--system", &file]);
            assert_eq!(
                (outcomes["ahead"].as_str(), outcomes["left"].as_str()),
                (expected, expected),
                "{report:#}"
            );
            assert_eq!(outcomes["stop"], "skipped");
        }
        // It is not moved.
        let (code, outcomes, report) = check(&system, &["--by-hand", "0.3"]);
        assert_eq!(
            (code, outcomes["ahead"].as_str(), outcomes["left"].as_str()),
            (Some(1), "failed", "failed")
        );
        assert!(report["checks"][7]["measured"].as_str().unwrap().contains("by +0.00 m"), "{report:#}");
        let (code, outcomes, _) = check(&system, &["--by-hand", "0"]);
        assert_eq!((code, outcomes["ahead"].as_str()), (Some(0), "skipped"));
    });
}

#[test]
fn a_scanner_that_is_missing_fails_and_the_robot_is_not_driven() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (code, outcomes, report) = check(&system, &["--drive", "--set", "scanner.missing_every=1"]);
        assert_eq!(
            (code, outcomes["scanner"].as_str(), outcomes["health"].as_str()),
            (Some(1), "failed", "failed")
        );
        assert_eq!(
            (outcomes["ahead"].as_str(), outcomes["stop"].as_str()),
            ("skipped", "skipped"),
            "{report:#}"
        );
        let file = faulty(&system, &["hang-after", "1"]);
        let (code, outcomes, report) = check(&system, &["--by-hand", "0.1", "--system", &file]);
        let scanner =
            (outcomes["scanner"].as_str(), outcomes["rate"].as_str(), outcomes["odometry"].as_str());
        assert_eq!((code, scanner), (Some(1), ("failed", "skipped", "failed")), "{report:#}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_scanner_of_another_rate_fails() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = faulty(&system, &["slow"]);
        let (code, outcomes, report) = check_once(&system, &["--by-hand", "0", "--system", &file]);
        assert_eq!((code, outcomes["rate"].as_str()), (Some(1), "failed"), "{report:#}");
    });
}

#[test]
fn a_way_that_is_not_free_is_not_driven() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (code, outcomes, report) = check(&system, &["--drive", "--set", "obstacle.0.x_m=1.5"]);
        assert_eq!((code, outcomes["ahead"].as_str()), (Some(0), "skipped"), "{report:#}");
        assert!(report["checks"][7]["measured"].as_str().unwrap().contains("are free ahead"), "{report:#}");
    });
}

#[test]
fn a_drive_ends_when_something_comes_near_or_the_scans_end() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        // The robot drives from about 4.3 s on: something stands before it, or ranges end, after 5.2 s.
        let near = ["obstacle.0.x_m=0.85", "obstacle.0.appears_s=5.2"].map(|set| ["--set", set]).concat();
        let blind = ["scanner.missing_every=1", "scanner.from_s=5.2"].map(|set| ["--set", set]).concat();
        for faults in [near, blind] {
            let (code, outcomes, report) = check(&system, &[&["--drive"], &faults[..]].concat());
            assert_eq!((code, outcomes["scanner"].as_str()), (Some(0), "ok"), "{report:#}");
            assert_eq!(outcomes["stop"], "skipped", "{report:#}");
            let reason = report["checks"][9]["measured"].as_str().unwrap();
            assert!(reason.starts_with("something is near"), "{report:#}");
        }
        system.assert_nothing_left();
    });
}

#[test]
fn a_running_system_is_observed_and_never_driven() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["endless"]);
        let (_, outcomes, report) = check(&system, &[]);
        assert_eq!(
            (&report["system"], outcomes["rate"].as_str()),
            (&Value::from("running"), "ok"),
            "{report:#}"
        );
        assert_eq!(
            (outcomes["odometry"].as_str(), outcomes["ahead"].as_str()),
            ("ok", "skipped"),
            "{report:#}"
        );
        let refused = system.run(&["check", "--live", "--drive"]);
        assert_eq!(refused.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("stop it first"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
    });
}

#[test]
fn wrong_usage_and_a_robot_that_ends_have_their_exit_codes() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        for wrong in [
            &["check", "--live", "--drive", "--speed", "3"][..],
            &["check", "--live", "--drive", "--stops", "0"],
            &["check", "--live", "--observe", "0"],
            &["check", "--drive"],
            &["check", "--live", "corridor"],
        ] {
            assert_eq!(system.run(wrong).status.code(), Some(2), "{wrong:?}");
        }
        let file = faulty(&system, &["exit-after", "3"]);
        let ended = system.run(&["check", "--live", "--system", &file]);
        let message = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(4), "{message}");
        assert!(
            message.contains("the process of the robot ended") && message.contains("gone at scan"),
            "{message}"
        );
        system.assert_nothing_left();
    });
}

#[test]
fn a_stop_ends_a_drive() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.launch(&["check", "--live", "--drive", "--observe", "1"], &[]);
        system.wait_until("it is about to drive", |system| system.stderr().contains("the robot drives"));
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        assert!(!system.stderr().contains(" ok, "), "{}", system.stderr());
        system.assert_nothing_left();
    });
}
