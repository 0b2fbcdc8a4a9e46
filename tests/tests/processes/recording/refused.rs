//! Recordings that were made by other programs, damaged, or made before processes published journals.

use scanloop_tests::machine::repeat_when_late;
use std::fs::File;

use recording::mcap::{Channel, Schema, Writer};
use scanloop_tests::{SHORT_FREE, TestSystem};

use super::{EXECUTABLE, recorded, replayed, rewrite_with, text};

#[test]
fn a_recording_without_journals_says_so_and_a_program_is_compared_by_stamps() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let old = system.folder().join("old.mcap");
        let is_old = |line: &&str| !line.starts_with("journal ");
        let layouts =
            |text: &str| text.lines().filter(is_old).map(|line| format!("{line}\n")).collect::<String>();
        let change = |name: &str, data: &[u8]| match name {
            "layouts.txt" => layouts(&String::from_utf8_lossy(data)).into_bytes(),
            _ => data.to_vec(),
        };
        rewrite_with(&file, &old, change, |topic, _, data| {
            if topic == "/scanloop/journal" {
                data.clear();
            }
        });
        let output = system.run(&["replay", text(&old), "--json"]);
        let message = scanloop_tests::printed(&output);
        let reason = "nothing was compared: no journal of the process was recorded";
        assert!(output.status.code() == Some(2) && message.contains(reason), "{message}");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((&report["skipped"], &report["compared"]), (&report["samples"], &0.into()), "{report}");
        let left_out = report["not_compared"].as_array().unwrap();
        assert!(left_out.len() == 5 && left_out.iter().all(|row| row["has_journals"] == false), "{report}");
        for with in ["estimator=ekf", "controller=nmpc"] {
            let (same, _) = replayed(&system, &old, &["--with", with]);
            assert!(same["compared"].as_u64() > Some(0) && same["skipped"] == 0, "{same}");
            // Without journals the stamps tell what a process had taken, and not whether the run ended in between.
            let differences = same["differences"].as_array().unwrap();
            assert!(differences.iter().all(|difference| difference["scan"] == same["scans"]), "{same}");
        }
        system.assert_nothing_left();
    });
}

#[test]
fn recordings_that_are_newer_or_damaged_are_refused() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let damaged = system.folder().join("damaged.mcap");
        let mut bytes = std::fs::read(&file).unwrap();
        // Behind the name of the compression and the length of the first chunk.
        let chunk = bytes.windows(3).position(|name| name == b"lz4").unwrap();
        bytes[chunk + 500] ^= 1;
        std::fs::write(&damaged, bytes).unwrap();
        let newer = system.folder().join("newer.mcap");
        let schema =
            Schema { name: "scanloop_msgs/msg/Pose".into(), encoding: "ros2msg".into(), text: String::new() };
        let channel = Channel {
            topic: "/scanloop/pose".into(),
            schema: 1,
            encoding: "cdr".into(),
            metadata: Vec::new(),
        };
        let mut writer = Writer::new(File::create(&newer).unwrap(), "test", &[schema], &[channel]).unwrap();
        writer.metadata("recording", &[("version".to_owned(), "2".to_owned())]).unwrap();
        writer.message(0, 1, 1, &[&[0; 8]]);
        writer.finish().unwrap();
        for (file, reason) in [(&damaged, "damaged"), (&newer, "version 2 of the recording is not 1")] {
            let output = TestSystem::new(EXECUTABLE).run(&["replay", text(file)]);
            let message = scanloop_tests::printed(&output);
            assert!(output.status.code() == Some(2) && message.contains(reason), "{message}");
        }
    });
}

#[test]
fn files_that_are_no_recordings_are_refused_and_none_is_replaced() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = |name: &str, bytes: &[u8]| {
            let path = system.folder().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        };
        let empty = file("empty", b"");
        let foreign = file("foreign", b"#ROSBAG V2.0\n");
        let short = file("short", &recording::mcap::MAGIC);
        for (path, reason) in
            [(&empty, "empty"), (&foreign, "no MCAP file"), (&short, "not one whole second")]
        {
            for command in [&["recording", "info"][..], &["replay"]] {
                let output = system.run(&[command, &[text(path)]].concat());
                let message = scanloop_tests::printed(&output);
                assert_eq!(output.status.code(), Some(2), "{message}");
                assert!(message.contains(reason) && message.contains(text(path)), "{message}");
            }
        }
        let output = system.run(&["run", "--lockstep", "--quiet", &format!("--record={}", text(&foreign))]);
        assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(std::fs::read(&foreign).unwrap(), b"#ROSBAG V2.0\n");
    });
}
