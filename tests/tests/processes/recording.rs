//! Drives that are recorded, recordings that are cut off, and replays.

mod asked;
mod asking;
mod changed;
mod damaged;
mod foreign;
mod fork;
mod incidents;
mod limits;
mod own_topics;
mod programs;
mod refused;
mod replay;
mod why;

use scanloop_tests::machine::repeat_when_late;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Output;

use recording::mcap::{Channel, McapReader, Schema, Writer};
use rustix::process::Signal;
use scanloop_tests::namespace::is_inside;
use scanloop_tests::{SHORT_CORRIDOR, SHORT_FREE, TestSystem};
use serde_json::Value;

use crate::languages::tools;

const EXECUTABLE: &str = env!("CARGO_BIN_EXE_scanloop-under-test");

/// A recorded drive in lock-step; its system and the recording.
pub(crate) fn recorded(arguments: &[&str]) -> (TestSystem, PathBuf) {
    let system = TestSystem::new(EXECUTABLE);
    let file = recorded_in(&system, arguments);
    (system, file)
}

/// A drive in lock-step that is recorded in a given system.
fn recorded_in(system: &TestSystem, arguments: &[&str]) -> PathBuf {
    let report = system.lockstep(&[arguments, &["--record=drive.mcap"]].concat());
    let recording = report.recording.expect("a recording");
    assert_eq!(recording.file, system.folder().join("drive.mcap"));
    assert_eq!((recording.lost, recording.error.as_str()), (0, ""), "{recording:?}");
    assert_eq!(recording.bytes, recording.file.metadata().expect("of a test").len());
    recording.file
}

fn text(path: &Path) -> &str {
    path.to_str().expect("of a test")
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)))
}

/// The report of a replay, and its exit code.
pub(crate) fn replayed(system: &TestSystem, file: &Path, arguments: &[&str]) -> (Value, i32) {
    let output = system.run(&[&["replay", text(file), "--json"], arguments].concat());
    (json(&output), output.status.code().expect("of a test"))
}

#[test]
fn a_recorded_drive_is_the_same_drive_and_its_replay_agrees_to_the_bit() {
    repeat_when_late(|| {
        let unrecorded = TestSystem::new(EXECUTABLE).lockstep(&SHORT_CORRIDOR);
        let system = TestSystem::new(EXECUTABLE);
        let report = system.lockstep(&[&SHORT_CORRIDOR[..], &["--record"]].concat());
        assert_eq!(report.digests, unrecorded.digests);
        let file = report.recording.expect("of a test").file;
        let info = json(&system.run(&["recording", "info", text(&file), "--json"]));
        assert_eq!(
            (&info["complete"], &info["lost"], &info["lockstep"]),
            (&true.into(), &0.into(), &true.into())
        );
        for topic in ["scan", "odometry", "truth", "pose", "obstacles", "command", "actuation"] {
            assert!(
                info["channels"][format!("/scanloop/{topic}")].as_u64() >= Some(report.scans.published),
                "{info}"
            );
        }
        let (whole, code) = replayed(&system, &file, &[]);
        // A scan that was granted ahead is in the file too, whole or in part.
        let counted = 7 * report.scans.published..=7 * report.scans.published + 7;
        assert!(
            code == 0 && whole["compared"].as_u64().is_some_and(|count| counted.contains(&count)),
            "{whole}"
        );
        assert_eq!((&whole["identical"], &whole["skipped"]), (&whole["compared"], &0.into()), "{whole}");
        let (later, code) = replayed(&system, &file, &["--from", "50", "--stage", "controller"]);
        assert_eq!((code, &later["identical"]), (0, &later["compared"]), "{later}");
        assert_eq!(
            (later["compared"].as_u64(), &later["skipped"]),
            (Some(report.scans.published - 49), &0.into())
        );
    });
}

#[test]
fn a_flipped_bit_is_found_with_its_field() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let flipped = system.folder().join("flipped.mcap");
        // The yaw of the tenth pose stands behind the encapsulation and the header.
        rewrite(&file, &flipped, "/scanloop/pose", |number, data| data[4 + 288] ^= u8::from(number == 9));
        let (report, code) = replayed(&system, &flipped, &["--stage", "estimator"]);
        assert_eq!(
            (
                code,
                report["compared"].as_u64().expect("of a test")
                    - report["identical"].as_u64().expect("of a test")
            ),
            (1, 1)
        );
        let difference = &report["differences"][0];
        assert_eq!(
            (&difference["topic"], &difference["scan"], &difference["field"]),
            (&"pose".into(), &10.into(), &"yaw_rad".into())
        );
    });
}

