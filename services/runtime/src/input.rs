//! The reading end of a topic: only valid samples of the producer in charge come out of it.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::ops::Deref;
use std::rc::Rc;

use iceoryx2::prelude::ipc;
use iceoryx2::sample::Sample as BusSample;
use shared_types::{Sample, Topic};

use crate::bus::WireSubscriber;
use crate::counters::count;
use crate::ear::Ear;
use crate::process::Shared;
use crate::wire::Wire;
use crate::{Bus, RuntimeError};

/// Samples kept until the process takes them; below the number that may be borrowed.
const KEPT: usize = 4;
/// Samples of the other process of an exchange that are kept in case it has to answer after all: one scan is open
/// when it takes over at 1.2 periods; two more for an orchestrator that is held up.
const ASIDE: usize = 3;

/// A sample in shared memory, read in place and returned to its producer when dropped.
pub struct Taken<S: Sample>(BusSample<ipc::Service, Wire<S>, ()>);

impl<S: Sample> Deref for Taken<S> {
    type Target = S;

    fn deref(&self) -> &S {
        &self.0.payload().0
    }
}

/// Reads samples of one type.
///
/// What never comes out: a sample of another layout or with bad content, of a producer without authority, a
/// duplicate, a reordered one, one that is too old. Each is counted by its kind in the heartbeat.
///
/// While one process takes over from another, the newest samples of the one that does not count are kept aside.
/// When the directive gives their scans back to it they come out as if they had just arrived; and no scan that
/// was answered by one of the two is answered by the other again.
#[derive(Clone)]
pub struct Input<S: Sample>(Rc<Reader<S>>);

struct Reader<S: Sample> {
    subscriber: WireSubscriber<S>,
    ear: Ear,
    shared: Rc<Shared>,
    kept: RefCell<VecDeque<Taken<S>>>,
    aside: RefCell<VecDeque<Taken<S>>>,
    last: Cell<Last>,
}

/// Of the sample accepted last.
#[derive(Clone, Copy, Default)]
struct Last {
    incarnation: u32,
    sequence: u64,
    scan_id: u64,
}

impl<S: Sample> Input<S> {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        Ok(Self(Rc::new(Reader {
            subscriber: bus.subscriber::<S>()?,
            ear: Ear::new(bus, S::TOPIC)?,
            shared,
            kept: RefCell::new(VecDeque::with_capacity(KEPT)),
            aside: RefCell::new(VecDeque::with_capacity(ASIDE)),
            last: Cell::default(),
        })))
    }

    /// The oldest sample not yet taken.
    pub fn take(&self) -> Option<Taken<S>> {
        let sample = self.0.kept.borrow_mut().pop_front()?;
        self.0.shared.taken(&*sample);
        Some(sample)
    }

    /// The scan of the oldest sample not yet taken.
    pub fn next_scan(&self) -> Option<u64> {
        self.0.kept.borrow().front().map(|sample| sample.header().scan_id)
    }

    /// The newest sample; older ones are dropped and counted as replaced.
    pub fn take_newest(&self) -> Option<Taken<S>> {
        let mut kept = self.0.kept.borrow_mut();
        count(&self.0.shared.counters.replaced, kept.len().saturating_sub(1) as u64);
        let sample = kept.pop_back()?;
        kept.clear();
        self.0.shared.taken(&*sample);
        Some(sample)
    }

    /// The sample of one scan, if it is there; older ones are dropped and counted as replaced.
    fn take_scan(&self, scan_id: u64) -> Option<Taken<S>> {
        let mut kept = self.0.kept.borrow_mut();
        while kept.front().is_some_and(|sample| sample.header().scan_id < scan_id) {
            kept.pop_front();
            count(&self.0.shared.counters.replaced, 1);
        }
        if kept.front().is_some_and(|sample| sample.header().scan_id == scan_id) {
            kept.pop_front()
        } else {
            None
        }
    }

    /// Whether the sample of one scan is there.
    fn has_scan(&self, scan_id: u64) -> bool {
        self.0.kept.borrow().iter().any(|sample| sample.header().scan_id == scan_id)
    }
}

/// Takes the newest pair of samples that belong to one scan; older ones are dropped and counted as replaced.
pub fn join<A: Sample, B: Sample>(one: &Input<A>, other: &Input<B>) -> Option<(Taken<A>, Taken<B>)> {
    let scan_id = {
        let kept = one.0.kept.borrow();
        kept.iter().rev().map(|sample| sample.header().scan_id).find(|scan_id| other.has_scan(*scan_id))?
    };
    let pair = (one.take_scan(scan_id)?, other.take_scan(scan_id)?);
    one.0.shared.taken(&*pair.0);
    other.0.shared.taken(&*pair.1);
    Some(pair)
}

