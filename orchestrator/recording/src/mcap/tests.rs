//! Files that are whole, cut off, damaged, joined, or made by others.

use std::io::Cursor;

use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::*;

mod effort;
mod within;

fn channel(topic: &str, metadata: Vec<(String, String)>) -> Channel {
    Channel { topic: topic.into(), schema: 1, encoding: "cdr".into(), metadata }
}

fn file() -> Vec<u8> {
    let schema = Schema { name: "s/msg/S".into(), encoding: "ros2msg".into(), text: "uint8 a".into() };
    let channels = [channel("one", vec![]), channel("two", vec![("key".into(), "value".into())])];
    let mut writer = Writer::new(Vec::new(), "test", &[schema], &channels).unwrap();
    writer.attach("a.toml", "application/toml", b"seed = 7\n", 1).unwrap();
    for time in 0..10 {
        writer.message(time as u16 % 2, time, 100 * u64::from(time), &[&[time as u8; 300]]);
        if time % 4 == 3 {
            writer.end_chunk().unwrap();
        }
    }
    writer.metadata("end", &[("lost".into(), "0".into())]).unwrap();
    writer.finish().unwrap().0
}

fn read(bytes: &[u8]) -> (Contents, Vec<(String, u64, usize)>) {
    let mut reader = McapReader::new(Cursor::new(bytes)).unwrap();
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        let (channel, log_ns, length) = (message.channel, message.log_ns, message.data.len());
        messages.push((reader.contents().channels[&channel].topic.clone(), log_ns, length));
    }
    (reader.into_contents(), messages)
}

#[test]
fn what_was_written_is_read() {
    let (contents, messages) = read(&file());
    assert_eq!(messages.len(), 10);
    assert_eq!(messages[..2], [("one".to_owned(), 0, 300), ("one".to_owned(), 200, 300)]);
    assert_eq!(contents.attachments[0].data, b"seed = 7\n");
    assert_eq!(contents.metadata[0].name, "end");
    assert!(contents.is_complete);
}

#[test]
fn chunks_that_were_sealed_elsewhere_are_read() {
    let mut writer = Writer::new(Vec::new(), "test", &[], &[channel("one", vec![])]).unwrap();
    let mut open = OpenChunk::default();
    for time in 1..=3 {
        open.message(0, time, [u64::from(time); 2], &[&[7; 20], &[8; 10]]);
        writer.chunk(&open.seal().unwrap()).unwrap();
    }
    let (contents, messages) = read(&writer.finish().unwrap().0);
    let expected: Vec<_> = (1..=3).map(|time| ("one".to_owned(), time, 30)).collect();
    assert_eq!((messages, contents.chunks, contents.is_complete), (expected, 3, true));
}

#[test]
fn a_file_that_is_cut_off_anywhere_is_readable_up_to_its_last_whole_chunk() {
    let whole = file();
    let mut longest = 0;
    for length in MAGIC.len()..whole.len() {
        let (contents, messages) = read(&whole[..length]);
        assert!(!contents.is_complete, "{length}");
        assert!(messages.len() >= longest && [0, 4, 8, 10].contains(&messages.len()), "{length}");
        longest = messages.len();
    }
    assert_eq!(longest, 10);
}

