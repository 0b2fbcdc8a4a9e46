//! The reading end of a topic: only valid samples of the producer in charge come out of it.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::ops::Deref;
use std::rc::Rc;
use std::sync::Arc;

use iceoryx2::port::ReceiveError;
use iceoryx2::prelude::ipc;
use iceoryx2::sample::Sample as BusSample;
use shared_types::{Admission, AuthorityFilter, Fate, Fault, InputAccount, Refusal, Role, Sample, Topic};

use crate::bell::Bells;
use crate::bus::WireSubscriber;
use crate::ear::Ear;
use crate::process::Shared;
use crate::quality::{buffer, quality};
use crate::refusals::Refusals;
use crate::wire::Wire;
use crate::{Bus, RuntimeError};

/// Samples that an input keeps until the process takes them, the newest of them; below the number that may be borrowed.
pub const KEPT: usize = 12;
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
/// duplicate, a reordered one, one that is too old (actuations are never too old for other roles than the robot). Each is counted by its kind in the account of the input,
/// which travels in the heartbeat.
///
/// While one process takes over from another, the newest samples of the one that does not count are kept aside.
/// When the directive gives their scans back to it they come out as if they had just arrived; and no scan that
/// was answered by one of the two is answered by the other again.
#[derive(Clone)]
pub struct Input<S: Sample>(Rc<Reader<S>>);

struct Reader<S: Sample> {
    subscriber: WireSubscriber<S>,
    ear: Ear,
    bells: Arc<Bells>,
    /// The bell of the topic when it was emptied last.
    rung: Cell<u32>,
    shared: Rc<Shared>,
    kept: RefCell<VecDeque<Taken<S>>>,
    aside: RefCell<VecDeque<Taken<S>>>,
    dropped: RefCell<Vec<Taken<S>>>,
    filter: Cell<AuthorityFilter>,
    account: RefCell<InputAccount>,
    refusals: Refusals,
}

