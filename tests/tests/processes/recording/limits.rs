//! Files that unpack to more than there is memory.

use scanloop_tests::machine::repeat_when_late;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use recording::mcap::{Channel, MAGIC, OpenChunk, Schema, Writer};
use scanloop_tests::{SHORT_FREE, TestSystem};
use shared_types::Topic;

use super::damaged::{CHUNK, records};
use super::{EXECUTABLE, recorded, text};

/// Address space that a command gets: a stack of each thread, and what the page of the manual states [KiB].
const MEMORY_KIB: u64 = 900 << 10;

/// Runs a command on a file with little memory.
fn limited(system: &TestSystem, arguments: &[&str]) -> Output {
    limited_to(system, MEMORY_KIB, arguments)
}

fn limited_to(system: &TestSystem, memory_kib: u64, arguments: &[&str]) -> Output {
    let script = format!("ulimit -v {memory_kib}; exec \"$0\" \"$@\"");
    let mut command = Command::new("sh");
    command.args(["-c", &script, EXECUTABLE]).args(arguments).current_dir(system.folder());
    command.output().expect("a shell")
}

/// A file of so many chunks that unpack to a message of 60 MiB each.
fn bomb(folder: &Path, chunks: u32) -> PathBuf {
    let path = folder.join("bomb.mcap");
    let schema = Schema { name: "a/msg/B".into(), encoding: "ros2msg".into(), text: "uint8[] a\n".into() };
    let (topic, encoding) = ("/large".into(), "cdr".into());
    let channel = Channel { topic, schema: 1, encoding, metadata: Vec::new() };
    let file = File::create(&path).expect("of a test");
    let mut writer = Writer::new(file, "test", &[schema], &[channel]).expect("of a test");
    let zeros = vec![0; 60 << 20];
    for number in 1..=chunks {
        writer.message(0, number, u64::from(number), &[&zeros]);
        writer.end_chunk().expect("of a test");
    }
    writer.finish().expect("of a test");
    path
}

#[test]
fn large_chunks_are_read_one_after_the_other_in_bounded_memory() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let file = bomb(system.folder(), 16);
        assert!(file.metadata().expect("of a test").len() < 6 << 20);
        let [bag, csv] = ["bag", "csv"].map(|name| system.folder().join(name));
        let commands = [
            vec!["recording", "info", text(&file)],
            vec!["recording", "repair", text(&file)],
            vec!["recording", "export", text(&file), "--csv", text(&csv)],
            vec!["recording", "export", text(&file), "--rosbag2", text(&bag)],
        ];
        for arguments in commands {
            let output = limited(&system, &arguments);
            let message = scanloop_tests::printed(&output);
            assert_eq!(output.status.code(), Some(0), "{arguments:?}: {message}");
        }
        for arguments in [["replay", text(&file)], ["view", text(&file)]] {
            let output = limited(&system, &arguments);
            let message = scanloop_tests::printed(&output);
            assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        }
    });
}

#[test]
fn too_little_memory_is_no_damage_of_the_file() {
    let system = TestSystem::new(EXECUTABLE);
    let file = bomb(system.folder(), 1);
    let mut is_told = false;
    // From too little to begin with to nearly enough.
    for mebibytes in (40..120).step_by(8) {
        let output = limited_to(&system, mebibytes << 10, &["recording", "info", text(&file)]);
        let message = scanloop_tests::printed(&output);
        assert!(!message.contains("damaged"), "{mebibytes} MiB: {message}");
        is_told |= output.status.code() == Some(4) && message.contains("raise `ulimit -v`");
    }
    assert!(is_told);
}

#[test]
fn sizes_in_a_file_beyond_the_limits_are_refused_with_the_number() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let whole = std::fs::read(&file).expect("of a test");
        let second = records(&whole, CHUNK)[1].clone();
        // Length of the record; of its content, behind two times; of its index.
        let gibibyte = (1_u64 << 30).to_le_bytes();
        let mut unpacked = whole.clone();
        unpacked[second.start + 25..second.start + 33].copy_from_slice(&gibibyte);
        let mut attached = MAGIC.to_vec();
        attached.extend_from_slice(&whole[8..second.start]);
        attached.push(9);
        attached.extend_from_slice(&gibibyte);
        let sparse = system.folder().join("sparse.mcap");
        std::fs::write(&sparse, attached).expect("of a test");
        File::options().write(true).open(&sparse).and_then(|file| file.set_len(2 << 30)).expect("of a test");
        let chunk = system.folder().join("chunk.mcap");
        std::fs::write(&chunk, unpacked).expect("of a test");
        let told = [
            (&chunk, "a chunk of 1073741824 bytes, 67108864 are allowed"),
            (&sparse, "an attached file or a text of 1073741824 bytes, 134217728 are allowed"),
        ];
        for (file, reason) in told {
            for command in [&["recording", "info"][..], &["replay"], &["view"]] {
                let output = limited(&system, &[command, &[text(file)]].concat());
                let message = scanloop_tests::printed(&output);
                assert_eq!(output.status.code(), Some(2), "{message}");
                assert!(message.contains(reason), "{message}");
            }
        }
        // It may be the number that is damaged.
        let output = limited(&system, &["recording", "repair", text(&chunk)]);
        let message = scanloop_tests::printed(&output);
        assert!(output.status.code() == Some(1) && message.contains(": up to "), "{message}");
    });
}