#[test]
fn a_flipped_bit_in_a_chunk_is_found() {
    let whole = file();
    let chunk = whole.windows(3).position(|bytes| bytes == b"lz4").unwrap();
    for at in (chunk + 16..chunk + 40).step_by(3) {
        let mut flipped = whole.clone();
        flipped[at] ^= 4;
        let mut reader = McapReader::new(Cursor::new(&flipped[..])).unwrap();
        let error = loop {
            match reader.next_message() {
                Ok(Some(_)) => {}
                Ok(None) => panic!("byte {at}: not found"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error, ReadError::Damaged { .. }), "{error}");
    }
}

#[test]
fn another_file_is_refused() {
    assert!(matches!(McapReader::new(Cursor::new(b"#ROSBAG V2.0")), Err(ReadError::Foreign)));
    assert!(matches!(McapReader::new(Cursor::new(b"")), Err(ReadError::Foreign)));
}

/// A file with chunks of one message each, and the bytes in the file between which each chunk lies.
fn many() -> (Vec<u8>, Vec<std::ops::Range<usize>>) {
    let schema = Schema { name: "s/msg/S".into(), encoding: "ros2msg".into(), text: "uint8 a".into() };
    let mut writer = Writer::new(Vec::new(), "test", &[schema], &[channel("one", vec![])]).unwrap();
    let mut chunks = Vec::new();
    writer.attach("a.toml", "application/toml", b"seed = 7\n", 1).unwrap();
    for time in 1..=8 {
        let start = writer.bytes() as usize;
        writer.message(0, time, 1000 * u64::from(time), &[&time.to_le_bytes(), &[time as u8; 60]]);
        writer.end_chunk().unwrap();
        // Without the index of its messages behind it, which is 31 bytes long.
        chunks.push(start..writer.bytes() as usize - 31);
    }
    writer.metadata("end", &[("lost".into(), "0".into())]).unwrap();
    (writer.finish().unwrap().0, chunks)
}

/// Times of the messages that are left [ns], the damaged places, and how many messages are missing.
type Salvaged = (Vec<u64>, Vec<Gap>, Option<u64>);

/// Reads a damaged file, with the channels that all files of these tests have.
fn salvage(bytes: &[u8]) -> Result<Salvaged, ReadError> {
    let schema = Schema { name: "s/msg/S".into(), encoding: "ros2msg".into(), text: "uint8 a".into() };
    let mut reader = McapReader::salvage(Cursor::new(bytes))?;
    reader.assume(&[schema], &[channel("one", vec![])]);
    let mut times = Vec::new();
    while let Some(message) = reader.next_message()? {
        assert_eq!(message.data[..4], (message.log_ns as u32 / 1000).to_le_bytes());
        times.push(message.log_ns);
    }
    Ok((times, reader.gaps().to_vec(), reader.missing(0..reader.files().len(), |_| true)))
}

/// Reads a file until its end, or until it is refused; true when nothing was wrong.
fn is_whole(bytes: &[u8]) -> bool {
    let Ok(mut reader) = McapReader::new(Cursor::new(bytes)) else { return false };
    loop {
        match reader.next_message() {
            Ok(Some(_)) => {}
            Ok(None) => return reader.files().iter().all(|contents| contents.is_complete),
            Err(_) => return false,
        }
    }
}

/// Bytes of the file that a test damages, in the order of a random walk that is always the same.
fn places(bytes: usize, number: usize) -> impl Iterator<Item = usize> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    (0..number).map(move |_| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % bytes
    })
}

#[test]
fn damage_anywhere_loses_no_chunk_that_is_intact() {
    let (whole, chunks) = many();
    let flips = (0..whole.len()).flat_map(|at| [0, 3, 7].map(|bit| (at, 1, Some(1_u8 << bit))));
    let zeros = (0..whole.len()).step_by(3).flat_map(|at| [5, 64, 512].map(|length| (at, length, None)));
    for (at, length, bit) in flips.chain(zeros) {
        let mut damaged = whole.clone();
        let hit = at..(at + length).min(whole.len());
        for byte in &mut damaged[hit.clone()] {
            *byte = bit.map_or(0, |bit| *byte ^ bit);
        }
        if damaged == whole {
            continue;
        }
        let intact = (1..).zip(&chunks).filter(|(_, chunk)| chunk.end <= hit.start || chunk.start >= hit.end);
        let intact: Vec<u64> = intact.map(|(number, _)| 1000 * number).collect();
        let found = salvage(&damaged);
        let (times, gaps, missing) = match found {
            Ok(found) => found,
            Err(error) => {
                assert!(intact.is_empty(), "{hit:?} {bit:?}: {error}");
                continue;
            }
        };
        assert!(intact.iter().all(|time| times.contains(time)), "{hit:?} {bit:?}: {times:?} {gaps:?}");
        assert!(times.is_sorted() && times.len() <= 8, "{hit:?}: {times:?}");
        assert!(times.len() == 8 || !gaps.is_empty(), "{hit:?} {bit:?}: {times:?}");
        assert!(missing.is_none_or(|missing| missing == 8 - times.len() as u64), "{hit:?}");
        if times.len() < 8 {
            assert!(!is_whole(&damaged), "{hit:?} {bit:?}");
        }
    }
}

#[test]
fn two_damaged_places_lose_two_chunks_and_both_are_told_with_their_times() {
    let (mut bytes, chunks) = many();
    for chunk in [&chunks[2], &chunks[5]] {
        bytes[chunk.start + 60..chunk.end].fill(0);
    }
    let (times, gaps, missing) = salvage(&bytes).unwrap();
    assert_eq!((times, missing), (vec![1000, 2000, 4000, 5000, 7000, 8000], Some(2)));
    let of = |gap: &Gap| (gap.at as usize, gap.from_ns, gap.to_ns);
    let expected = [(chunks[2].start, 2000, 4000), (chunks[5].start, 5000, 7000)];
    let expected = expected.map(|(at, from, to)| (at, Some(from), Some(to)));
    assert_eq!(gaps.iter().map(of).collect::<Vec<_>>(), expected);
}

