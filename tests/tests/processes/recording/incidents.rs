//! The last seconds before an incident.

use std::path::PathBuf;

use rustix::process::Signal;
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, System};
use shared_types::Role;

use super::{EXECUTABLE, json, recorder_of, replayed, text};

#[test]
fn a_kill_leaves_one_file_with_the_seconds_before_it_and_the_restart_and_it_is_replayed_to_the_bit() {
    let mut system = System::new(EXECUTABLE);
    system.start(&[&SHORT_CORRIDOR[..], &["--set", "recording.ring_s=60"]].concat());
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
    assert!(info["duration_s"].as_f64() > Some(3.0), "{info}");
    let (replay, code) = replayed(&system, file, &[]);
    assert_eq!((code, &replay["identical"]), (0, &replay["compared"]), "{replay}");
    let (restarted, code) = replayed(&system, file, &["--stage", "controller", "--from", "35"]);
    assert!(code == 0 && restarted["compared"].as_u64() > Some(0), "{restarted}");
    system.assert_nothing_left();
}

#[test]
fn a_drive_that_lands_leaves_no_file_of_an_incident() {
    let mut system = System::new(EXECUTABLE);
    system.start(&[&SHORT_FREE[..], &["--set", "recording.ring_s=60"]].concat());
    assert!(recorder_of(&system).is_some());
    assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
    assert_eq!((incidents_of(&system), system.report().incidents), (vec![], vec![]));
    system.assert_nothing_left();
}

#[test]
fn an_adopted_system_is_recorded_and_the_death_of_its_orchestrator_leaves_a_file() {
    let mut system = System::new(EXECUTABLE);
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
}

/// The files of incidents of a system.
fn incidents_of(system: &System) -> Vec<PathBuf> {
    let files = std::fs::read_dir(system.folder().join("out")).expect("of a test").flatten();
    let is_incident = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "mcap");
    files.map(|entry| entry.path()).filter(is_incident).collect()
}
