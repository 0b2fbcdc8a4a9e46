//! Damaged streams: no panic, bounded memory, and nothing but the damaged replies is lost.

use proptest::prelude::*;
use urg::{Completed, MAX_RANGES, Parser};

const REPLIES: &[u8] = include_bytes!("data/scip-urglib-tcp.s2c.bin");
/// Number of scans in the recording.
const SCANS: usize = 12;

/// One change of a stream.
#[derive(Debug, Clone)]
enum Change {
    Replace(usize, u8),
    Delete(usize, usize),
    Insert(usize, Vec<u8>),
    Repeat(usize, usize),
}

fn change() -> impl Strategy<Value = Change> {
    let at = || 0..REPLIES.len();
    prop_oneof![
        (at(), any::<u8>()).prop_map(|(at, byte)| Change::Replace(at, byte)),
        (at(), 1..3000_usize).prop_map(|(at, count)| Change::Delete(at, count)),
        (at(), prop::collection::vec(any::<u8>(), 1..300)).prop_map(|(at, bytes)| Change::Insert(at, bytes)),
        (at(), 1..3000_usize).prop_map(|(at, count)| Change::Repeat(at, count)),
    ]
}

fn apply(stream: &mut Vec<u8>, change: Change) {
    let within = |at: usize, count: usize| at.min(stream.len())..at.saturating_add(count).min(stream.len());
    match change {
        Change::Replace(at, byte) => {
            if let Some(place) = stream.get_mut(at) {
                *place = byte;
            }
        }
        Change::Delete(at, count) => drop(stream.drain(within(at, count))),
        Change::Insert(at, bytes) => drop(stream.splice(within(at, 0), bytes)),
        Change::Repeat(at, count) => {
            let range = within(at, count);
            let copy = stream[range.clone()].to_vec();
            drop(stream.splice(range.start..range.start, copy));
        }
    }
}

fn intact() -> Vec<Vec<u32>> {
    scans(REPLIES).0
}

/// Ranges of the scans of a stream, and the number of dropped replies.
fn scans(stream: &[u8]) -> (Vec<Vec<u32>>, usize) {
    let mut parser = Parser::default();
    let (mut scans, mut dropped) = (Vec::new(), 0);
    for byte in stream {
        match parser.push(*byte) {
            Some(Completed::Scan) => {
                let measurement = parser.measurement().expect("a scan has a measurement");
                assert_eq!(parser.ranges().len(), measurement.ranges());
                scans.push(parser.ranges().to_vec());
            }
            Some(Completed::BrokenScan(_) | Completed::Garbage(_)) => dropped += 1,
            Some(Completed::Answer) | None => {}
        }
        assert!(parser.ranges().len() <= MAX_RANGES && parser.text().len() <= 2048);
    }
    (scans, dropped)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 10_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_mutated_stream_is_read_without_panic(changes in prop::collection::vec(change(), 1..6)) {
        let mut stream = REPLIES.to_vec();
        changes.into_iter().for_each(|change| apply(&mut stream, change));
        let (found, _) = scans(&stream);
        // A checksum has six bits: a few changes of a byte pass. What passes has the right number of ranges.
        prop_assert!(found.len() <= 3 * SCANS, "{}", found.len());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn one_changed_byte_costs_two_replies_at_most(at in 0..REPLIES.len(), flip in 0..8_u8) {
        let mut stream = REPLIES.to_vec();
        stream[at] ^= 1 << flip;
        let (found, dropped) = scans(&stream);
        // The empty line between two replies is such a byte.
        prop_assert!(found.len() + 2 >= SCANS, "{} of {SCANS}", found.len());
        let all = intact();
        let wrong = found.iter().filter(|scan| !all.contains(scan)).count();
        prop_assert!(wrong == 0, "one flipped bit is always seen by the checksum");
        prop_assert!(dropped <= 2);
    }

    #[test]
    fn any_bytes_are_read_without_panic(stream in prop::collection::vec(any::<u8>(), 0..20_000)) {
        scans(&stream);
    }

    #[test]
    fn a_lost_piece_costs_only_the_scans_that_it_touches(at in 2861..REPLIES.len() - 9000, count in 1..2000_usize) {
        let mut stream = REPLIES.to_vec();
        stream.drain(at..at + count);
        let (found, _) = scans(&stream);
        prop_assert!(found.len() + 3 >= SCANS, "{} of {SCANS}", found.len());
    }
}

#[test]
fn an_endless_line_needs_no_more_memory() {
    let mut parser = Parser::default();
    (0..10_000_000).for_each(|_| assert_eq!(parser.push(b'x'), None));
    assert!(std::mem::size_of::<Parser>() < 8192);
    let found = REPLIES.iter().filter(|byte| parser.push(**byte) == Some(Completed::Scan)).count();
    assert_eq!(found, SCANS, "the recording after it is read");
}