#[test]
fn a_small_file_with_many_samples_is_refused_before_they_fill_the_memory() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let path = system.folder().join("many.mcap");
        let mut writer = recording::writer(File::create(&path).expect("of a test")).expect("of a test");
        let (mut open, size) = (OpenChunk::default(), Topic::Checkpoint.size());
        let zeros = vec![0; size];
        for number in 0..(30 << 20) / size as u32 {
            open.message(Topic::Checkpoint as u16, number, [u64::from(number); 2], &[&[0, 1, 0, 0], &zeros]);
        }
        let chunk = open.seal().expect("of a test");
        for _ in 0..10 {
            writer.chunk(&chunk).expect("of a test");
        }
        writer.finish().expect("of a test");
        assert!(path.metadata().expect("of a test").len() < 3 << 20);
        for command in ["replay", "view"] {
            let output = limited(&system, &[command, text(&path)]);
            let message = scanloop_tests::printed(&output);
            assert_eq!(output.status.code(), Some(2), "{command}: {message}");
            assert!(message.contains("its samples have more than 268435456 bytes"), "{command}: {message}");
        }
    });
}

/// A file of another program: a chunk with this content behind these records, without a summary.
fn foreign(path: &Path, records: &[u8], content: &[u8]) {
    let mut file = File::create(path).expect("of a test");
    let mut chunk = [[0_u8; 16].as_slice(), &(content.len() as u64).to_le_bytes(), &[0; 8]].concat();
    chunk.extend((content.len() as u64).to_le_bytes());
    chunk.extend_from_slice(content);
    let header = record(1, &[0; 8]);
    let end = [record(15, &[0; 4]), record(2, &[0; 20]), MAGIC.to_vec()].concat();
    let parts = [&MAGIC[..], &header, records, &record(CHUNK, &chunk), &end];
    parts.iter().try_for_each(|part| file.write_all(part)).expect("of a test");
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode], &(body.len() as u64).to_le_bytes()[..], body].concat()
}

fn sized(text: &[u8]) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text].concat()
}

fn channel(number: u16, schema: u16) -> Vec<u8> {
    let topic = sized(format!("/t{number}").as_bytes());
    record(4, &[&number.to_le_bytes()[..], &schema.to_le_bytes(), &topic, &sized(b"cdr"), &[0; 4]].concat())
}

fn message(channel: u16) -> Vec<u8> {
    record(5, &[&channel.to_le_bytes()[..], &[1; 4], &[0; 16], b"content"].concat())
}

#[test]
fn a_large_schema_of_many_channels_is_held_once() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (file, out) = (system.folder().join("channels.mcap"), system.folder().join("out.mcap"));
        let fields = sized(&vec![b'\n'; (4 << 20) - 100]);
        let schema =
            record(3, &[&1_u16.to_le_bytes()[..], &sized(b"a/msg/A"), &sized(b"ros2msg"), &fields].concat());
        let channels: Vec<u8> = (1..400).flat_map(|number| channel(number, 1)).collect();
        foreign(&file, &[schema, channels].concat(), &message(1));
        let bag = system.folder().join("bag");
        for arguments in [
            ["recording", "repair", text(&file), "--out", text(&out), "--force"].as_slice(),
            &["recording", "cut", text(&file), "--out", text(&out), "--force"],
            &["recording", "export", text(&file), "--rosbag2", text(&bag)],
        ] {
            let output = limited(&system, arguments);
            assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", scanloop_tests::printed(&output));
        }
    });
}

#[test]
fn large_names_of_attached_files_are_refused_before_they_fill_the_memory() {
    repeat_when_late(|| {
        let system = TestSystem::new(EXECUTABLE);
        let (file, out) = (system.folder().join("names.mcap"), system.folder().join("out.mcap"));
        let name = vec![0; 120 << 20];
        let attached = record(9, &[&[0; 16][..], &sized(&name), &[0; 4 + 8 + 4]].concat());
        foreign(&file, &attached.repeat(5), &[channel(1, 0), message(1)].concat());
        for command in
            [&["recording", "info", text(&file)][..], &["recording", "cut", text(&file), "--out", text(&out)]]
        {
            let output = limited(&system, command);
            let message = scanloop_tests::printed(&output);
            assert!(output.status.code() == Some(2) && message.contains("4194304 are allowed"), "{message}");
        }
        let output = limited(&system, &["recording", "repair", text(&file), "--out", text(&out)]);
        let message = scanloop_tests::printed(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
    });
}