#[test]
fn pairs_of_damaged_places_and_cuts_lose_no_intact_chunk() {
    let (whole, chunks) = many();
    let mut walk = places(whole.len(), 6000);
    while let (Some(one), Some(other), Some(end)) = (walk.next(), walk.next(), walk.next()) {
        let mut damaged = whole.clone();
        for at in [one, other] {
            let last = (at + 40).min(whole.len());
            damaged[at..last].fill(0);
        }
        damaged.truncate(end.max(8));
        let hits = [one..one + 40, other..other + 40, end..usize::MAX];
        let is_hit = |chunk: &std::ops::Range<usize>| {
            hits.iter().any(|hit| chunk.end > hit.start && chunk.start < hit.end)
        };
        let Ok((times, ..)) = salvage(&damaged) else {
            assert!(chunks.iter().all(&is_hit), "{one} {other} {end}");
            continue;
        };
        for (number, chunk) in (1..).zip(&chunks) {
            assert!(is_hit(chunk) || times.contains(&(1000 * number)), "{one} {other} {end}: {times:?}");
        }
    }
}

#[test]
fn the_largest_number_at_any_place_is_read_and_as_a_length_costs_one_chunk() {
    let (whole, chunks) = many();
    for at in MAGIC.len()..whole.len() - 8 {
        let mut damaged = whole.clone();
        damaged[at..at + 8].fill(255);
        assert!(salvage(&damaged).unwrap().0.len() >= 6, "{at}");
        let _ = is_whole(&damaged);
    }
    // The length of the compressed records of a chunk.
    let stored = chunks[2].start + 9 + 28 + 4 + "lz4".len();
    let mut damaged = whole;
    damaged[stored..stored + 8].fill(255);
    let (times, gaps, missing) = salvage(&damaged).unwrap();
    assert_eq!((times.len(), gaps.len(), missing), (7, 1, Some(1)));
    assert!(!is_whole(&damaged));
}

#[test]
fn a_length_that_no_record_has_is_damage_and_no_cut() {
    for opcode in [opcode::CHUNK, opcode::CHANNEL, opcode::ATTACHMENT] {
        let mut bytes = begun();
        let at = bytes.len();
        bytes.push(opcode);
        bytes.u64(u64::MAX);
        let message = McapReader::new(Cursor::new(&bytes)).unwrap_err().to_string();
        assert!(message.starts_with(&format!("damaged at byte {at}")), "{message}");
    }
}

#[test]
fn counts_of_joined_summaries_end_at_the_largest_number() {
    let one = [handmade::channel(1, 0, "/a"), handmade::message(1, 7, b"a")].concat();
    let one = [begun(), one, handmade::counted_end(u64::MAX, 0, [7; 2])].concat();
    let mut reader = McapReader::salvage(Cursor::new(one.repeat(2))).unwrap();
    while reader.next_message().unwrap().is_some() {}
    assert_eq!(reader.missing(0..2, |_| true), Some(u64::MAX));
}

#[test]
fn joined_files_are_read_one_after_the_other_and_a_damaged_joint_costs_nothing() {
    let one = file();
    let joined = [&one[..], &many().0].concat();
    let mut reader = McapReader::new(Cursor::new(&joined)).unwrap();
    let mut counts = [0, 0];
    while reader.next_message().unwrap().is_some() {
        counts[reader.file()] += 1;
    }
    assert_eq!((counts, reader.files().len()), ([10, 8], 2));
    let mut damaged = joined;
    damaged[one.len() - 4..one.len() + 4].fill(0);
    assert!(!is_whole(&damaged));
    let mut reader = McapReader::salvage(Cursor::new(&damaged)).unwrap();
    let mut messages = 0;
    while reader.next_message().unwrap().is_some() {
        messages += 1;
    }
    assert_eq!(messages, 18);
}

#[test]
fn what_follows_a_file_is_told_and_a_repair_finds_nothing_missing() {
    let (mut bytes, _) = many();
    bytes.extend([0; 700]);
    assert!(!is_whole(&bytes));
    let (times, gaps, missing) = salvage(&bytes).unwrap();
    assert_eq!((times.len(), gaps.len(), missing), (8, 1, Some(0)));
}

/// The start of a file of another program.
fn begun() -> Vec<u8> {
    let (mut bytes, mut header) = (MAGIC.to_vec(), Vec::new());
    header.text("").text("other");
    append(&mut bytes, opcode::HEADER, &header);
    bytes
}

fn append_chunk(bytes: &mut Vec<u8>, length: u64, compression: &str, stored: &[u8]) {
    let mut body = Vec::new();
    body.u64(1).u64(1).u64(length).u32(0).text(compression).u64(stored.len() as u64).extend(stored);
    append(bytes, opcode::CHUNK, &body);
}

/// A file of one chunk with this content and header.
fn chunk(length: u64, compression: &str, stored: &[u8]) -> Vec<u8> {
    let mut bytes = begun();
    append_chunk(&mut bytes, length, compression, stored);
    bytes
}

fn refused(bytes: &[u8]) -> String {
    let read = McapReader::new(Cursor::new(bytes)).and_then(|mut reader| reader.next_message().map(|_| ()));
    read.unwrap_err().to_string()
}

