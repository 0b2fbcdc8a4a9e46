//! The reading end of a topic for samples of any type.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::sync::Arc;

use shared_types::{
    ASIDE_DEPTH, Fate, Fault, Header, Inbox, InboxArrival, InboxRules, InputAccount, QUEUE_DEPTH, Refusal,
    SampleType, Topic,
};

use crate::bell::Bells;
use crate::enclosed::Enclosed;
use crate::port::{ByteSubscriber, Queue, Received};
use crate::qos::{Qos, qos};
use crate::refusals::Refusals;
use crate::shared::Shared;
use crate::waiter::Waiter;
use crate::{Bus, RuntimeError, monotonic_ns};

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
    inbox: RefCell<Inbox<Received>>,
    dropped: RefCell<Vec<Received>>,
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
            inbox: RefCell::new(Inbox::new(of)),
            dropped: RefCell::new(Vec::with_capacity(qos.max_borrowed())),
            polled_ns: Cell::new([0; 2]),
            refusals: Refusals::default(),
        })
    }

    pub(crate) fn take(&self) -> Option<Enclosed<Received>> {
        loop {
            let sample = self.inbox.borrow_mut().pop()?;
            if let Some(sample) = self.hand_over(sample) {
                return Some(sample);
            }
        }
    }

    /// The oldest sample, unless it is of a later scan.
    pub(crate) fn take_up_to(&self, scan_id: u64) -> Option<Enclosed<Received>> {
        loop {
            let sample = self.inbox.borrow_mut().pop_up_to(scan_id)?;
            if let Some(sample) = self.hand_over(sample) {
                return Some(sample);
            }
        }
    }

    pub(super) fn take_newest(&self) -> Option<Enclosed<Received>> {
        let sample = self.inbox.borrow_mut().pop_newest()?;
        self.hand_over(sample)
    }

    /// Notes that the process takes a sample, unless it may not have it.
    fn hand_over(&self, sample: Received) -> Option<Enclosed<Received>> {
        if self.shared.guard.refuses(self.of, &sample) {
            self.inbox.borrow_mut().settle(Fate::Foreign, &sample);
            return None;
        }
        self.note_taken(&sample);
        Some(Enclosed::new(sample))
    }

    pub(crate) fn next_scan(&self) -> Option<u64> {
        self.inbox.borrow().next_scan()
    }

    pub(crate) fn skip_to(&self, scan_id: u64) {
        self.skip(&|sample| (self.of.header)(sample).scan_id <= scan_id);
    }

    pub(crate) fn skip(&self, is_old: &dyn Fn(&[u8]) -> bool) {
        self.inbox.borrow_mut().skip(is_old);
    }

    /// Reports a sample whose content may not be used. One from a process that is not in charge is not reported.
    pub(crate) fn refuse(&self, header: &Header, fault: &Fault) {
        let counts = self.shared.directive.borrow().counts(self.of.topic, header);
        if counts && self.refusals.note(self.of.topic, header, fault) {
            self.shared.counters.is_urgent.set(true);
        }
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.refusals.of_content()
    }

    /// The type of its samples.
    pub(crate) fn of(&self) -> &'static SampleType {
        self.of
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
        self.inbox.borrow().is_empty()
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
        let (before, mut received, mut is_all) = (self.account(), 0, false);
        // Dropped samples return to their publisher at the end of each round only. A publisher has a limited number of
        // samples to borrow, so one that floods the topic can neither keep this loop busy nor, as the bus polls the
        // connections in a fixed order, hold up another's samples. So many rounds empty the longest queue.
        for _ in 0..capacity.div_ceil(self.qos.borrowed.saturating_sub(QUEUE_DEPTH + ASIDE_DEPTH).max(1)) {
            is_all = self.subscriber.receive_all(|sample| {
                received += 1;
                self.arrive(sample);
            })?;
            self.dropped.borrow_mut().clear();
            if is_all {
                break;
            }
        }
        if received >= capacity {
            self.inbox.borrow_mut().overflowed_since(&before, capacity as u64, is_all);
        }
        Ok(())
    }

    /// Filters the samples kept aside again, after the directive has changed.
    pub(crate) fn review(&self) {
        let rules = self.rules();
        self.inbox.borrow_mut().review(&rules, |arrival| self.settle(arrival));
        self.dropped.borrow_mut().clear();
    }

    /// The counters of all samples so far.
    pub(crate) fn account(&self) -> InputAccount {
        self.inbox.borrow().account()
    }

    /// Samples that were dropped or refused because of their content.
    pub(crate) fn refusal(&self) -> Refusal {
        self.refusals.newest()
    }

    /// What becomes of samples depends on this.
    fn rules(&self) -> InboxRules<'_> {
        let shared = &*self.shared;
        InboxRules {
            authority: shared.directive.borrow().authority_over(self.of.topic).copied(),
            known_scan: &shared.known_scan,
            polled_ns: self.polled_ns.get(),
            now_ns: shared.clock.now_ns(),
            period_ns: shared.period_ns,
            max_age_ns: shared.max_age_ns(),
            is_lockstep: shared.clock.is_simulated(),
            is_record: shared.guard.is_record(self.of),
        }
    }

    /// Counts a sample from the bus, and drops it when something is wrong with it.
    fn arrive(&self, sample: Received) {
        let arrival = self.inbox.borrow_mut().arrive(sample, &self.rules());
        if arrival.is_news && self.of.topic.writer().is_some() {
            self.shared.counters.is_urgent.set(true);
        }
        self.settle(arrival);
    }

    /// Reports what is wrong with a sample. What is dropped is returned at the end of this poll.
    fn settle(&self, arrival: InboxArrival<Received>) {
        let InboxArrival { fault, dropped, pushed_out, .. } = arrival;
        if let Some((fault, sample)) = fault.as_ref().zip(dropped.as_deref()) {
            self.refuse((self.of.header)(sample), fault);
        }
        self.dropped.borrow_mut().extend(dropped.into_iter().chain(pushed_out));
    }

    fn note_taken(&self, sample: &Received) {
        self.inbox.borrow_mut().settle(Fate::Used, sample);
        self.shared.taken(self.of.topic, (self.of.header)(sample));
    }
}

/// [`crate::join`] of samples of any two types.
pub(crate) fn join(one: &Reader, other: &Reader) -> Option<(Enclosed<Received>, Enclosed<Received>)> {
    let shared = &one.shared;
    let scan_id = one.inbox.borrow().joint_scan(
        &other.inbox.borrow(),
        |scans| shared.catches_up(scans),
        |header| shared.can_answer(header),
    )?;
    let first = one.inbox.borrow_mut().pop_scan(scan_id)?;
    let Some(second) = other.inbox.borrow_mut().pop_scan(scan_id) else {
        // Its publisher does not number scans in order.
        one.inbox.borrow_mut().settle(Fate::Replaced, &first);
        return None;
    };
    one.note_taken(&first);
    other.note_taken(&second);
    Some((Enclosed::new(first), Enclosed::new(second)))
}
