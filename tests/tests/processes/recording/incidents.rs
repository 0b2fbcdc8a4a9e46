//! The last seconds before an incident.

use scanloop_tests::machine::repeat_when_late;
use std::path::PathBuf;

use report::Outcome;
use rustix::process::Signal;
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, TestSystem};
use shared_types::Role;

use super::{EXECUTABLE, json, recorder_of, replayed, text};

const FAULTY_CONTROLLER: &str = env!("CARGO_BIN_EXE_faulty-controller");
const RING: [&str; 2] = ["--set", "recording.ring_s=60"];

#[test]
fn a_kill_leaves_one_file_with_the_seconds_before_it_and_the_restart_and_it_is_replayed_to_the_bit() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &RING].concat());
        system.wait_until("two seconds are driven", |system| {
            system.status().is_some_and(|status| status.scan > 20)
        });
        system.signal(system.pid(Role::Controller), Signal::KILL);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let report = system.report();
        assert_eq!(report.recording, None);
        let (found, named) = (incidents_of(&system), report.incidents);
        assert!(
            found.len() == named.len() && found.iter().all(|file| named.contains(file)),
            "{found:?} {named:?}"
        );
        // On a busy machine, a late command may block the wheels later on: that is another incident.
        let soon = |file: &&PathBuf| (20..40).any(|scan| file.ends_with(format!("incident-{scan}.mcap")));
        assert_eq!(named.iter().filter(soon).count(), 1, "{named:?}");
        let file = &named[0];
        let info = json(&system.run(&["recording", "info", text(file), "--json"]));
        assert_eq!((&info["complete"], &info["lost"]), (&true.into(), &0.into()), "{info}");
        assert!((3.0..30.0).contains(&info["duration_s"].as_f64().expect("of a test")), "{info}");
        let (replay, code) = replayed(&system, file, &[]);
        assert_eq!((code, &replay["identical"]), (0, &replay["compared"]), "{replay}");
        let (restarted, code) = replayed(&system, file, &["--stage", "controller", "--from", "35"]);
        assert!(code == 0 && restarted["compared"].as_u64() > Some(0), "{restarted}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_recording_that_is_being_written_is_not_replaced() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_FREE[..], &["--record=drive.mcap"]].concat());
        system.wait_until("the recording is there", |system| system.folder().join("drive.mcap").exists());
        system.wait_until_driving();
        let output = system.run(&["record", "drive.mcap", "--force", "--duration", "0.5"]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("drive.mcap: another process is writing this file"), "{message}");
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let recording = system.report().recording.expect("a recording");
        let info = json(&system.run(&["recording", "info", "drive.mcap", "--json"]));
        assert_eq!((&info["complete"], &info["bytes"]), (&true.into(), &recording.bytes.into()), "{info}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_collision_and_a_stop_in_mid_drive_leave_a_file_that_is_replayed_to_the_bit() {
    repeat_when_late(|| {
        // It appears where no stop is possible.
        let sudden = ["sudden", "--set", "obstacle.0.appears_ahead_m=0.1"];
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&sudden[..], &RING].concat());
        assert_eq!(system.wait().code(), Some(3), "{}", system.stderr());
        assert_eq!(system.report().outcome, Outcome::Collision);
        assert_last_is_replayed(&system);

        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &RING].concat());
        system.wait_until("two seconds are driven", |system| {
            system.status().is_some_and(|status| status.scan > 20)
        });
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        assert_eq!(system.report().outcome, Outcome::Interrupted);
        assert_last_is_replayed(&system);
    });
}

#[test]
fn a_rollback_leaves_a_file_that_is_replayed_but_for_the_other_program() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &RING].concat());
        let hangs = [
            "swap",
            "controller",
            "--standby-scans",
            "40",
            "--json",
            "--",
            FAULTY_CONTROLLER,
            "hang-after",
            "30",
        ];
        let certificate = json(&system.run(&hangs));
        assert_eq!(certificate["outcome"], "rolled_back", "{certificate}");
        system.wait();
        let replay = assert_last_is_replayed(&system);
        let reasons = replay["reasons"].to_string();
        assert!(
            reasons.contains("not_compared: the process is no implementation of this program"),
            "{replay}"
        );
    });
}

/// The newest file of an incident: each output that can be recomputed is identical, and only those of other programs can't.
fn assert_last_is_replayed(system: &TestSystem) -> serde_json::Value {
    let named = system.report().incidents;
    let file = named.last().unwrap_or_else(|| panic!("no incident: {}", system.stderr()));
    let (replay, code) = replayed(system, file, &[]);
    assert_eq!((code, &replay["identical"]), (0, &replay["compared"]), "{replay}");
    assert!(replay["compared"].as_u64() > Some(100), "{replay}");
    let reasons = replay["reasons"].as_array().expect("of a test").iter();
    for reason in reasons {
        assert!(
            reason["reason"].as_str().is_some_and(|reason| reason.starts_with("not_compared")),
            "{replay}"
        );
    }
    system.assert_nothing_left();
    replay
}

#[test]
fn a_drive_that_lands_leaves_no_file_of_an_incident() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_FREE[..], &RING].concat());
        assert!(recorder_of(&system).is_some());
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        assert_eq!((incidents_of(&system), system.report().incidents), (vec![], vec![]));
        system.assert_nothing_left();
    });
}

#[test]
fn an_adopted_system_is_recorded_and_the_death_of_its_orchestrator_leaves_a_file() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["free", "--set", "goal.x_m=20", "--set", "recording.ring_s=60"]);
        system.wait_until("two seconds are driven", |system| {
            system.status().is_some_and(|status| status.scan > 20)
        });
        system.kill_orchestrator();
        system.wait_until("the death is on disk", |system| !incidents_of(system).is_empty());
        system.adopt(&["--out", "out"]);
        let before = incidents_of(&system).len();
        let file = system.folder().join("adopted.mcap");
        let recorded = system.run(&["record", text(&file), "--duration", "1.5"]);
        assert_eq!(recorded.status.code(), Some(0), "{}", String::from_utf8_lossy(&recorded.stderr));
        let info = json(&system.run(&["recording", "info", text(&file), "--json"]));
        assert!(info["duration_s"].as_f64() > Some(1.0) && info["complete"] == true, "{info}");
        let (replay, code) = replayed(&system, &file, &[]);
        assert_eq!((code, &replay["identical"]), (0, &replay["compared"]), "{replay}");
        assert_eq!(system.run(&["stop"]).status.code(), Some(0));
        assert_eq!(system.wait().code(), Some(1), "{}", system.stderr());
        assert_eq!(system.report().incidents.len(), 1, "{}", system.stderr());
        assert!(incidents_of(&system).len() > before);
        system.wait_until("the first recorder has ended", |system| recorder_of(system).is_none());
        system.assert_nothing_left();
    });
}

/// The files of incidents of a system.
fn incidents_of(system: &TestSystem) -> Vec<PathBuf> {
    let files = std::fs::read_dir(system.folder().join("out")).expect("of a test").flatten();
    let is_incident = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "mcap");
    files.map(|entry| entry.path()).filter(is_incident).collect()
}
