//! Journals: what comes before each output.

use std::rc::Rc;

use shared_types::{
    JOURNAL_ENTRIES, Journal, JournalEntry, JournalKind, Obstacles, Pose, Role, Sample, Topic,
};

use super::{Lab, pose};
use crate::Observer;
use crate::input::Input;
use crate::journal::Publish;
use crate::output::{Output, Writer};

fn entry(kind: JournalKind, value: u64) -> JournalEntry {
    JournalEntry { kind: kind.wire() as u16, value, ..JournalEntry::default() }
}

#[test]
fn what_was_taken_and_used_comes_before_the_output_and_what_does_not_fit_in_journals_of_its_own() {
    let lab = Lab::new();
    let shared = lab.shared(Role::Obstacles, 8);
    let journal = Rc::new(Writer::new(lab.bus(), Rc::clone(&shared), Journal::TYPE).unwrap());
    shared.notes.publish_by(Role::Obstacles, &(Rc::clone(&journal) as Rc<dyn Publish>));
    let poses = Output::<Pose>::new(lab.bus(), lab.shared(Role::Estimator, 7)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), Rc::clone(&shared)).unwrap();
    let output = Output::<Obstacles>::new(lab.bus(), Rc::clone(&shared)).unwrap();
    let journals = Observer::<Journal>::new(lab.bus()).unwrap();
    input.reader().drain().unwrap();
    poses.publish(&mut pose(1, 1.5)).unwrap();
    input.reader().drain().unwrap();
    let answer = |taken: &Pose| Obstacles { header: taken.header.answer(), ..Obstacles::default() };
    output.publish(&mut answer(&input.take().unwrap())).unwrap();
    // The next scan has more to tell than one journal holds.
    (0..=JOURNAL_ENTRIES as u64).for_each(|value| shared.notes.note(JournalKind::Used, value));
    output.publish(&mut answer(&pose(2, 0.0))).unwrap();
    let mut found = Vec::new();
    journals.poll(|journal| found.push(*journal)).unwrap();
    let heads: Vec<_> = found
        .iter()
        .map(|journal| (journal.header.sequence, journal.header.scan_id, journal.output))
        .collect();
    assert_eq!(heads, [(1, 1, 1), (2, 0, 0), (3, 2, 2)]);
    assert!(
        found.iter().all(|journal| journal.role == Role::Obstacles.wire() && journal.header.incarnation == 8)
    );
    let taken = JournalEntry { topic: Topic::Pose as u16, incarnation: 7, ..entry(JournalKind::Taken, 1) };
    assert_eq!(found[0].used(), [taken]);
    assert_eq!((found[1].used().len(), found[1].used()[3]), (JOURNAL_ENTRIES, entry(JournalKind::Used, 3)));
    assert_eq!(found[2].used(), [entry(JournalKind::Used, JOURNAL_ENTRIES as u64)]);
}