/// Copies a recording; `change` gets the number and the bytes of each message of a channel.
pub(crate) fn rewrite(from: &Path, to: &Path, topic: &str, change: impl Fn(usize, &mut [u8])) {
    let mut number = 0;
    rewrite_with(
        from,
        to,
        |_, data| data.to_vec(),
        |of, _, data| {
            if of == topic {
                change(number, data);
                number += 1;
            }
        },
    );
}

/// Copies a recording with other files and other messages, which come with topic and sequence; empty ones are left out.
fn rewrite_with(
    from: &Path,
    to: &Path,
    file: impl Fn(&str, &[u8]) -> Vec<u8>,
    mut change: impl FnMut(&str, u32, &mut Vec<u8>),
) {
    let mut reader = McapReader::new(File::open(from).expect("of a test")).expect("of a test");
    let mut writer = None;
    while let Some(message) = reader.next_message().expect("of a test") {
        let (channel, sequence, log_ns, mut data) =
            (message.channel, message.sequence, message.log_ns, message.data.to_vec());
        let contents = reader.contents();
        let writer = writer.get_or_insert_with(|| {
            let schemas: Vec<Schema> =
                contents.schemas.values().map(|schema| schema.as_ref().clone()).collect();
            let channels: Vec<Channel> = contents.channels.values().cloned().collect();
            let mut writer = Writer::new(File::create(to).expect("of a test"), "test", &schemas, &channels)
                .expect("of a test");
            for attached in &contents.attachments {
                let data = file(&attached.name, &attached.data);
                writer.attach(&attached.name, &attached.media_type, &data, 0).expect("of a test");
            }
            writer
        });
        change(&contents.channels[&channel].topic, sequence, &mut data);
        if !data.is_empty() {
            writer.message(channel, sequence, log_ns, &[&data]);
        }
    }
    writer.expect("of a test").finish().expect("of a test");
}

#[test]
fn a_recording_that_is_cut_off_is_read_and_repaired_up_to_its_last_second() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let whole = std::fs::read(&file).unwrap();
        let cut = system.folder().join("cut.mcap");
        std::fs::write(&cut, &whole[..whole.len() * 2 / 3]).unwrap();
        let info = json(&system.run(&["recording", "info", text(&cut), "--json"]));
        assert_eq!(info["complete"], false);
        assert!(info["duration_s"].as_f64() > Some(2.0), "{info}");
        let repaired = system.run(&["recording", "repair", text(&cut)]);
        let message = scanloop_tests::printed(&repaired);
        assert!(repaired.status.code() == Some(1) && message.contains("the file was cut off"), "{message}");
        let repaired = system.folder().join("cut-repaired.mcap");
        let mended = json(&system.run(&["recording", "info", text(&repaired), "--json"]));
        assert_eq!((&mended["complete"], &mended["channels"]), (&true.into(), &info["channels"]));
        assert_eq!(replayed(&system, &repaired, &[]).1, 0);
        let output = system.run(&["replay", text(&cut)]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            output.status.code() == Some(0) && message.contains("warning") && message.contains("cut off"),
            "{message}"
        );
    });
}

#[test]
fn a_recorder_that_is_killed_costs_no_scan_and_leaves_a_readable_file() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_CORRIDOR[..], &["--record"]].concat());
        system.wait_until("three seconds are driven", |system| {
            system.status().is_some_and(|status| status.scan > 30)
        });
        let recorder = recorder_of(&system).expect("a recorder");
        system.signal(recorder, Signal::KILL);
        assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
        assert!(system.stderr().contains("the rest of the drive is not recorded"), "{}", system.stderr());
        let report = system.report();
        assert_eq!(
            (report.scans.lost, report.scans.unaccounted, report.ledger.residual),
            (0, 0, 0),
            "{report:?}"
        );
        let file = report.recording.unwrap().file;
        let info = json(&system.run(&["recording", "info", text(&file), "--json"]));
        assert_eq!(info["complete"], false);
        assert!(info["duration_s"].as_f64() > Some(1.0), "{info}");
        system.assert_nothing_left();
    });
}

