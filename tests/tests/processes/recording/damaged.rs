//! Recordings with damaged places.

use scanloop_tests::machine::repeat_when_late;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use recording::mcap::McapReader;
use scanloop_tests::{SHORT_FREE, TestSystem};
use serde_json::Value;

use super::{json, recorded, replayed, text};

/// Places of the records of a kind in a file.
pub(super) fn records(bytes: &[u8], opcode: u8) -> Vec<Range<usize>> {
    let (mut at, mut found) = (8, Vec::new());
    while at + 9 < bytes.len() {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("eight bytes")) as usize;
        let end = at + 9 + length;
        if bytes[at] == opcode {
            found.push(at..end);
        }
        at = end;
    }
    found
}

pub(super) const CHUNK: u8 = 6;
const MESSAGE_INDEX: u8 = 7;
const DATA_END: u8 = 15;

/// How many poses each chunk of a recording holds.
fn poses_of_chunks(file: &Path, chunks: &[Range<usize>]) -> Vec<u64> {
    let mut reader = McapReader::new(File::open(file).expect("of a test")).expect("a recording");
    let mut counts = vec![0; chunks.len()];
    while let Some(channel) = reader.next_message().expect("a whole recording").map(|message| message.channel)
    {
        let at = reader.chunk_at() as usize;
        let chunk = chunks.iter().position(|chunk| chunk.start == at).expect("a chunk");
        counts[chunk] += u64::from(reader.contents().channels[&channel].topic == "/scanloop/pose");
    }
    counts
}

/// The seconds in the first line about a damaged place.
fn seconds(message: &str) -> Vec<f64> {
    let line = message.lines().next().unwrap_or_default();
    line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}

/// A copy of a recording with these bytes zero.
fn with_zeros(system: &TestSystem, name: &str, whole: &[u8], zeros: Range<usize>) -> PathBuf {
    let mut bytes = whole.to_vec();
    bytes[zeros].fill(0);
    let path = system.folder().join(name);
    std::fs::write(&path, bytes).expect("of a test");
    path
}

fn info(system: &TestSystem, file: &Path) -> Value {
    json(&system.run(&["recording", "info", text(file), "--json"]))
}

/// Repairs a file; returns the path of the new one, the exit code and what was said.
fn repair(system: &TestSystem, file: &Path) -> (PathBuf, i32, String) {
    let new = file.with_extension("new.mcap");
    let output = system.run(&["recording", "repair", text(file), "--out", text(&new)]);
    let message = scanloop_tests::printed(&output);
    (new, output.status.code().expect("an exit code"), message)
}

fn poses(info: &Value) -> u64 {
    info["channels"]["/scanloop/pose"].as_u64().expect("poses")
}

/// All commands that read a recording refuse the file and name the one that repairs it.
fn assert_refused(system: &TestSystem, file: &Path) {
    for command in [&["recording", "info"][..], &["replay"], &["view"]] {
        let output = system.run(&[command, &[text(file)]].concat());
        let message = scanloop_tests::printed(&output);
        assert_eq!(output.status.code(), Some(2), "{command:?}: {message}");
        assert!(message.contains("damaged at byte") && message.contains("recording repair"), "{message}");
    }
    let cut = file.with_extension("cut.mcap");
    let output = system.run(&["recording", "cut", text(file), "--out", text(&cut)]);
    assert_eq!((output.status.code(), cut.exists()), (Some(2), false));
}

#[test]
fn a_damaged_chunk_costs_its_second_alone_and_the_loss_is_told() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let (whole, before) = (std::fs::read(&file).expect("of a test"), info(&system, &file));
        let chunks = records(&whole, CHUNK);
        let third = &chunks[2];
        let damaged = with_zeros(&system, "zeros.mcap", &whole, third.start + 100..third.start + 612);
        assert_refused(&system, &damaged);
        let (new, code, message) = repair(&system, &damaged);
        assert_eq!(code, 1, "{message}");
        assert!(message.contains(&format!("byte {}, ", third.start)), "{message}");
        let [missing_s, from_s, to_s] = seconds(&message)[..] else { panic!("{message}") };
        assert!((to_s - from_s - missing_s).abs() < 0.02 && from_s > 1.0, "{message}");
        assert!((0.1..2.5).contains(&missing_s), "{message}");
        let after = info(&system, &new);
        assert_eq!(poses(&before) - poses(&after), poses_of_chunks(&file, &chunks)[2], "{after}");
        assert_eq!((&after["complete"], &after["duration_s"]), (&true.into(), &before["duration_s"]));
        assert!(after["lost"].as_u64() > Some(30) && after["missing"].as_str() > Some("byte"), "{after}");
        let (replay, code) = replayed(&system, &new, &[]);
        assert!(code == 0 && replay["compared"].as_u64() > Some(100), "{replay}");
    });
}

