//! Topics that a system file adds to those of the loop.

use scanloop_tests::machine::repeat_when_late;
use std::path::Path;
use std::process::Command;

use rustix::process::Signal;
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, TestSystem};
use serde_json::Value;

use super::{EXECUTABLE, json, recorded_in, text};
use crate::languages::tools;

const COMPANION: &str = env!("CARGO_BIN_EXE_faulty-companion");
const SYSTEM: [&str; 2] = ["--system", "lab.toml"];

/// The built-in system with a companion that writes the number of each scan on the topic `echo`.
fn system() -> TestSystem {
    let system = TestSystem::new(EXECUTABLE);
    let built_in = include_str!("../../../../orchestrator/systems/default.toml");
    let text = format!(
        "{built_in}\n[[topic]]\nname = \"echo\"\nlayout = \"echo.toml\"\n[[process]]\nrole = \"companion\"\nname = \
         \"writer\"\ncommand = [{COMPANION:?}, \"echo\"]\nreads = [\"odometry\"]\nwrites = [\"echo\"]\n"
    );
    let layout =
        "name = \"Echo\"\n[[field]]\nname = \"value\"\ntype = \"f64\"\ndoc = \"Number of the scan\"\n";
    std::fs::write(system.folder().join("lab.toml"), text).expect("of a test");
    std::fs::write(system.folder().join("echo.toml"), layout).expect("of a test");
    system
}

fn info(system: &TestSystem, file: &Path) -> Value {
    json(&system.run(&["recording", "info", text(file), "--json"]))
}

/// The table of the topic: scan of each sample by its header, and the value.
fn rows(system: &TestSystem, file: &Path) -> Vec<(f64, f64)> {
    let folder = file.with_extension("csv");
    let exported = system.run(&["recording", "export", text(file), "--csv", text(&folder)]);
    assert_eq!(exported.status.code(), Some(0), "{}", String::from_utf8_lossy(&exported.stderr));
    let table = std::fs::read_to_string(folder.join("echo.csv")).expect("a table");
    let names: Vec<&str> = table.lines().next().expect("names").split(',').collect();
    let column = |name: &str| names.iter().position(|known| *known == name).expect("a column");
    let (scan, value) = (column("header.scan_id"), column("value"));
    let number =
        |row: &str, at: usize| row.split(',').nth(at).and_then(|text| text.parse().ok()).expect("a number");
    table.lines().skip(1).map(|row| (number(row, scan), number(row, value))).collect()
}

#[test]
fn samples_of_a_companion_are_recorded_and_kept_by_every_copy() {
    repeat_when_late(|| {
        let system = system();
        let file = recorded_in(&system, &[&SHORT_FREE[..], &SYSTEM].concat());
        let before = info(&system, &file);
        let echoes = before["channels"]["/scanloop/echo"].as_u64().expect("the topic");
        assert_eq!((&before["channels"]["/scanloop/odometry"], &before["lost"]), (&echoes.into(), &0.into()));
        let found = rows(&system, &file);
        assert!(found.len() as u64 == echoes && found.iter().all(|(scan, value)| scan == value), "{found:?}");
        let [repaired, cut] = ["repaired.mcap", "cut.mcap"].map(|name| system.folder().join(name));
        let commands = [
            ["recording", "repair", text(&file), "--out", text(&repaired)],
            ["recording", "cut", text(&file), "--out", text(&cut)],
        ];
        for arguments in commands {
            assert_eq!(system.run(&arguments).status.code(), Some(0));
        }
        assert_eq!(info(&system, &repaired)["channels"], before["channels"]);
        assert_eq!(rows(&system, &cut), found);
        assert_eq!(super::replayed(&system, &file, &[]).1, 0);
        let Some(python) = tools::python("samples_of_a_companion_are_recorded_and_kept_by_every_copy") else {
            return;
        };
        let bag = system.folder().join("bag");
        let exported = system.run(&["recording", "export", text(&file), "--rosbag2", text(&bag)]);
        assert_eq!(exported.status.code(), Some(0), "{}", String::from_utf8_lossy(&exported.stderr));
        let script = tools::examples("python").join("read_recording.py");
        let output = Command::new(python).arg(script).args([&file, &bag]).output().expect("an interpreter");
        let lines = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{lines}{}", String::from_utf8_lossy(&output.stderr));
        assert!(lines.contains(&format!("/scanloop/echo scanloop_echo/msg/Echo {echoes}\n")), "{lines}");
    });
}

#[test]
fn a_recorder_that_joins_and_the_file_of_an_incident_have_them_too() {
    repeat_when_late(|| {
        let mut system = system();
        system.start(&[&SHORT_CORRIDOR[..], &SYSTEM, &["--set", "recording.ring_s=60"]].concat());
        system.wait_until("a second is driven", |system| {
            system.status().is_some_and(|status| status.scan > 10)
        });
        let joined = system.folder().join("joined.mcap");
        let output = system.run(&["record", text(&joined), "--duration", "1.5"]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        system.signal(system.pid(shared_types::Role::Estimator), Signal::KILL);
        assert_eq!(system.wait().code(), Some(0), "{}", system.stderr());
        let incident = system.report().incidents[0].clone();
        for (file, least) in [(&joined, 5), (&incident, 20)] {
            let found = rows(&system, file);
            assert!(found.len() >= least && found.iter().all(|(scan, value)| scan == value), "{found:?}");
            assert_eq!(info(&system, file)["lost"], 0, "{}", file.display());
        }
        system.assert_nothing_left();
    });
}