#[test]
fn a_disk_that_fills_up_costs_no_scan_and_the_loss_is_told() {
    repeat_when_late(|| {
        let name = concat!(module_path!(), "::a_disk_that_fills_up_costs_no_scan_and_the_loss_is_told");
        if !is_inside(name, "mount -t tmpfs -o size=200k tmpfs /mnt &&", |_| {}) {
            return;
        }
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&[&SHORT_FREE[..], &["--record=/mnt/drive.mcap"]].concat());
        assert_eq!(system.wait().code(), Some(4), "{}", system.stderr());
        let report = system.report();
        assert_eq!((report.scans.lost, report.scans.unaccounted, report.ledger.residual), (0, 0, 0));
        let recording = report.recording.expect("of a test");
        assert!(recording.error.contains("No space left"), "{recording:?}");
        assert!(recording.samples > 0 && recording.lost > 0, "{recording:?}");
        assert!(system.stderr().contains("the rest of the drive is not recorded: No space left"));
        let info = json(&system.run(&["recording", "info", text(&recording.file), "--json"]));
        assert!(info["complete"] == false && info["duration_s"].as_f64() > Some(0.5), "{info}");
        assert_eq!(replayed(&system, &recording.file, &[]).1, 0);
        system.assert_nothing_left();
    });
}

#[test]
fn a_disk_that_is_full_at_the_start_is_an_error_before_the_drive() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        std::fs::create_dir_all(system.folder().join("out")).expect("of a test");
        // Every write to this device fails as on a full disk.
        std::os::unix::fs::symlink("/dev/full", system.folder().join("out/recording.mcap"))
            .expect("of a test");
        let output = system.run(&["run", "free", "--out", "out", "--record"]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{message}");
        assert!(
            message.contains("the recorder did not start") && message.contains("No space left"),
            "{message}"
        );
        system.assert_nothing_left();
    });
}

/// The process that records a system.
fn recorder_of(system: &TestSystem) -> Option<i32> {
    let processes = std::fs::read_dir("/proc").expect("of a test").flatten();
    let mut pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    pids.find(|pid| {
        let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let words: Vec<&[u8]> = line.split(|byte| *byte == 0).collect();
        words.contains(&system.id().as_bytes()) && words.contains(&&b"--of-run"[..])
    })
}

#[test]
fn a_live_drive_with_a_restart_and_swaps_is_replayed_to_the_bit() {
    repeat_when_late(|| {
        let mut system = TestSystem::new(EXECUTABLE);
        system.start(&["long", "--record"]);
        // A robot may begin with a state that has the first actuation it takes; three of six such replays differed.
        let robot = ["swap", "robot", "--to", "emulator"];
        for arguments in [
            ["restart", "estimator"].as_slice(),
            &["swap", "controller", "--to", "nmpc"],
            &robot,
            &robot,
            &robot,
        ] {
            let output = system.run(arguments);
            assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        }
        let code = system.wait().code();
        let report = system.report();
        assert_eq!(code, Some(0), "{} {}", report.reason, system.stderr());
        let file = report.recording.unwrap().file;
        let (report, code) = replayed(&system, &file, &[]);
        assert_eq!((code, &report["identical"]), (0, &report["compared"]), "{report}");
        system.assert_nothing_left();
    });
}

#[test]
fn programs_of_others_read_every_message_unchanged() {
    repeat_when_late(|| {
        let Some(python) = tools::python("programs_of_others_read_every_message_unchanged") else { return };
        let (system, file) = recorded(&SHORT_FREE);
        let bag = system.folder().join("bag");
        let exported = system.run(&["recording", "export", text(&file), "--rosbag2", text(&bag)]);
        assert_eq!(exported.status.code(), Some(0), "{}", String::from_utf8_lossy(&exported.stderr));
        let script = tools::examples("python").join("read_recording.py");
        let output = std::process::Command::new(python).arg(script).args([&file, &bag]).output().unwrap();
        let (lines, errors) =
            (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{lines}{errors}");
        let info = json(&system.run(&["recording", "info", text(&file), "--json"]));
        for (topic, count) in info["channels"].as_object().unwrap() {
            let found =
                lines.lines().any(|line| line.starts_with(topic) && line.ends_with(&format!(" {count}")));
            assert!(found || count == 0, "{topic} {count}: {lines}");
        }
        assert!(lines.ends_with("all messages are the same when they are encoded again\n"), "{lines}");
    });
}
