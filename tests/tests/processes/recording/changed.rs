//! Recorded drives whose settings change.

use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::{SHORT_CORRIDOR, TestSystem};

use super::{EXECUTABLE, json, replayed, text};

#[test]
fn a_drive_whose_settings_were_changed_refused_and_kept_over_a_restart_is_replayed_to_the_bit() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &["--record"]].concat());
        system.wait_until("a second is driven", |system| {
            system.status().is_some_and(|status| status.scan > 10)
        });
        // The first takes over; the last drives otherwise and is refused after it has run in shadow.
        for arguments in [
            &["set", "--tolerance", "1000", "controller.cruise_mps=0.9"][..],
            &["restart", "controller"],
            &["set", "estimator.recover_after=7"],
            &["set", "controller.cruise_mps=0.3"],
        ] {
            let output = system.run(arguments);
            assert!(output.status.code() != Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        }
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let file = system.report().recording.expect("a recording").file;
        let info = json(&system.run(&["recording", "info", text(&file), "--json"]));
        let attached = info["attachments"].as_array().expect("files");
        let of_processes = |role: &str| {
            let start = format!("settings-{role}-");
            attached.iter().filter(|name| name.as_str().is_some_and(|name| name.starts_with(&start))).count()
        };
        assert!(of_processes("controller") >= 2 && of_processes("estimator") >= 1, "{info}");
        let (report, code) = replayed(&system, &file, &[]);
        assert_eq!((code, &report["identical"]), (0, &report["compared"]), "{report}");
        // A key that is changed for the replay is changed for all processes.
        let (other, code) = replayed(&system, &file, &["--set", "controller.cruise_mps=0.5"]);
        assert!(code == 1 && other["beyond"].as_u64() > Some(50), "{other}");
        system.assert_nothing_left();
    });
}