impl<S: Sample> Input<S> {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        Ok(Self(Rc::new(Reader {
            subscriber: bus.subscriber::<S>()?,
            ear: Ear::new(bus, S::TOPIC)?,
            // Whatever was rung before is found by the first look.
            rung: Cell::new(bus.bells().topic(S::TOPIC).look().wrapping_sub(1)),
            bells: Arc::clone(bus.bells()),
            shared,
            kept: RefCell::new(VecDeque::with_capacity(KEPT)),
            aside: RefCell::new(VecDeque::with_capacity(ASIDE)),
            dropped: RefCell::new(Vec::with_capacity(quality(S::TOPIC).most_borrowed())),
            filter: Cell::default(),
            account: RefCell::default(),
            refusals: Refusals::default(),
        })))
    }

    /// The oldest sample not yet taken.
    pub fn take(&self) -> Option<Taken<S>> {
        loop {
            let sample = self.0.kept.borrow_mut().pop_front()?;
            if !self.0.shared.guard.refuses(&*sample) {
                self.0.take(&sample);
                return Some(sample);
            }
            self.0.settle(Fate::Foreign, &sample);
        }
    }

    /// The scan of the oldest sample not yet taken.
    pub fn next_scan(&self) -> Option<u64> {
        self.0.kept.borrow().front().map(|sample| sample.header().scan_id)
    }

    /// Drops what is kept of scans up to `scan_id`, counted as replaced: a state that was taken up contains them.
    pub fn skip_to(&self, scan_id: u64) {
        self.skip(|sample| sample.header().scan_id <= scan_id);
    }

    /// Drops what is kept and `is_old`, counted as replaced.
    pub fn skip(&self, is_old: impl Fn(&S) -> bool) {
        self.0.kept.borrow_mut().retain(|sample| {
            let is_old = is_old(sample);
            if is_old {
                self.0.settle(Fate::Replaced, sample);
            }
            !is_old
        });
    }

    /// The newest sample; older ones are dropped and counted as replaced.
    pub fn take_newest(&self) -> Option<Taken<S>> {
        let mut kept = self.0.kept.borrow_mut();
        let sample = kept.pop_back()?;
        kept.drain(..).for_each(|older| self.0.settle(Fate::Replaced, &older));
        if self.0.shared.guard.refuses(&*sample) {
            self.0.settle(Fate::Foreign, &sample);
            return None;
        }
        self.0.take(&sample);
        Some(sample)
    }

    /// Notes that the process refuses a sample that it has taken: in its log, and in its next heartbeat.
    pub fn refuse(&self, sample: &S, fault: &Fault) {
        self.0.refuse(sample, fault);
    }

    /// How many samples of the writer in charge were dropped for their content.
    pub fn dropped(&self) -> u64 {
        self.0.refusals.of_content()
    }

    /// The sample of one scan, if it is there; older ones are dropped and counted as replaced.
    fn take_scan(&self, scan_id: u64) -> Option<Taken<S>> {
        let mut kept = self.0.kept.borrow_mut();
        while kept.front().is_some_and(|sample| sample.header().scan_id < scan_id) {
            if let Some(sample) = kept.pop_front() {
                self.0.settle(Fate::Replaced, &sample);
            }
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

/// Takes a pair of samples that belong to one scan; older ones are dropped and counted as replaced.
///
/// A process that was held up has several pairs. As long as it answers faster than scans come, and all that wait in a
/// third of the age at which inputs are refused, it is given the oldest that is not too old by the time it is answered,
/// and no scan stays without an answer; otherwise the newest. Its last two answers tell: the quicker how fast it is, the
/// slower how long an answer may take. To be called until there is none: [`crate::Process::wait`] does not return for
/// what has come before.
pub fn join<A: Sample, B: Sample>(one: &Input<A>, other: &Input<B>) -> Option<(Taken<A>, Taken<B>)> {
    let scan_id = {
        let (kept, shared) = (one.0.kept.borrow(), &one.0.shared);
        let headers = kept.iter().map(|sample| sample.header());
        let mut pairs = headers.filter(|header| other.has_scan(header.scan_id));
        let newest = pairs.clone().next_back()?;
        let catches_up = shared.catches_up(pairs.clone().count() as u64);
        let oldest = pairs.find(|header| catches_up && shared.can_answer(header));
        oldest.unwrap_or(newest).scan_id
    };
    let first = one.take_scan(scan_id)?;
    let Some(second) = other.take_scan(scan_id) else {
        // Its writer does not number scans in order.
        one.0.settle(Fate::Replaced, &first);
        return None;
    };
    let pair = (first, second);
    one.0.take(&pair.0);
    other.0.take(&pair.1);
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
    /// Whether the topic was rung for since it was emptied.
    fn is_rung(&self) -> bool;
    /// Clears notifications, takes all samples from the bus and keeps the good ones.
    fn drain(&self) -> Result<(), RuntimeError>;
    /// Looks again at what was kept aside, now that the directive has changed.
    fn review(&self);
    /// What became of all samples so far.
    fn account(&self) -> InputAccount;
    /// Samples that were dropped or refused because of their content.
    fn refusal(&self) -> Refusal;
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

    fn is_rung(&self) -> bool {
        self.0.bells.topic(S::TOPIC).look() != self.0.rung.get()
    }

    fn drain(&self) -> Result<(), RuntimeError> {
        let reader = &*self.0;
        // Before anything is taken: what comes later rings again.
        reader.rung.set(reader.bells.topic(S::TOPIC).look());
        reader.ear.clear();
        // Samples are overwritten only when as many newer ones have come as the buffer holds.
        let capacity = buffer(S::TOPIC);
        let (before, mut received) = (*reader.account.borrow(), 0);
        // What is dropped goes back to its producer at the end of a go only. A producer has so many samples that can be
        // borrowed and no more, so one that publishes faster than this can hold neither this loop nor, because the bus
        // asks the connections in a fixed order, the samples of another. So many goes empty the longest queue.
        for _ in 0..capacity.div_ceil(quality(S::TOPIC).borrowed.saturating_sub(KEPT + ASIDE).max(1)) {
            let is_all = loop {
                match reader.subscriber.receive() {
                    Ok(Some(sample)) => {
                        received += 1;
                        reader.arrive(Taken(sample));
                    }
                    Ok(None) => break true,
                    Err(ReceiveError::ExceedsMaxBorrows) => break false,
                    Err(reason) => {
                        return Err(RuntimeError::bus(format!("receive from topic {}", S::TOPIC), reason));
                    }
                }
            };
            reader.dropped.borrow_mut().clear();
            if is_all {
                break;
            }
        }
        if received >= capacity {
            reader.account.borrow_mut().overflowed_since(&before, capacity as u64);
        }
        Ok(())
    }

    fn review(&self) {
        let waiting = std::mem::take(&mut *self.0.aside.borrow_mut());
        waiting.into_iter().for_each(|sample| self.0.offer(sample, true));
        self.0.dropped.borrow_mut().clear();
    }

    fn account(&self) -> InputAccount {
        let mut account = *self.0.account.borrow();
        for sample in self.0.kept.borrow().iter().chain(self.0.aside.borrow().iter()) {
            account.waiting += 1;
            account.waiting_sum = account.waiting_sum.wrapping_add(sample.header().sequence);
        }
        account
    }

    fn refusal(&self) -> Refusal {
        self.0.refusals.newest()
    }
}

impl<S: Sample> Reader<S> {
    /// Notes that a sample came from the bus, and drops it when its number or its content is wrong.
    fn arrive(&self, sample: Taken<S>) {
        let check = sample.check();
        if let Err(fault @ Fault::Layout { .. }) = check {
            self.account.borrow_mut().unreadable += 1;
            self.refuse(&sample, &fault);
            self.dropped.borrow_mut().push(sample);
            return;
        }
        let (fate, news) = {
            let account = &mut *self.account.borrow_mut();
            let (missing, header) = (account.missing, sample.header());
            let is_new = account.from(header.incarnation).is_none();
            let fate = account.arrive(header);
            (fate, is_new || fate.is_some() || account.missing > missing)
        };
        if news && S::TOPIC.writer().is_some() {
            self.shared.counters.news.set(true);
        }
        if let Some(fate) = fate {
            self.discard(fate, sample);
        } else if let Err(fault) = check {
            self.refuse(&sample, &fault);
            self.discard(Fate::Invalid, sample);
        } else {
            self.offer(sample, false);
        }
    }

    /// Tells of a sample whose content may not be used. Samples that would not count are no news: nothing follows from them.
    fn refuse(&self, sample: &S, fault: &Fault) {
        let header = sample.header();
        let counts = self.shared.directive.borrow().counts(S::TOPIC, header);
        if counts && self.refusals.note(S::TOPIC, header, fault) {
            self.shared.counters.news.set(true);
        }
    }

    /// Keeps a sample that counts, keeps one aside that may count later, drops any other.
    fn offer(&self, sample: Taken<S>, was_aside: bool) {
        let mut filter = self.filter.get();
        let admission = {
            let directive = self.shared.directive.borrow();
            filter.admit(directive.authority_over(S::TOPIC), sample.header(), was_aside)
        };
        self.filter.set(filter);
        match admission {
            Admission::Counts => {}
            Admission::Aside => return self.push(&self.aside, sample, ASIDE, Fate::Foreign),
            Admission::Foreign => return self.discard(Fate::Foreign, sample),
        }
        if let Some(age_ns) = self.age_of_stale(&sample) {
            self.refuse(&sample, &Fault::TooOld { age_ms: age_ns as f64 * 1e-6 });
            return self.discard(Fate::Stale, sample);
        }
        self.push(&self.kept, sample, KEPT, Fate::Replaced);
    }

    /// The age of a sample that is too old [ns].
    fn age_of_stale(&self, sample: &S) -> Option<u64> {
        // An actuation asks something of the robot only. Others read in it what the wheels did, which stays true.
        let is_record = S::TOPIC == Topic::Actuation && self.shared.role != Role::Robot;
        let acquired_ns = sample.header().acquired_ns;
        if self.shared.clock.is_simulated() || S::TOPIC.writer().is_none() || is_record || acquired_ns == 0 {
            return None;
        }
        let age_ns = self.shared.clock.now_ns().saturating_sub(acquired_ns);
        (age_ns > self.shared.max_age_ns()).then_some(age_ns)
    }

    fn take(&self, sample: &S) {
        self.settle(Fate::Used, sample);
        self.shared.taken(sample);
    }

    fn settle(&self, fate: Fate, sample: &S) {
        self.account.borrow_mut().settle(fate, sample.header());
    }

    /// Drops a sample, at the end of this look.
    fn discard(&self, fate: Fate, sample: Taken<S>) {
        self.settle(fate, &sample);
        self.dropped.borrow_mut().push(sample);
    }

    /// Puts a sample at the end; the oldest gives way to it when there are `most` already.
    fn push(&self, queue: &RefCell<VecDeque<Taken<S>>>, sample: Taken<S>, most: usize, fate: Fate) {
        let mut queue = queue.borrow_mut();
        let gives_way = (queue.len() == most).then(|| queue.pop_front()).flatten();
        if let Some(oldest) = gives_way {
            self.discard(fate, oldest);
        }
        queue.push_back(sample);
    }
}
