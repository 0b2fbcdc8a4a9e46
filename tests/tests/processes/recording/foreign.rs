//! Recordings that another program has written anew, and several that were joined to one file.

use scanloop_tests::machine::repeat_when_late;
use std::path::{Path, PathBuf};
use std::process::Command;

use scanloop_tests::{SHORT_FREE, TestSystem};

use super::{json, recorded, recorded_in, replayed, text};
use crate::languages::tools;

/// Copies a recording with the library of Foxglove: compression and whether there are chunks are its arguments.
const REWRITE: &str = r#"
import sys
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
source, target, compression, chunks = sys.argv[1:5]
with open(source, "rb") as file, open(target, "wb") as out:
    reader = make_reader(file)
    writer = Writer(out, compression=CompressionType[compression], use_chunking=chunks == "chunks")
    writer.start("ros2", "another program")
    schemas, channels = {}, {}
    for schema, channel, message in reader.iter_messages():
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata)
        writer.add_message(
            channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
    for attachment in reader.iter_attachments():
        writer.add_attachment(
            attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data)
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    writer.finish()
"#;

fn repaired(system: &TestSystem, file: &Path) -> PathBuf {
    let new = file.with_extension("new.mcap");
    let output = system.run(&["recording", "repair", text(file), "--out", text(&new)]);
    let message = scanloop_tests::printed(&output);
    assert!(output.status.code() == Some(0) && message.contains("was complete"), "{message}");
    new
}

#[test]
fn a_recording_that_another_program_has_written_anew_is_read_by_every_command() {
    repeat_when_late(|| {
        let name = "a_recording_that_another_program_has_written_anew_is_read_by_every_command";
        let Some(python) = tools::python(name) else { return };
        let (system, file) = recorded(&SHORT_FREE);
        let info = |file: &Path| json(&system.run(&["recording", "info", text(file), "--json"]));
        let before = info(&file);
        let compared = replayed(&system, &file, &[]).0["identical"].clone();
        for [compression, chunks] in
            [["ZSTD", "chunks"], ["NONE", "chunks"], ["LZ4", "chunks"], ["NONE", "none"]]
        {
            let other = system.folder().join(format!("{compression}-{chunks}.mcap"));
            let arguments = ["-c", REWRITE, text(&file), text(&other), compression, chunks];
            let written = Command::new(&python).args(arguments).output().expect("an interpreter");
            assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
            for read in [other.clone(), repaired(&system, &other)] {
                let found = info(&read);
                assert_eq!((&found["complete"], &found["lost"]), (&true.into(), &0.into()), "{found}");
                for (topic, count) in found["channels"].as_object().expect("channels") {
                    assert_eq!(count, &before["channels"][topic], "{topic}");
                }
                let (replay, code) = replayed(&system, &read, &[]);
                assert_eq!((code, &replay["identical"]), (0, &compared), "{compression} {chunks}: {replay}");
            }
            let cut = other.with_extension("cut.mcap");
            let arguments =
                ["recording", "cut", text(&other), "--from", "1", "--to", "3", "--out", text(&cut)];
            assert_eq!(system.run(&arguments).status.code(), Some(0));
            assert!((1.5..2.2).contains(&info(&cut)["duration_s"].as_f64().expect("of a test")));
            let folder = other.with_extension("csv");
            let exported = system.run(&["recording", "export", text(&other), "--csv", text(&folder)]);
            assert_eq!(exported.status.code(), Some(0), "{}", String::from_utf8_lossy(&exported.stderr));
            let rows =
                std::fs::read_to_string(folder.join("pose.csv")).expect("a table").lines().count() as u64;
            assert_eq!(rows - 1, before["channels"]["/scanloop/pose"], "{compression} {chunks}");
        }
        // A file without chunks behind one with chunks, both of one run.
        let pieces = ["ZSTD-chunks", "NONE-none"].map(|name| system.folder().join(format!("{name}.mcap")));
        let joined = system.folder().join("joined.mcap");
        let bytes = pieces.map(|piece| std::fs::read(piece).expect("of a test")).concat();
        std::fs::write(&joined, bytes).expect("of a test");
        let found = info(&repaired(&system, &joined));
        for (topic, count) in found["channels"].as_object().expect("channels") {
            assert_eq!(count.as_u64(), before["channels"][topic].as_u64().map(|count| 2 * count), "{topic}");
        }
    });
}

#[test]
fn joined_recordings_are_read_as_a_whole_and_repaired_to_one_file_for_each_run() {
    repeat_when_late(|| {
        let (system, one) = recorded(&SHORT_FREE);
        let other_system = TestSystem::new(super::EXECUTABLE);
        let other = recorded_in(&other_system, &[&SHORT_FREE[..], &["--seed", "7"]].concat());
        let joined = system.folder().join("joined.mcap");
        let bytes = [&one, &other].map(|file| std::fs::read(file).expect("of a test")).concat();
        std::fs::write(&joined, bytes).expect("of a test");
        let info = |file: &Path| json(&system.run(&["recording", "info", text(file), "--json"]));
        let (first, second, all) = (info(&one), info(&other), info(&joined));
        assert_eq!((&all["files"], &all["complete"], &all["lost"]), (&2.into(), &true.into(), &0.into()));
        let sum = |key: &str| first["channels"][key].as_u64().zip(second["channels"][key].as_u64());
        for (topic, count) in all["channels"].as_object().expect("channels") {
            assert_eq!(count.as_u64(), sum(topic).map(|(one, other)| one + other), "{topic}");
        }
        let (replay, code) = replayed(&system, &joined, &[]);
        let expected = [&one, &other].map(|file| replayed(&system, file, &[]).0["identical"].as_u64());
        let expected = expected.into_iter().sum::<Option<u64>>();
        assert_eq!((code, replay["identical"].as_u64()), (0, expected), "{replay}");
        let new = repaired(&system, &joined);
        let numbered = system.folder().join("joined.new-2.mcap");
        for (part, of) in [(&new, &first), (&numbered, &second)] {
            let found = info(part);
            assert_eq!((&found["channels"], &found["run_id"]), (&of["channels"], &of["run_id"]), "{found}");
            assert_eq!(replayed(&system, part, &[]).1, 0);
        }
        // Two pieces of one run become one file again.
        let pieces = [["0", "2.5"], ["2.5", "100"]].map(|[from, to]| {
            let piece = system.folder().join(format!("piece-{from}.mcap"));
            let arguments =
                ["recording", "cut", text(&one), "--from", from, "--to", to, "--out", text(&piece)];
            assert_eq!(system.run(&arguments).status.code(), Some(0));
            std::fs::read(piece).expect("of a test")
        });
        std::fs::write(&joined, pieces.concat()).expect("of a test");
        std::fs::remove_file(&new).expect("of a test");
        let again = info(&repaired(&system, &joined));
        assert_eq!((&again["files"], &again["channels"]), (&1.into(), &first["channels"]));
        assert_eq!(again["attachments"], first["attachments"]);
    });
}