/// An input as its process sees it.
pub(crate) trait Drain {
    /// The topic.
    fn topic(&self) -> Topic;
    /// The event of the topic, for writers that do not ring.
    fn ear(&self) -> &Ear;
    /// Whether nothing waits to be taken.
    fn is_empty(&self) -> bool;
    /// Clears notifications, takes all samples from the bus and keeps the good ones.
    fn drain(&self) -> Result<(), RuntimeError>;
    /// Looks again at what was kept aside, now that the directive has changed.
    fn review(&self);
}

impl<S: Sample> Drain for Input<S> {
    fn topic(&self) -> Topic {
        S::TOPIC
    }

    fn ear(&self) -> &Ear {
        &self.0.ear
    }

    fn is_empty(&self) -> bool {
        self.0.kept.borrow().is_empty()
    }

    fn drain(&self) -> Result<(), RuntimeError> {
        let reader = &*self.0;
        reader.ear.clear();
        let error = |reason| RuntimeError::bus(format!("receive from topic {}", S::TOPIC), reason);
        while let Some(sample) = reader.subscriber.receive().map_err(error)? {
            reader.offer(Taken(sample), false);
        }
        Ok(())
    }

    fn review(&self) {
        let waiting = std::mem::take(&mut *self.0.aside.borrow_mut());
        waiting.into_iter().for_each(|sample| self.0.offer(sample, true));
    }
}

impl<S: Sample> Reader<S> {
    /// Keeps a sample that counts, keeps one aside that may count later, drops and counts any other.
    fn offer(&self, sample: Taken<S>, was_aside: bool) {
        let counters = &self.shared.counters;
        if let Err(fault) = sample.check() {
            count(&counters.invalid, 1);
            tracing::debug!(topic = %S::TOPIC, %fault, "sample dropped");
            return;
        }
        let header = sample.header();
        if let Some(writer) = S::TOPIC.writer() {
            let directive = self.shared.directive.borrow();
            if directive.stands_by(writer, header.incarnation, header.scan_id) {
                return push(&self.aside, sample, ASIDE, &counters.foreign);
            }
            if !directive.accepts(writer, header.incarnation, header.scan_id) {
                return count(&counters.foreign, 1);
            }
            let last = self.last.get();
            // Outside of exchanges an actuator that was restarted blocks the wheels under an older scan.
            let other = was_aside || directive.is_exchanged(writer) && header.incarnation != last.incarnation;
            if other && header.scan_id <= last.scan_id {
                return count(&counters.duplicate, 1);
            }
        }
        if self.is_news(&sample) {
            push(&self.kept, sample, KEPT, &counters.replaced);
        }
    }

    /// Whether a sample of the producer in charge is neither repeated nor reordered nor old; counts why not.
    fn is_news(&self, sample: &S) -> bool {
        let counters = &self.shared.counters;
        let (header, last) = (sample.header(), self.last.get());
        if header.incarnation == last.incarnation {
            if header.sequence <= last.sequence {
                let repeated = header.sequence == last.sequence;
                count(if repeated { &counters.duplicate } else { &counters.reordered }, 1);
                return false;
            }
            count(&counters.missing, header.sequence - last.sequence - 1);
        }
        let (incarnation, sequence) = (header.incarnation, header.sequence);
        let scan_id = header.scan_id.max(last.scan_id);
        self.last.set(Last { incarnation, sequence, scan_id });
        if !self.shared.clock.is_simulated() && S::TOPIC.writer().is_some() {
            let age = self.shared.clock.now_ns().saturating_sub(header.acquired_ns);
            if header.acquired_ns > 0 && age > self.shared.max_age_ns {
                count(&counters.stale, 1);
                return false;
            }
        }
        true
    }
}

/// Puts a sample at the end; the oldest gives way and is counted when there are `most` already.
fn push<S: Sample>(queue: &RefCell<VecDeque<Taken<S>>>, sample: Taken<S>, most: usize, dropped: &Cell<u64>) {
    let mut queue = queue.borrow_mut();
    if queue.len() == most {
        queue.pop_front();
        count(dropped, 1);
    }
    queue.push_back(sample);
}
