//! Damage within a chunk, and records that stand where they do not belong.

use std::io::Cursor;

use super::super::handmade::{attachment, begun, channel, chunk, counted_end, end, message};
use super::super::{Damage, McapReader, ReadError, append};

fn messages(times_ns: std::ops::Range<u64>) -> Vec<u8> {
    times_ns.flat_map(|time_ns| message(1, time_ns, &[7; 50])).collect()
}

/// Number of messages that a repair finds, and what it tells: what is wrong, whether messages may be missing, and between which
/// times [ns].
type Told = (usize, Vec<(Damage, bool, [Option<u64>; 2])>);

fn salvaged(bytes: &[u8]) -> Told {
    let mut reader = McapReader::salvage(Cursor::new(bytes)).unwrap();
    let mut count = 0;
    while reader.next_message().unwrap().is_some() {
        count += 1;
    }
    let told = reader.gaps().iter().map(|gap| (gap.what, gap.is_data, [gap.from_ns, gap.to_ns]));
    (count, told.collect())
}

fn read(bytes: &[u8]) -> Result<usize, ReadError> {
    let mut reader = McapReader::new(Cursor::new(bytes))?;
    let mut count = 0;
    while reader.next_message()?.is_some() {
        count += 1;
    }
    Ok(count)
}

#[test]
fn whole_messages_of_a_chunk_are_kept_whatever_stands_between_them() {
    let content = [channel(1, 0, "/a"), messages(1..4), vec![0; 40], messages(4..6)].concat();
    let file = [begun("x"), chunk(&content, "", [1, 5]), end()].concat();
    assert!(read(&file).is_err());
    assert_eq!(salvaged(&file), (5, vec![(Damage::Misplaced, true, [None, Some(5)])]));
    let content = [channel(1, 0, "/a"), messages(1..4), message(1, 4, b"")[..20].to_vec()].concat();
    let file = [begun("x"), chunk(&content, "zstd", [1, 4]), end()].concat();
    assert_eq!(salvaged(&file), (3, vec![(Damage::Short, true, [None, Some(3)])]));
}

#[test]
fn what_is_there_of_a_chunk_that_was_cut_off_is_kept() {
    let first = [channel(1, 0, "/a"), messages(1..11)].concat();
    let file = [begun("x"), chunk(&first, "zstd", [1, 10]), chunk(&messages(11..31), "", [11, 30])].concat();
    let record = message(1, 0, &[7; 50]).len();
    for left in 1..20 {
        let cut = &file[..file.len() - record * left - 5];
        assert_eq!(read(cut).unwrap(), 10, "up to the last whole chunk");
        let found = 29 - left as u64;
        assert_eq!(salvaged(cut), (found as usize, vec![(Damage::CutOff, true, [Some(found), None])]));
    }
    let only = [begun("x"), chunk(&first, "", [1, 10])].concat();
    let found = salvaged(&only[..only.len() - 1]);
    assert_eq!(found, (9, vec![(Damage::CutOff, true, [Some(9), None])]));
}

#[test]
fn records_that_do_not_belong_where_they_stand_are_told_and_those_of_other_programs_are_not() {
    let begun = [begun("x"), channel(1, 0, "/a")].concat();
    let mut private = Vec::new();
    append(&mut private, 0x90, b"other");
    let file = [&begun[..], &chunk(&[messages(1..3), private].concat(), "", [1, 2]), &end()].concat();
    assert_eq!((read(&file).unwrap(), salvaged(&file)), (2, (2, vec![])));
    let attached = chunk(&[messages(1..3), attachment("a", b"b")].concat(), "", [1, 2]);
    let renamed = chunk(&[channel(1, 0, "/b"), messages(1..3)].concat(), "", [1, 2]);
    let data_end = end()[..13].to_vec();
    let late = [data_end.clone(), chunk(&messages(1..3), "", [1, 2])].concat();
    let twice = [chunk(&messages(1..3), "", [1, 2]), data_end].concat();
    for (records, may_be) in [(attached, true), (renamed, false), (late, false), (twice, false)] {
        let file = [&begun[..], &records, &end()].concat();
        assert!(matches!(read(&file), Err(ReadError::Damaged { what: Damage::Misplaced, .. })));
        let (count, told) = salvaged(&file);
        assert_eq!((count, told.len()), (2, 1));
        assert_eq!((told[0].0, told[0].1), (Damage::Misplaced, may_be));
    }
}

#[test]
fn zeros_behind_a_whole_file_are_no_loss_and_an_attached_file_that_is_not_there_is_one() {
    let file = [begun("x"), channel(1, 0, "/a"), messages(1..3), end(), vec![0; 700]].concat();
    let (count, told) = salvaged(&file);
    assert_eq!((count, told.iter().any(|(_, is_data, _)| *is_data)), (2, false));
    let file = [begun("x"), channel(1, 0, "/a"), messages(1..3), counted_end(2, 1, [1, 2])].concat();
    assert!(matches!(read(&file), Err(ReadError::Damaged { what: Damage::Attached, .. })));
}

#[test]
fn a_chunk_whose_first_byte_is_damaged_is_refused_and_a_repair_keeps_it() {
    let begun = [begun("x"), channel(1, 0, "/a")].concat();
    let whole =
        [&begun[..], &chunk(&messages(1..3), "zstd", [0, 2]), &chunk(&messages(3..5), "", [3, 4]), &end()];
    let whole = whole.concat();
    for opcode in (0..=255).filter(|opcode| *opcode != whole[begun.len()]) {
        let mut file = whole.clone();
        file[begun.len()] = opcode;
        assert!(read(&file).is_err(), "{opcode}");
        let (count, told) = salvaged(&file);
        assert_eq!((count, told.len()), (4, 1), "{opcode}");
        assert_eq!((told[0].0, told[0].1), (Damage::Opcode, false), "{opcode}");
    }
}