#[test]
fn what_is_not_supported_or_too_large_is_named_with_the_numbers() {
    let message = refused(&chunk(9, "br", &[0; 9]));
    assert_eq!(message, "not supported, at byte 30: compression br; lz4, zstd and none are");
    let message = refused(&chunk(1 << 30, "lz4", &[0; 9]));
    assert_eq!(message, "at byte 30: a chunk of 1073741824 bytes, 67108864 are allowed");
    assert!(refused(&chunk(9, "zstd", b"no zstd!")).contains("can't be decompressed"));
    let mut attached = Vec::new();
    append(&mut attached, opcode::ATTACHMENT, &[0; 60]);
    let message = refused(&chunk(attached.len() as u64, "", &attached));
    assert_eq!(message, "damaged at byte 30: a record stands where it does not belong");
    assert!(McapReader::salvage(Cursor::new(chunk(9, "br", &[0; 9]))).is_ok());
    let salvaged =
        McapReader::salvage(Cursor::new(chunk(9, "br", &[0; 9]))).unwrap().next_message().map(|_| ());
    assert!(salvaged.unwrap_err().to_string().contains("compression br"));
}

/// The messages of a file: topic, encoding, times and content.
fn messages(bytes: &[u8]) -> Vec<(String, String, [u64; 2], Vec<u8>)> {
    let (mut reader, mut found) = (McapReader::new(Cursor::new(bytes)).unwrap(), Vec::new());
    while let Some(message) = reader.next_message().unwrap() {
        let (channel, data) = (message.channel, message.data.to_vec());
        let times_ns = [message.log_ns, message.publish_ns];
        let Channel { topic, encoding, .. } = reader.contents().channels[&channel].clone();
        found.push((topic, encoding, times_ns, data));
    }
    assert!(reader.contents().is_complete);
    found
}

#[test]
fn a_channel_with_a_lower_number_may_be_defined_later_and_is_copied_right() {
    let path = |name: &str| std::env::temp_dir().join(format!("scanloop-{name}-{}", std::process::id()));
    let [from, to] = ["lower", "copied"].map(path);
    for in_chunks in [true, false] {
        let mut bytes = begun();
        for (number, topic, encoding) in [(5_u16, "late", "json"), (2, "early", "cdr")] {
            let (mut records, mut body) = (Vec::new(), Vec::new());
            body.u16(number).u16(0).text(topic).text(encoding).map(&[]);
            append(&mut records, opcode::CHANNEL, &body);
            body.clear();
            body.u16(number).u32(1).u64(7).u64(8).extend(topic.bytes());
            append(&mut records, opcode::MESSAGE, &body);
            match in_chunks {
                true => append_chunk(&mut bytes, records.len() as u64, "", &records),
                false => bytes.extend(records),
            }
        }
        append(&mut bytes, opcode::DATA_END, &[0; 4]);
        append(&mut bytes, opcode::FOOTER, &[0; 20]);
        bytes.extend(MAGIC);
        let of = |topic: &str, encoding: &str| {
            (topic.to_owned(), encoding.to_owned(), [7, 8], topic.as_bytes().to_vec())
        };
        let expected = [of("late", "json"), of("early", "cdr")];
        assert_eq!(messages(&bytes), expected);
        std::fs::write(&from, &bytes).unwrap();
        crate::copy::copy(&from, &to, true, 0..=u64::MAX).unwrap();
        let mut copied = messages(&std::fs::read(&to).unwrap());
        copied.sort();
        assert_eq!(copied, [of("early", "cdr"), of("late", "json")]);
    }
    [from, to].iter().for_each(|path| std::fs::remove_file(path).unwrap());
}

#[test]
fn a_chunk_in_zstd_is_read_and_one_that_unpacks_to_more_than_it_says_is_refused() {
    let mut content = Vec::new();
    append(&mut content, opcode::CHANNEL, &{
        let mut body = Vec::new();
        body.u16(1).u16(0).text("one").text("cdr").map(&[]);
        body
    });
    let mut body = Vec::new();
    body.u16(1).u32(1).u64(7).u64(7).extend([9; 5000]);
    append(&mut content, opcode::MESSAGE, &body);
    let stored = compress_to_vec(&content[..], CompressionLevel::Fastest);
    let bytes = chunk(content.len() as u64, "zstd", &stored);
    let mut reader = McapReader::new(Cursor::new(&bytes)).unwrap();
    let message = reader.next_message().unwrap().unwrap();
    assert_eq!((message.log_ns, message.data), (7, &[9; 5000][..]));
    for wrong in [content.len() as u64 - 1, content.len() as u64 + 1] {
        assert!(refused(&chunk(wrong, "zstd", &stored)).contains("can't be decompressed"));
    }
}
