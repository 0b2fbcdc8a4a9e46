//! The reading end of a topic for samples of any type.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;

use shared_types::{
    Admission, AuthorityFilter, Fate, Fault, Header, InputAccount, Refusal, SampleType, Topic,
    require_sequence,
};

use crate::bell::Bells;
use crate::enclosed::Enclosed;
use crate::port::{ByteSubscriber, Queue, Received};
use crate::qos::{Qos, qos};
use crate::refusals::Refusals;
use crate::shared::Shared;
use crate::waiter::Waiter;
use crate::{Bus, RuntimeError, monotonic_ns};

/// Samples that wait in an input until the process takes them; the oldest is dropped for a newer one. Less than may be
/// borrowed.
pub const QUEUE_DEPTH: usize = 12;
/// Samples of the other process of a swap that are kept in case it answers after all: one scan is open when it takes
/// over at 1.2 periods; two more for an orchestrator that is delayed.
const ASIDE: usize = 3;

/// Reads samples of one type, as bytes.
pub(crate) struct Reader {
    of: &'static SampleType,
    qos: Qos,
    subscriber: ByteSubscriber,
    waiter: Waiter,
    bells: Arc<Bells>,
    /// The bell of the topic when it was emptied last.
    rung: Cell<u32>,
    shared: Rc<Shared>,
    kept: RefCell<VecDeque<Received>>,
    aside: RefCell<VecDeque<Received>>,
    dropped: RefCell<Vec<Received>>,
    filter: Cell<AuthorityFilter>,
    account: RefCell<InputAccount>,
    /// When the bus was polled before and last [ns of CLOCK_MONOTONIC].
    polled_ns: Cell<[u64; 2]>,
    refusals: Refusals,
}

