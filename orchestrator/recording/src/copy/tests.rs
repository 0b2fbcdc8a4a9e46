//! Files that are repaired and cut: what is kept, and what is told to be missing.

use std::ops::Range;

use console::new_file::Scratch;

use super::*;
use crate::export::export;
use crate::mcap::handmade::{attachment, begun, channel, chunk, counted_end, end, message, schema};
use crate::mcap::{Channel, MAX_CHUNK, Writer};

/// A second [ns].
const SECOND: u64 = 1_000_000_000;

/// A file of `seconds` chunks with ten messages each, and where in the file each chunk lies with its index.
fn seconds(seconds: u64) -> (Vec<u8>, Vec<Range<usize>>) {
    let topic = Channel { topic: "/a".into(), schema: 0, encoding: "cdr".into(), metadata: vec![] };
    let mut writer = Writer::new(Vec::new(), "test", &[], &[topic]).unwrap();
    let mut chunks = Vec::new();
    writer.attach("a.toml", "application/toml", b"seed = 7\n", 1).unwrap();
    for second in 0..seconds {
        let start = writer.bytes() as usize;
        for tenth in 0..10 {
            let number = (10 * second + tenth) as u32;
            // A chunk begins with a message that is older than the last one of the chunk before.
            let late_ns = if tenth == 0 && second > 0 { SECOND / 5 } else { 0 };
            let log_ns = (10 * second + tenth) * SECOND / 10 - late_ns;
            writer.message(0, number, 5 * SECOND + log_ns, &[&number.to_le_bytes()]);
        }
        writer.end_chunk().unwrap();
        chunks.push(start..writer.bytes() as usize);
    }
    writer.metadata("end", &[("lost".into(), "0".into())]).unwrap();
    (writer.finish().unwrap().0, chunks)
}

/// A file of another program without chunks.
fn loose(times: Range<u64>) -> Vec<u8> {
    let messages: Vec<u8> = times.flat_map(|time| message(3, time * SECOND, b"loose")).collect();
    [begun("other"), channel(3, 0, "/b"), messages, end()].concat()
}

/// Files of a test, in a folder of its own.
struct Files(Scratch);

