//! Recorded drives that are driven on from one of their scans.

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{SHORT_CORRIDOR, TestSystem, printed};
use serde_json::Value;

use super::{json, recorded, text};

#[test]
fn a_fork_repeats_a_drive_to_the_bit_and_parts_from_it_where_something_is_changed() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_CORRIDOR);
        let fork = |arguments: &[&str]| {
            let output = system.run(&[&["fork", text(&file), "--json"], arguments].concat());
            (output.status.code(), json(&output))
        };
        let drove = |found: &Value| found["forks"][0]["driven"].clone();
        for at in ["1", "2", "25", "60"] {
            let (code, same) = fork(&["--at", at]);
            let forked = &same["forks"][0];
            assert_eq!((code, &forked["scan"]), (Some(0), &at.parse::<u64>().expect("of a test").into()));
            assert_eq!(forked["identical"], forked["compared"], "{same}");
            assert!(forked["compared"].as_u64() > Some(7) && drove(&same) == same["recorded"], "{same}");
        }
        // Seen, and passed otherwise, only when it is near enough.
        let obstacle = "shape=circle,x_m=5.5,y_m=0.3,radius_m=0.1,appears_ahead_m=1.5";
        let (code, other) = fork(&["--at", "10", "--obstacle", obstacle]);
        assert!(code == Some(0) && other["forks"][0]["scan"].as_u64() > Some(10), "{other}");
        assert_eq!(other["forks"][0]["parts"]["topic"], "scan");
        assert_ne!(drove(&other), other["recorded"]);
        let (code, table) = fork(&["--at", "10", "--sweep", "controller.cruise_mps=0.5..0.9/2"]);
        let times = [0, 1].map(|index| table["forks"][index]["driven"]["time_s"].as_f64());
        assert!(code == Some(0) && times[0] > times[1], "{table}");
        let (code, with) = fork(&["--at", "20", "--with", "controller=nmpc", "--duration", "1"]);
        let forked = &with["forks"][0];
        assert_eq!((code, &forked["identical"]), (Some(0), &forked["compared"]), "{with}");
        for (arguments, reason) in [
            (["--at", "999", "--set", "controller.horizon_s=2"], "this drive has the scans 1 to"),
            (["--at", "9", "--set", "controller.horizon_s=99"], "0.5 to 10"),
            (["--at", "9", "--obstacle", "x_m=3"], "shape"),
            (["--at", "9", "--sweep", "controller.horizon_s=1..2"], "KEY=a..b/n"),
        ] {
            let output = system.run(&[&["fork", text(&file)], &arguments[..]].concat());
            assert_eq!(output.status.code(), Some(2));
            assert!(printed(&output).contains(reason), "{}", printed(&output));
        }
        system.assert_nothing_left();
    });
}

#[test]
fn a_drive_in_real_time_is_followed_up_to_the_first_other_output() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(super::EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &["--record", "--duration", "3"]].concat());
        system.wait();
        let file = system.report().recording.expect("a recording").file;
        let fork =
            |arguments: &[&str]| json(&system.run(&[&["fork", text(&file), "--json"], arguments].concat()));
        let same = fork(&["--at", "9"]);
        assert_eq!((&same["forks"][0]["scan"], &same["lockstep"]), (&Value::Null, &false.into()), "{same}");
        let compared = same["forks"][0]["compared"].as_u64();
        assert!(compared > Some(5 * 18) && same["forks"][0]["identical"].as_u64() == compared, "{same}");
        let obstacle = "shape=circle,x_m=3,y_m=0.1,radius_m=0.1,appears_s=1.45";
        let other = fork(&["--at", "9", "--obstacle", obstacle]);
        let forked = &other["forks"][0];
        assert!((14..=16).contains(&forked["scan"].as_u64().expect("a scan")), "{other}");
        assert!(forked["driven"]["outcome"].is_string(), "{other}");
    });
}
