//! A drive for tests of where a replay begins.

use bytemuck::bytes_of;
use shared_types::{
    Actuation, Checkpoint, Header, Journal, JournalEntry, JournalKind, Odometry, Role, Sample, Topic,
};

use super::ReplayDrive;

/// Incarnation of its estimator.
pub(crate) const ESTIMATOR: u32 = 7;

/// An estimator that gets the actuation of scan 1 only after its pose of scan 2: it saves states 1 and 2 after its poses, state
/// 3 of scan 1 after that actuation, and state 4 after its pose of scan 3.
pub(crate) fn late_actuation() -> ReplayDrive {
    let mut drive = ReplayDrive::default();
    let header =
        |scan_id, sequence| Header { scan_id, sequence, incarnation: ESTIMATOR, ..Header::default() };
    for (sequence, scan_id) in [(1, 1), (2, 2), (3, 1), (4, 3)] {
        let role = Role::Estimator.wire();
        let state = Checkpoint { header: header(scan_id, sequence), role, ..Checkpoint::default() };
        drive.add(Checkpoint::TOPIC, 0, bytes_of(&state));
    }
    let input = |number| Header { scan_id: number, sequence: number, incarnation: 1, ..Header::default() };
    for number in 1..=4 {
        drive.add(Topic::Odometry, 0, bytes_of(&Odometry { header: input(number), ..Odometry::default() }));
    }
    drive.add(Topic::Actuation, 0, bytes_of(&Actuation { header: input(1), ..Actuation::default() }));
    let taken = |topic: Topic, value| (JournalKind::Taken, topic as u16, value);
    let saved = |value| (JournalKind::Saved, 0, value);
    let told = [
        vec![taken(Topic::Odometry, 1)],
        vec![saved(1), taken(Topic::Odometry, 2)],
        vec![saved(2), taken(Topic::Actuation, 1), saved(3), taken(Topic::Odometry, 3)],
        vec![saved(4), taken(Topic::Odometry, 4)],
    ];
    for (index, entries) in told.into_iter().enumerate() {
        let number = index as u64 + 1;
        let mut journal = Journal { header: header(number, number), output: number, ..Journal::default() };
        for (kind, topic, value) in entries {
            journal.push(JournalEntry { kind: kind.wire() as u16, topic, incarnation: 1, value });
        }
        drive.add(Topic::Journal, 0, bytes_of(&journal));
    }
    drive
}

#[test]
fn journals_with_any_number_are_in_order_and_those_behind_a_gap_are_marked() {
    let mut drive = late_actuation();
    for sequence in [0, u64::MAX - 1, u64::MAX] {
        let header = Header { sequence, incarnation: ESTIMATOR, ..Header::default() };
        drive.add(Topic::Journal, 0, bytes_of(&Journal { header, ..Journal::default() }));
    }
    let found: Vec<(u64, bool)> = drive
        .numbered_journals(ESTIMATOR)
        .map(|(journal, follows)| (journal.header.sequence, follows))
        .collect();
    let last = u64::MAX;
    let expected = [(0, false), (1, true), (2, true), (3, true), (4, true), (last - 1, false), (last, true)];
    assert_eq!(found, expected);
}
