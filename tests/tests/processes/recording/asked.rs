//! Drives of every kind that `why` is asked about: it names the cause, and a fork repeats the drive.
//!
//! The drives are those of `tests/asked.toml`. With `SCANLOOP_DRIVES=FOLDER` their recordings are kept there, with the answers.

use std::path::Path;

use rustix::process::Signal;
use scanloop_tests::machine::repeat_when_late;
use scanloop_tests::swaps::standby;
use scanloop_tests::{TestSystem, printed};
use serde::Deserialize;
use serde_json::Value;
use shared_types::Role;

use super::{EXECUTABLE, json};

const FILE: &str = "drive.mcap";

#[derive(Debug, Deserialize)]
struct AskedDrives {
    drive: Vec<AskedDrive>,
}

#[derive(Debug, Deserialize)]
struct AskedDrive {
    kind: String,
    run: String,
    at: Option<u64>,
    act: Option<String>,
    scan: String,
    says: Vec<String>,
}

fn ask(kinds: &[&str]) {
    let AskedDrives { drive } =
        toml::from_str(include_str!("../../../asked.toml")).expect("the table of drives");
    let wanted: Vec<AskedDrive> =
        drive.into_iter().filter(|drive| kinds.contains(&drive.kind.as_str())).collect();
    assert_eq!(wanted.len(), kinds.len(), "{kinds:?}");
    for drive in &wanted {
        repeat_when_late(|| drive.ask());
    }
}

impl AskedDrive {
    fn ask(&self) {
        let mut system = TestSystem::new(EXECUTABLE);
        let certificate = self.drive(&mut system);
        let scan = self.scan(&system, &certificate);
        let output = system.run(&["why", FILE, &scan]);
        let answer = String::from_utf8_lossy(&output.stdout).into_owned();
        let mut rest = answer.as_str();
        for part in &self.says {
            let found = rest.find(part.as_str());
            let place =
                found.unwrap_or_else(|| panic!("{}: {part:?} is missing: {}", self.kind, printed(&output)));
            rest = &rest[place + part.len()..];
        }
        self.keep(&system, &answer);
        let fork = system.run(&["fork", FILE, "--at", &scan, "--json"]);
        let forked = &json(&fork)["forks"][0];
        assert_eq!(fork.status.code(), Some(0), "{}: {forked}", self.kind);
        assert_eq!(
            (&forked["identical"], &forked["parts"]),
            (&forked["compared"], &Value::Null),
            "{}",
            self.kind
        );
        assert!(forked["compared"].as_u64() > Some(0), "{}: {forked}", self.kind);
        let replay = json(&system.run(&["replay", FILE, "--json"]));
        assert_eq!(replay["identical"], replay["compared"], "{}: {replay}", self.kind);
        assert!(replay["compared"].as_u64() > Some(100), "{}: {replay}", self.kind);
        system.assert_nothing_left();
    }

    /// Drives, and gives what a swap has printed.
    fn drive(&self, system: &mut TestSystem) -> Value {
        let record = format!("--record={FILE}");
        let run: Vec<&str> = self.run.split(' ').chain([record.as_str()]).collect();
        let (Some(at), Some(act)) = (self.at, &self.act) else {
            system.lockstep(&run.into_iter().filter(|word| *word != "--lockstep").collect::<Vec<_>>());
            return Value::Null;
        };
        system.start(&run);
        system.wait_until("the scan is reached", |system| {
            system.status().is_some_and(|status| status.scan >= at)
        });
        let output = if act == "kill" {
            let (child, new, _) = standby(system, Role::Controller, &["--to", "nmpc"]);
            system.signal(new, Signal::KILL);
            child.wait_with_output().expect("the swap ends")
        } else {
            system.run(&act.split(' ').collect::<Vec<_>>())
        };
        system.wait();
        serde_json::from_slice(&output.stdout).unwrap_or_default()
    }

    fn scan(&self, system: &TestSystem, certificate: &Value) -> String {
        if let Some((overview, words)) = self.scan.split_once(' ') {
            let rows = json(&system.run(&["why", FILE, overview, "--json"]));
            let row = rows.as_array().and_then(|rows| {
                rows.iter().find(|row| row["text"].as_str().is_some_and(|text| text.contains(words)))
            });
            return row.unwrap_or_else(|| panic!("{}: {words:?} is missing in {rows}", self.kind))["scan"]
                .to_string();
        }
        certificate.get(&self.scan).map_or_else(|| self.scan.clone(), Value::to_string)
    }

    fn keep(&self, system: &TestSystem, answer: &str) {
        let Some(folder) = std::env::var_os("SCANLOOP_DRIVES") else { return };
        let name = Path::new(&folder).join(self.kind.replace([':', ' '], "-"));
        std::fs::copy(system.folder().join(FILE), name.with_extension("mcap")).expect("a folder");
        std::fs::write(name.with_extension("txt"), answer).expect("a folder");
    }
}

#[test]
fn each_reason_of_a_stop_is_named_with_its_number_and_limit() {
    ask(&[
        "stop: blocked",
        "stop: self-check",
        "stop: scanner",
        "stop: reversal",
        "stop: stale",
        "stop: unseen",
        "stop: unverified",
        "stop: paused",
        "stop: landed",
        "stop: requested",
        "stop: bad input",
    ]);
}

#[test]
fn a_miss_and_a_contact_are_named() {
    ask(&["miss", "miss: passed", "contact"]);
}

#[test]
fn the_side_of_an_obstacle_is_named_with_what_both_sides_cost() {
    ask(&["wrong side"]);
}

#[test]
fn a_slow_and_a_late_scan_are_named_with_the_stage() {
    ask(&["slow", "late"]);
}

#[test]
fn swap_rollback_death_and_fault_are_named_with_the_process() {
    ask(&["swap", "rollback", "death", "fault"]);
}