impl Reader {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>, of: &'static SampleType) -> Result<Self, RuntimeError> {
        let qos = qos(of.topic, u64::MAX);
        Ok(Self {
            of,
            qos,
            subscriber: bus.subscriber(of, Queue::Process)?,
            waiter: Waiter::new(bus, of.topic)?,
            // The first poll finds whatever was published before.
            rung: Cell::new(bus.bells().topic(of.topic).poll().wrapping_sub(1)),
            bells: Arc::clone(bus.bells()),
            shared,
            kept: RefCell::new(VecDeque::with_capacity(QUEUE_DEPTH)),
            aside: RefCell::new(VecDeque::with_capacity(ASIDE)),
            dropped: RefCell::new(Vec::with_capacity(qos.max_borrowed())),
            filter: Cell::default(),
            account: RefCell::default(),
            polled_ns: Cell::new([0; 2]),
            refusals: Refusals::default(),
        })
    }

    pub(super) fn take(&self) -> Option<Enclosed<Received>> {
        loop {
            let sample = self.kept.borrow_mut().pop_front()?;
            if !self.shared.guard.refuses(self.of, &sample) {
                self.note_taken(&sample);
                return Some(Enclosed::new(sample));
            }
            self.settle(Fate::Foreign, &sample);
        }
    }

    pub(super) fn take_newest(&self) -> Option<Enclosed<Received>> {
        let mut kept = self.kept.borrow_mut();
        let sample = kept.pop_back()?;
        kept.drain(..).for_each(|older| self.settle(Fate::Replaced, &older));
        if self.shared.guard.refuses(self.of, &sample) {
            self.settle(Fate::Foreign, &sample);
            return None;
        }
        self.note_taken(&sample);
        Some(Enclosed::new(sample))
    }

    pub(super) fn next_scan(&self) -> Option<u64> {
        self.kept.borrow().front().map(|sample| self.header(sample).scan_id)
    }

    pub(super) fn skip_to(&self, scan_id: u64) {
        self.skip(&|sample| self.header(sample).scan_id <= scan_id);
    }

    pub(super) fn skip(&self, is_old: &dyn Fn(&[u8]) -> bool) {
        self.kept.borrow_mut().retain(|sample| {
            let is_old = is_old(sample);
            if is_old {
                self.settle(Fate::Replaced, sample);
            }
            !is_old
        });
    }

    /// Reports a sample whose content may not be used. One from a process that is not in charge is not reported.
    pub(super) fn refuse(&self, header: &Header, fault: &Fault) {
        let counts = self.shared.directive.borrow().counts(self.of.topic, header);
        if counts && self.refusals.note(self.of.topic, header, fault) {
            self.shared.counters.is_urgent.set(true);
        }
    }

    pub(super) fn dropped(&self) -> u64 {
        self.refusals.of_content()
    }

    /// The topic.
    pub(crate) fn topic(&self) -> Topic {
        self.of.topic
    }

    /// The event of the topic, for publishers that do not ring.
    pub(crate) fn waiter(&self) -> &Waiter {
        &self.waiter
    }

    /// Whether no sample waits to be taken.
    pub(crate) fn is_empty(&self) -> bool {
        self.kept.borrow().is_empty()
    }

    /// Whether the bell of the topic was rung since the input was emptied.
    pub(crate) fn is_rung(&self) -> bool {
        self.bells.topic(self.of.topic).poll() != self.rung.get()
    }

    /// Clears notifications, takes all samples from the bus and keeps the valid ones.
    pub(crate) fn drain(&self) -> Result<(), RuntimeError> {
        // Before any sample is taken: one that comes later rings again.
        self.rung.set(self.bells.topic(self.of.topic).poll());
        self.waiter.clear();
        self.polled_ns.set([self.polled_ns.get()[1], monotonic_ns()]);
        // Samples are overwritten only when as many newer ones have come as the buffer holds.
        let capacity = self.qos.of_a_process();
        let (before, mut received) = (*self.account.borrow(), 0);
        // Dropped samples return to their publisher at the end of each round only. A publisher has a limited number of
        // samples to borrow, so one that floods the topic can neither keep this loop busy nor, as the bus polls the
        // connections in a fixed order, hold up another's samples. So many rounds empty the longest queue.
        for _ in 0..capacity.div_ceil(self.qos.borrowed.saturating_sub(QUEUE_DEPTH + ASIDE).max(1)) {
            let is_all = self.subscriber.receive_all(|sample| {
                received += 1;
                self.arrive(sample);
            })?;
            self.dropped.borrow_mut().clear();
            if is_all {
                break;
            }
        }
        if received >= capacity {
            self.account.borrow_mut().overflowed_since(&before, capacity as u64);
        }
        Ok(())
    }

    /// Filters the samples kept aside again, after the directive has changed.
    pub(crate) fn review(&self) {
        let waiting = std::mem::take(&mut *self.aside.borrow_mut());
        waiting.into_iter().for_each(|sample| self.offer(sample, true));
        self.dropped.borrow_mut().clear();
    }

    /// The counters of all samples so far.
    pub(crate) fn account(&self) -> InputAccount {
        let mut account = *self.account.borrow();
        for sample in self.kept.borrow().iter().chain(self.aside.borrow().iter()) {
            account.waiting += 1;
            account.waiting_sum = account.waiting_sum.wrapping_add(self.header(sample).sequence);
        }
        account
    }

    /// Samples that were dropped or refused because of their content.
    pub(crate) fn refusal(&self) -> Refusal {
        self.refusals.newest()
    }

    fn header<'a>(&self, sample: &'a [u8]) -> &'a Header {
        (self.of.header)(sample)
    }

    /// The sample of one scan, if it is there; older ones are dropped and counted as replaced.
    fn take_scan(&self, scan_id: u64) -> Option<Received> {
        let mut kept = self.kept.borrow_mut();
        while kept.front().is_some_and(|sample| self.header(sample).scan_id < scan_id) {
            if let Some(sample) = kept.pop_front() {
                self.settle(Fate::Replaced, &sample);
            }
        }
        if kept.front().is_some_and(|sample| self.header(sample).scan_id == scan_id) {
            kept.pop_front()
        } else {
            None
        }
    }

    /// Whether the sample of one scan is there.
    fn has_scan(&self, scan_id: u64) -> bool {
        self.kept.borrow().iter().any(|sample| self.header(sample).scan_id == scan_id)
    }

    /// Counts a sample from the bus, and drops it when its number or its content is wrong.
    fn arrive(&self, sample: Received) {
        let header = self.header(&sample);
        let check = (self.of.check)(&sample);
        let readable = match check {
            Err(fault) if fault.hides_sequence() => Err(fault),
            _ => self.judge_sequence(header),
        };
        if let Err(fault) = readable {
            self.account.borrow_mut().unreadable += 1;
            self.refuse(header, &fault);
            self.dropped.borrow_mut().push(sample);
            return;
        }
        let check = check.and_then(|()| self.judge_scan(header));
        let (fate, is_urgent) = {
            let account = &mut *self.account.borrow_mut();
            let missing = account.missing;
            let is_new = account.from(header.incarnation).is_none();
            let fate = account.arrive(header);
            (fate, is_new || fate.is_some() || account.missing > missing)
        };
        if is_urgent && self.of.topic.writer().is_some() {
            self.shared.counters.is_urgent.set(true);
        }
        if let Some(fate) = fate {
            self.discard(fate, sample);
        } else if let Err(fault) = check {
            self.refuse(header, &fault);
            self.discard(Fate::Invalid, sample);
        } else {
            self.offer(sample, false);
        }
    }

    /// Keeps a sample that counts, keeps one aside that may count later, drops any other.
    fn offer(&self, sample: Received, was_aside: bool) {
        let header = self.header(&sample);
        let mut filter = self.filter.get();
        let admission = {
            let directive = self.shared.directive.borrow();
            filter.admit(directive.authority_over(self.of.topic), header, was_aside)
        };
        self.filter.set(filter);
        match admission {
            Admission::Counts => {}
            Admission::Aside => return self.push(&self.aside, sample, ASIDE, Fate::Foreign),
            Admission::Foreign => return self.discard(Fate::Foreign, sample),
        }
        if let Some(fault) = self.wrong_time(header) {
            self.refuse(header, &fault);
            return self.discard(Fate::Stale, sample);
        }
        if self.of.topic.writer().is_some() {
            self.shared.note_scan(header);
        }
        self.push(&self.kept, sample, QUEUE_DEPTH, Fate::Replaced);
    }

    /// Passes when the publisher can have used the sequence number of a sample by now.
    fn judge_sequence(&self, header: &Header) -> Result<(), Fault> {
        let [before_ns, now_ns] = self.polled_ns.get();
        let account = self.account.borrow();
        // All that is known of a new publisher is that it is not older than the machine.
        let (newest, since_ns) =
            account.from(header.incarnation).map_or((0, 0), |span| (span.last, before_ns));
        require_sequence(header.sequence, newest, now_ns.saturating_sub(since_ns))
    }

    /// Passes when the scan of a sample can exist.
    fn judge_scan(&self, header: &Header) -> Result<(), Fault> {
        if self.of.topic.writer().is_some() { self.shared.judge_scan(header) } else { Ok(()) }
    }

    /// What is wrong with the time of a sample: it is too old, or from the future.
    fn wrong_time(&self, header: &Header) -> Option<Fault> {
        let (topic, shared) = (self.of.topic, &self.shared);
        if shared.clock.is_simulated() || topic.writer().is_none() || header.acquired_ns == 0 {
            return None;
        }
        let (now_ns, limit_ns) = (shared.clock.now_ns(), shared.max_age_ns());
        let ahead_ns = header.acquired_ns.saturating_sub(now_ns);
        if ahead_ns > limit_ns {
            return Some(Fault::FromTheFuture { ahead_ms: ahead_ns as f64 * 1e-6 });
        }
        let is_record = shared.guard.is_record(self.of);
        let age_ns = now_ns.saturating_sub(header.acquired_ns);
        (!is_record && age_ns > limit_ns).then_some(Fault::TooOld { age_ms: age_ns as f64 * 1e-6 })
    }

    fn note_taken(&self, sample: &[u8]) {
        self.settle(Fate::Used, sample);
        self.shared.taken(self.of.topic, self.header(sample));
    }

    fn settle(&self, fate: Fate, sample: &[u8]) {
        self.account.borrow_mut().settle(fate, self.header(sample));
    }

    /// Drops a sample at the end of this poll.
    fn discard(&self, fate: Fate, sample: Received) {
        self.settle(fate, &sample);
        self.dropped.borrow_mut().push(sample);
    }

    /// Appends a sample; from a queue that holds `depth`, the oldest is dropped.
    fn push(&self, queue: &RefCell<VecDeque<Received>>, sample: Received, depth: usize, fate: Fate) {
        let mut queue = queue.borrow_mut();
        let oldest = (queue.len() == depth).then(|| queue.pop_front()).flatten();
        if let Some(oldest) = oldest {
            self.discard(fate, oldest);
        }
        queue.push_back(sample);
    }
}

/// [`crate::join`] of samples of any two types.
pub(super) fn join(one: &Reader, other: &Reader) -> Option<(Enclosed<Received>, Enclosed<Received>)> {
    let scan_id = {
        let (kept, shared) = (one.kept.borrow(), &one.shared);
        let headers = kept.iter().map(|sample| one.header(sample));
        let mut pairs = headers.filter(|header| other.has_scan(header.scan_id));
        let newest = pairs.clone().next_back()?;
        let catches_up = shared.catches_up(pairs.clone().count() as u64);
        let oldest = pairs.find(|header| catches_up && shared.can_answer(header));
        oldest.unwrap_or(newest).scan_id
    };
    let first = one.take_scan(scan_id)?;
    let Some(second) = other.take_scan(scan_id) else {
        // Its publisher does not number scans in order.
        one.settle(Fate::Replaced, &first);
        return None;
    };
    one.note_taken(&first);
    other.note_taken(&second);
    Some((Enclosed::new(first), Enclosed::new(second)))
}