#[test]
fn a_second_that_was_cut_out_is_told_and_one_that_stands_twice_is_taken_once() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let (whole, before) = (std::fs::read(&file).expect("of a test"), info(&system, &file));
        let (chunks, end) = (records(&whole, CHUNK), records(&whole, DATA_END)[0].clone());
        let third = chunks[2].start..chunks[3].start;
        let last = chunks.last().expect("chunks").start..end.start;
        let counts = poses_of_chunks(&file, &chunks);
        for (name, cut, chunk) in [("third", third.clone(), 2), ("last", last, chunks.len() - 1)] {
            let path = system.folder().join(format!("{name}.mcap"));
            std::fs::write(&path, [&whole[..cut.start], &whole[cut.end..]].concat()).expect("of a test");
            assert_refused(&system, &path);
            let (new, code, message) = repair(&system, &path);
            assert!(code == 1 && message.contains("was damaged or cut off, and is not whole"), "{message}");
            let [missing_s, from_s, to_s] = seconds(&message)[..] else { panic!("{message}") };
            assert!((to_s - from_s - missing_s).abs() < 0.02 && missing_s < 2.5, "{message}");
            assert!(message.contains(" of the messages that the summary counts are missing"), "{message}");
            let after = info(&system, &new);
            assert_eq!(poses(&before) - poses(&after), counts[chunk], "{after}");
            assert!(
                after["missing"].as_str().is_some_and(|missing| missing.contains(" s, between ")),
                "{after}"
            );
        }
        let path = system.folder().join("twice.mcap");
        let twice = [&whole[..third.end], &whole[third.clone()], &whole[third.end..]].concat();
        std::fs::write(&path, twice).expect("of a test");
        assert_refused(&system, &path);
        let (new, code, message) = repair(&system, &path);
        assert!(code == 0 && message.contains("a chunk stands twice: nothing of the drive"), "{message}");
        assert_eq!(info(&system, &new)["channels"], before["channels"]);
    });
}

#[test]
fn damage_beside_the_chunks_costs_nothing_and_a_tail_of_zeros_what_it_covers() {
    repeat_when_late(|| {
        let (system, file) = recorded(&SHORT_FREE);
        let (whole, before) = (std::fs::read(&file).expect("of a test"), info(&system, &file));
        let (chunks, end) = (records(&whole, CHUNK), records(&whole, DATA_END)[0].clone());
        let index = records(&whole, MESSAGE_INDEX)[20].clone();
        let places = [
            ("magic", 0..6),
            ("header", 9..20),
            ("index", index.start..index.start + 30),
            ("end", end.clone()),
            ("summary", end.end + 40..end.end + 400),
            ("footer", whole.len() - 30..whole.len()),
        ];
        for (name, place) in places {
            let damaged = with_zeros(&system, &format!("{name}.mcap"), &whole, place);
            assert_refused(&system, &damaged);
            let (new, code, message) = repair(&system, &damaged);
            let after = info(&system, &new);
            assert!(code == 0 && message.contains("nothing of the drive is missing"), "{name}: {message}");
            assert_eq!(after["channels"], before["channels"], "{name}: {message}");
            assert_eq!(replayed(&system, &new, &[]).1, 0, "{name}");
        }
        // The schemas and channels stand in the first chunk.
        let first = with_zeros(&system, "first.mcap", &whole, chunks[0].start + 200..chunks[0].start + 300);
        let (new, code, message) = repair(&system, &first);
        let after = info(&system, &new);
        assert!(code == 1 && message.contains(" s, between 0.00 s and "), "{message}");
        let counts = poses_of_chunks(&file, &chunks);
        assert_eq!(poses(&before) - poses(&after), counts[0], "{after}");
        // A chunk that is damaged tells its own end, but not that of the drive.
        for (name, start) in [("tail", chunks[3].start), ("within", chunks[3].start + 200)] {
            let tail = with_zeros(&system, &format!("{name}.mcap"), &whole, start..whole.len());
            assert_refused(&system, &tail);
            let (new, code, message) = repair(&system, &tail);
            assert!(
                code == 1 && message.contains("what followed ") && seconds(&message)[0] > 2.0,
                "{message}"
            );
            assert_eq!(poses(&info(&system, &new)), counts[..3].iter().sum::<u64>(), "{message}");
        }
        // Nor is the summary there.
        let mut both = std::fs::read(&first).expect("of a test");
        both.truncate(chunks[4].end - 100);
        let cut = system.folder().join("both.mcap");
        std::fs::write(&cut, both).expect("of a test");
        let (new, code, message) = repair(&system, &cut);
        let found = poses(&info(&system, &new));
        assert_eq!((code, found), (1, counts[1..4].iter().sum::<u64>()), "{message}");
    });
}
