//! Fault injection at the writing end of a topic.

use std::rc::Rc;

use shared_types::{
    Actuation, ActuationKind, Journal, JournalEntry, JournalKind, Pose, Role, Sample, SampleType, Topic,
};

use super::{Lab, pose};
use crate::guard::Guard;
use crate::input::Input;
use crate::journal::Publish;
use crate::output::{Output, Writer};
use crate::{Observer, StopWord, Tamper};

/// Loses scan 2, moves x of the others, and lets every actuation drive.
struct Test;

impl Tamper for Test {
    fn delay(&mut self, _: Topic) {}

    fn change(&mut self, of: &SampleType, sample: &mut [u8]) -> bool {
        if let Ok(pose) = bytemuck::try_from_bytes_mut::<Pose>(sample)
            && of.topic == Topic::Pose
        {
            pose.x_m += 1.0;
            return pose.header.scan_id != 2;
        }
        if let Ok(actuation) = bytemuck::try_from_bytes_mut::<Actuation>(sample)
            && of.topic == Topic::Actuation
        {
            actuation.kind = ActuationKind::Drive.wire();
        }
        true
    }
}

#[test]
fn an_injected_fault_changes_and_loses_samples_on_their_way_out() {
    let lab = Lab::new();
    let estimator = lab.shared(Role::Estimator, 7);
    *estimator.tamper.borrow_mut() = Some(Box::new(Test));
    let output = Output::<Pose>::new(lab.bus(), Rc::clone(&estimator)).unwrap();
    let input = Input::<Pose>::new(lab.bus(), lab.shared(Role::Controller, 9)).unwrap();
    let journal = Rc::new(Writer::new(lab.bus(), Rc::clone(&estimator), Journal::TYPE).unwrap());
    estimator.notes.publish_by(Role::Estimator, &(Rc::clone(&journal) as Rc<dyn Publish>));
    let journals = Observer::<Journal>::new(lab.bus()).unwrap();
    input.reader().drain().unwrap();
    (1..=3).for_each(|scan| output.publish(&mut pose(scan, 0.5)).unwrap());
    input.reader().drain().unwrap();
    let taken = std::iter::from_fn(|| input.take()).map(|pose| (pose.header.scan_id, pose.x_m));
    assert_eq!(taken.collect::<Vec<_>>(), [(1, 1.5), (3, 1.5)]);
    // The next journal tells which sample was changed.
    let mut told = Vec::new();
    journals.poll(|journal| told.push(journal.used().to_vec())).unwrap();
    let kind = JournalKind::Injected.wire() as u16;
    let first = JournalEntry { kind, topic: Topic::Pose as u16, incarnation: 7, value: 1 };
    assert_eq!(told, [vec![], vec![first], vec![]]);
}

#[test]
fn no_injected_fault_lets_wheels_turn_after_a_stop() {
    let lab = Lab::new();
    let word = StopWord::create("tampertest", 1).unwrap();
    let Ok(mut shared) = Rc::try_unwrap(lab.shared(Role::Actuator, 7)) else { panic!("one owner") };
    shared.guard = Guard::new(Role::Actuator, Some(word.clone()));
    *shared.tamper.borrow_mut() = Some(Box::new(Test));
    let output = Output::<Actuation>::new(lab.bus(), Rc::new(shared)).unwrap();
    let actuations = Observer::<Actuation>::new(lab.bus()).unwrap();
    let publish = || {
        output.publish(&mut Actuation { kind: ActuationKind::Block.wire(), ..Actuation::default() }).unwrap();
        let mut kind = None;
        while let Some((actuation, _)) = actuations.next().unwrap() {
            kind = Some(actuation.kind);
        }
        kind
    };
    assert_eq!(publish(), Some(ActuationKind::Drive.wire()), "the fault");
    word.latch();
    assert_eq!(publish(), Some(ActuationKind::Block.wire()));
}
