//! The bytes of Hokuyo's own client library and of the device that it talked to.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use urg::{Coding, Completed, Measurement, Parser, ScipCommand, ScipStatus, SensorParameters};

const REPLIES: &[u8] = include_bytes!("data/scip-urglib-tcp.s2c.bin");
const COMMANDS: &[u8] = include_bytes!("data/scip-urglib-tcp.c2s.bin");

/// A reply as it was read.
#[derive(Debug, Clone, PartialEq)]
enum Reply {
    Answer(String, ScipStatus, Vec<u8>),
    Scan(Measurement, u32, Vec<u32>),
}

fn replies(pieces: usize) -> Vec<Reply> {
    let mut parser = Parser::default();
    let mut replies = Vec::new();
    for piece in REPLIES.chunks(pieces) {
        for byte in piece {
            match parser.push(*byte) {
                None => {}
                Some(Completed::Answer) => {
                    let echo = String::from_utf8(parser.echo().to_vec()).unwrap();
                    replies.push(Reply::Answer(echo, parser.status(), parser.text().to_vec()));
                }
                Some(Completed::Scan) => {
                    let measurement = parser.measurement().unwrap();
                    let ranges = parser.ranges().to_vec();
                    replies.push(Reply::Scan(measurement, parser.stamp().unwrap(), ranges));
                }
                Some(fault) => panic!("{fault:?}"),
            }
        }
    }
    replies
}

#[test]
fn every_reply_is_read_to_its_last_byte() {
    let replies = replies(64);
    let (answers, scans): (Vec<&Reply>, Vec<&Reply>) =
        replies.iter().partition(|reply| matches!(reply, Reply::Answer(..)));
    assert_eq!((answers.len(), scans.len()), (17, 12));
    for answer in answers {
        let Reply::Answer(echo, status, _) = answer else { unreachable!() };
        assert_eq!(*status, ScipStatus::DONE, "{echo}");
    }
    let left: Vec<(u16, u8)> = scans
        .iter()
        .map(|scan| match scan {
            Reply::Scan(measurement, ..) => (measurement.first, measurement.count),
            Reply::Answer(..) => unreachable!(),
        })
        .collect();
    let all = [0, 4, 3, 2, 1, 0].map(|count| (44, count));
    assert_eq!(left[..6], all);
    assert_eq!(left[6..], [(214, 0), (214, 0), (214, 0), (214, 0), (214, 1), (214, 0)]);
}

#[test]
fn the_scene_has_its_known_ranges() {
    for reply in replies(7) {
        let Reply::Scan(measurement, _, ranges) = reply else { continue };
        assert_eq!(ranges.len(), measurement.ranges());
        let range = |step: u16| ranges[usize::from(step - measurement.first)];
        match measurement.coding {
            Coding::Three => assert_eq!(range(384), 3650),
            Coding::Two => assert_eq!(range(384), 3650),
        }
        if measurement.first == 44 {
            assert_eq!((range(44), range(44 + 85), range(44 + 255)), (1727, 1500, 2990));
            assert_eq!([100, 101, 102, 103].map(range), [1, 7, 18, 19]);
        }
    }
}

#[test]
fn stamps_and_parameters_are_read() {
    let replies = replies(REPLIES.len());
    let stamps: Vec<u32> = replies
        .iter()
        .filter_map(|reply| match reply {
            Reply::Scan(_, stamp, _) => Some(*stamp),
            Reply::Answer(..) => None,
        })
        .collect();
    assert_eq!(stamps[0], 136);
    assert!(stamps[1..].windows(2).all(|pair| (pair[1] - pair[0]).is_multiple_of(100)), "{stamps:?}");
    let parameters = replies.iter().find_map(|reply| match reply {
        Reply::Answer(echo, _, text) if echo == "PP" => Some(SensorParameters::of_text(text).unwrap()),
        _ => None,
    });
    let parameters = parameters.unwrap();
    assert_eq!((parameters.steps, parameters.max_mm, parameters.rpm), (1024, 5600, 600));
}

#[test]
fn the_size_of_the_pieces_changes_nothing() {
    let whole = replies(REPLIES.len());
    for pieces in [1, 7, 39, 41, 65_536] {
        assert_eq!(replies(pieces), whole, "{pieces}");
    }
}

#[test]
fn commands_are_written_as_the_library_wrote_them() {
    let full = Measurement { first: 44, last: 725, cluster: 1, ..Measurement::default() };
    let window = Measurement { first: 214, last: 555, cluster: 1, ..Measurement::default() };
    let commands = [
        ScipCommand::Quit,
        ScipCommand::Parameters,
        ScipCommand::State,
        ScipCommand::State,
        ScipCommand::Version,
        ScipCommand::Version,
        ScipCommand::Version,
        ScipCommand::TimeModeOn,
        ScipCommand::Time,
        ScipCommand::TimeModeOff,
        ScipCommand::LaserOn,
        ScipCommand::Measure(Measurement { single: true, ..full }),
        ScipCommand::Measure(Measurement { count: 5, ..full }),
        ScipCommand::Quit,
        ScipCommand::Measure(Measurement { cluster: 1, skip: 1, ..window }),
        ScipCommand::Quit,
        ScipCommand::Measure(Measurement { coding: Coding::Two, cluster: 1, count: 2, ..window }),
        ScipCommand::Quit,
    ];
    // The library begins with an empty line.
    let mut written = b"\n".to_vec();
    commands.iter().for_each(|command| command.append_to(&mut written));
    assert_eq!(String::from_utf8_lossy(&written), String::from_utf8_lossy(COMMANDS));
}