impl Files {
    fn new() -> Self {
        Self(Scratch::new().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn input(&self, content: &[u8]) -> PathBuf {
        let path = self.path("input.mcap");
        std::fs::write(&path, content).unwrap();
        path
    }

    fn repair(&self, content: &[u8]) -> Copied {
        repair(&self.input(content), &self.path("repaired.mcap"), true).unwrap()
    }

    fn names(&self) -> Vec<String> {
        let name =
            |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<String> = std::fs::read_dir(self.0.path()).unwrap().map(name).collect();
        names.sort();
        names
    }
}

/// Reads a whole file; returns its messages: topic, and log time [ns].
fn read(path: &Path) -> Vec<(String, u64)> {
    let (mut reader, mut found) = (open(path).unwrap(), Vec::new());
    while let Some((channel, log_ns)) =
        reader.next_message().unwrap().map(|found| (found.channel, found.log_ns))
    {
        found.push((reader.contents().channels[&channel].topic.clone(), log_ns));
    }
    assert!(reader.files().iter().all(|contents| contents.is_complete));
    found
}

fn told(copied: &Copied) -> String {
    copied.gaps.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_file_without_chunks_that_was_joined_behind_one_with_chunks_is_kept() {
    let (files, chunked) = (Files::new(), seconds(2).0);
    let copied = files.repair(&[&chunked[..], &loose(1..5)].concat());
    assert_eq!((copied.messages, copied.is_loss), (24, false), "{}", told(&copied));
    let messages: usize = copied.files.iter().map(|file| read(file).len()).sum();
    assert_eq!(messages, 24);
    // Also when the bytes of the joint are damaged.
    let mut damaged = [&chunked[..], &loose(1..5)].concat();
    damaged[chunked.len()..chunked.len() + 8].fill(0);
    assert_eq!(files.repair(&damaged).messages, 24);
    // What is lost of the second file, which counts nothing, is a loss.
    let mut damaged = [&chunked[..], &loose(1..2)].concat();
    let at = chunked.len() + loose(1..1).len() - end().len();
    damaged[at..at + 9].fill(0);
    let copied = files.repair(&damaged);
    assert_eq!((copied.messages, copied.is_loss), (20, true), "{}", told(&copied));
}

#[test]
fn messages_beside_chunks_are_kept_and_an_index_or_a_channel_with_a_damaged_first_byte_is_none() {
    let files = Files::new();
    let content = [channel(1, 0, "/a"), message(1, SECOND, b"packed")].concat();
    let packed = chunk(&content, "zstd", [SECOND; 2]);
    let beside =
        [channel(3, 0, "/b"), message(3, 2 * SECOND, b"loose"), message(3, 3 * SECOND, b"loose")].concat();
    let copied = files.repair(&[begun("other"), packed.clone(), beside, packed, end()].concat());
    assert_eq!((copied.messages, copied.is_loss), (4, false), "{}", told(&copied));
    let times: Vec<u64> = read(&copied.files[0]).iter().map(|(_, log_ns)| log_ns / SECOND).collect();
    assert_eq!(times.iter().sum::<u64>(), 7);
    let (whole, chunks) = seconds(3);
    let index = chunks[1].end - (9 + 6 + 160);
    assert_eq!(whole[index], 7);
    let named = whole.windows(2).rposition(|bytes| bytes == b"/a").unwrap() - 17;
    assert_eq!(whole[named], 4);
    for at in [index, named] {
        let mut damaged = whole.clone();
        damaged[at] = 5;
        let copied = files.repair(&damaged);
        assert_eq!((copied.messages, copied.is_loss), (30, false), "{at}: {}", told(&copied));
    }
}

#[test]
fn chunks_that_were_cut_out_are_told_with_their_messages_and_seconds() {
    let (files, (whole, chunks)) = (Files::new(), seconds(6));
    let without = |range: Range<usize>| [&whole[..range.start], &whole[range.end..]].concat();
    for (cut, messages, times) in [
        (2..3, 10, "between 1.80 s and 2.90 s"),
        (2..4, 20, "between 1.80 s and 3.90 s"),
        (0..1, 10, "between 0.00 s and 0.90 s"),
        (5..6, 10, "between 4.80 s and 5.90 s"),
    ] {
        let copied = files.repair(&without(chunks[cut.start].start..chunks[cut.end - 1].end));
        assert!(copied.is_loss && copied.messages == 60 - messages, "{cut:?}: {copied:?}");
        assert!(told(&copied).contains(times) && copied.gaps.len() == 1, "{cut:?}: {}", told(&copied));
        assert_eq!(copied.missing_messages, Some(messages));
        assert!(read(&copied.files[0]).len() as u64 == 60 - messages);
    }
    // The last one and the text behind it.
    let data_end = whole.len() - seconds_end(&whole);
    let copied = files.repair(&without(chunks[5].start..data_end));
    assert_eq!((copied.is_loss, copied.missing_attachments), (true, Some(1)), "{}", told(&copied));
}

/// Length of a file from the end of its data on.
fn seconds_end(whole: &[u8]) -> usize {
    let end = [&[15][..], &4_u64.to_le_bytes(), &[0; 4]].concat();
    whole.len() - whole.windows(end.len()).rposition(|bytes| bytes == end).unwrap()
}

#[test]
fn a_summary_that_counts_more_is_a_loss_also_where_it_names_no_chunk() {
    let files = Files::new();
    let one = |time: u64| {
        chunk(&[channel(1, 0, "/a"), message(1, time * SECOND, b"a")].concat(), "", [time * SECOND; 2])
    };
    let of = |times: [u64; 2], counted: u64| {
        let end = counted_end(counted, 0, [SECOND, 9 * SECOND]);
        files.repair(&[begun("other"), one(times[0]), one(times[1]), end].concat())
    };
    let whole = of([1, 9], 2);
    assert!(!whole.is_loss && whole.gaps.is_empty(), "{}", told(&whole));
    for (times, text) in [
        ([1, 7], "between 6.00 s and 8.00 s"),
        ([3, 9], "between 0.00 s and 2.00 s"),
        ([1, 9], "at a time that is not known"),
    ] {
        let copied = of(times, 3);
        assert!(copied.is_loss && copied.missing_messages == Some(1), "{}", told(&copied));
        assert!(told(&copied).contains(text), "{}", told(&copied));
    }
    let more = of([1, 9], 1);
    assert!(!more.is_loss && told(&more).ends_with("nothing of the drive"), "{}", told(&more));
}

#[test]
fn a_chunk_that_stands_twice_is_taken_once() {
    let (files, (whole, chunks)) = (Files::new(), seconds(6));
    let twice = [&whole[..chunks[4].end], &whole[chunks[4].clone()], &whole[chunks[4].end..]].concat();
    let copied = files.repair(&twice);
    assert_eq!((copied.messages, copied.is_loss, copied.gaps.len()), (60, false, 1), "{}", told(&copied));
    // One that was put in the place of another.
    let instead = [&whole[..chunks[3].end], &whole[chunks[3].clone()], &whole[chunks[4].end..]].concat();
    let copied = files.repair(&instead);
    assert_eq!(
        (copied.messages, copied.is_loss, copied.missing_messages),
        (50, true, Some(10)),
        "{}",
        told(&copied)
    );
}

#[test]
fn an_attached_file_that_cannot_be_read_is_a_loss() {
    let (files, (mut whole, _)) = (Files::new(), seconds(3));
    let at = whole.windows(4).position(|bytes| bytes == b"seed").unwrap();
    whole[at] ^= 1;
    let copied = files.repair(&whole);
    assert_eq!(
        (copied.messages, copied.missing_attachments, copied.is_loss),
        (30, Some(1), true),
        "{}",
        told(&copied)
    );
}

#[test]
fn no_time_that_is_missing_is_negative() {
    let (files, (whole, chunks)) = (Files::new(), seconds(5));
    let index = chunks[1].end - 175;
    let mut zeroed = whole.clone();
    zeroed[index..index + 64].fill(0);
    let mut junk = whole.clone();
    junk.splice(chunks[2].start..chunks[2].start, [0xa5; 777]);
    for damaged in [zeroed, junk] {
        let copied = files.repair(&damaged);
        assert_eq!((copied.messages, copied.is_loss, copied.gaps.len()), (50, false, 1), "{}", told(&copied));
        assert!(told(&copied).ends_with("nothing of the drive"), "{}", told(&copied));
        // Without the summary it is not known whether something was there.
        let copied = files.repair(&damaged[..damaged.len() - seconds_end(&whole)]);
        assert!(copied.is_loss && !told(&copied).contains('-'), "{}", told(&copied));
        assert!(told(&copied).contains("up to 0.00 s, between "), "{}", told(&copied));
    }
}

#[test]
fn what_is_repaired_or_cut_is_within_the_limits_of_a_file() {
    let files = Files::new();
    // Two messages that fill a chunk each, without the definitions; the noise does not become smaller by compression.
    let mut noise = vec![0_u8; MAX_CHUNK as usize - 40];
    noise.iter_mut().fold(1_u32, |state, byte| {
        *byte = (state >> 24) as u8;
        state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
    });
    let large = chunk(&message(1, SECOND, &noise), "", [SECOND; 2]);
    let small = chunk(&message(1, SECOND, b"small"), "", [SECOND; 2]);
    let input = [begun("other"), channel(1, 0, "/a"), small, large.clone(), large, end()].concat();
    assert_eq!(read(&files.repair(&input).files[0]).len(), 3);
    let cut = copy(&files.input(&input), &files.path("cut.mcap"), true, 0..=u64::MAX).unwrap();
    assert_eq!(read(&cut.files[0]).len(), 3);
    // A text that is too long for a record of its own, as which the summary repeats it.
    let long = [schema(1, &"\n".repeat(5 << 20)), channel(1, 1, "/a"), message(1, SECOND, b"a")].concat();
    let input = files.input(&[begun("other"), chunk(&long, "zstd", [SECOND; 2]), end()].concat());
    for result in [
        copy(&input, &files.path("long.mcap"), true, 0..=u64::MAX),
        repair(&input, &files.path("long.mcap"), true),
    ] {
        let message = result.unwrap_err().to_string();
        assert!(message.contains("4194304 are allowed"), "{message}");
    }
}

#[test]
fn names_of_attached_files_are_counted() {
    let files = Files::new();
    let one = chunk(&[channel(1, 0, "/a"), message(1, SECOND, b"a")].concat(), "", [SECOND; 2]);
    let refused = |attached: Vec<u8>| {
        let input = files.input(&[begun("other"), attached, one.clone(), end()].concat());
        copy(&input, &files.path("cut.mcap"), true, 0..=u64::MAX).unwrap_err().to_string()
    };
    let message = refused(attachment(&"n".repeat(5 << 20), b""));
    assert!(message.contains("4194304 are allowed"), "{message}");
    let message = refused(attachment(&"n".repeat(3 << 20), b"").repeat(45));
    assert!(message.contains("134217728 are allowed"), "{message}");
}

#[test]
fn topics_of_other_programs_are_named_by_an_export_as_tables() {
    let files = Files::new();
    let sample = [&crate::schema::ENCAPSULATION[..], &vec![0; shared_types::Topic::Pose.size()]].concat();
    let definitions =
        [channel(1, 0, "/imu"), channel(2, 0, "/scanloop/pose"), channel(4, 0, "/foxglove/scan")];
    let messages = [message(1, SECOND, b"imu"), message(2, SECOND, &sample), message(4, SECOND, b"drawn")];
    let content = [definitions.concat(), messages.concat()].concat();
    let input = files.input(&[begun("other"), chunk(&content, "", [SECOND; 2]), end()].concat());
    let exported = export(&input, Some(&files.path("tables")), None, false).unwrap().0.unwrap();
    assert_eq!((exported.rows, exported.left_out), (1, vec!["/imu".to_owned()]));
    let text = crate::info::Info::read(&input).unwrap().to_string();
    assert!(text.contains("\nno recording of a drive\nlost samples are not known\n"), "{text}");
}

#[test]
fn of_several_new_files_none_is_there_when_one_is_refused() {
    let files = Files::new();
    let (new, second) = (files.path("new.mcap"), files.path("new-2.mcap"));
    let joined = [seconds(2).0, loose(1..5)].concat();
    let run = |text: &str, file: Vec<u8>| {
        let body = [("run_id".to_owned(), text.to_owned())];
        let mut writer = Writer::empty(Vec::new(), "", text).unwrap();
        writer.metadata(RECORDING, &body).unwrap();
        let number = writer.add_channel(&Channel {
            topic: "/a".into(),
            schema: 0,
            encoding: "cdr".into(),
            metadata: vec![],
        });
        writer.message_of(number, 1, [SECOND; 2], b"a");
        [writer.finish().unwrap().0, file].concat()
    };
    let joined = [run("one", run("two", vec![])), joined].concat();
    // The second new file is there already, as a file of its own or as the input.
    let input = files.input(&joined);
    std::fs::write(&second, "own").unwrap();
    assert!(repair(&input, &new, false).is_err());
    assert_eq!(files.names(), ["input.mcap", "new-2.mcap"]);
    std::fs::write(&new, "old").unwrap();
    std::fs::rename(&input, &second).unwrap();
    for refused in [repair(&second, &new, true), copy(&second, &new, true, 0..=u64::MAX)] {
        assert!(refused.unwrap_err().to_string().contains("the same file as the input"));
        assert_eq!(
            (files.names(), std::fs::read(&new).unwrap()),
            (vec!["new-2.mcap".into(), "new.mcap".into()], b"old".to_vec())
        );
    }
    let bag = files.path("bag");
    std::fs::create_dir(&bag).unwrap();
    std::fs::write(bag.join("recording-2.mcap"), "own").unwrap();
    // Nor of two exports.
    let tables = files.path("tables");
    assert!(export(&second, Some(&tables), Some(&bag), false).is_err());
    let count = |folder: &Path| std::fs::read_dir(folder).unwrap().count();
    assert_eq!((count(&bag), count(&tables)), (1, 0));
    std::fs::remove_file(bag.join("recording-2.mcap")).unwrap();
    assert_eq!(export(&second, None, Some(&bag), false).unwrap().1, Some(26));
    assert!(std::fs::read_to_string(bag.join("metadata.yaml")).unwrap().contains("message_count: 26"));
}
