//! The reading end of a topic of your own, for samples of any type.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::os::fd::BorrowedFd;
use std::rc::Rc;

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use shared_types::{Fate, Fault, Header, InputAccount, OwnType, StageStamps, require_sequence};

use super::member::{Member, Source};
use super::ports::Port;
use super::table::{OwnTopics, TopicRow};
use crate::enclosed::Enclosed;
use crate::port::{ByteSubscriber, Queue, Received};
use crate::wake::{borrow, clear, descriptor, wait_for};
use crate::{Bus, RuntimeError, monotonic_ns};

/// How long one wait for a companion in lock-step lasts, at most [ns].
const LOCKSTEP_POLL_NS: u64 = 200_000;
/// Queues that one poll empties, at most: a writer that floods the topic can't keep its reader busy.
const MAX_QUEUES: usize = 4;

/// Reads samples of one type, as bytes.
pub(crate) struct OwnReader {
    row: TopicRow,
    layout: u32,
    numbers: Vec<usize>,
    source: Source,
    is_first: bool,
    max_age_ns: Option<u64>,
    subscriber: ByteSubscriber,
    listener: Listener<ipc::Service>,
    member: Rc<Member>,
    kept: RefCell<VecDeque<Received>>,
    port: RefCell<Port>,
    /// When the bus was polled before and last [ns].
    polled_ns: Cell<[u64; 2]>,
    /// Incarnation and scan of the sample that was kept last.
    last: Cell<(u32, u64)>,
}

impl OwnReader {
    pub(super) fn new(bus: &Bus, member: &Rc<Member>, row: TopicRow) -> Result<Rc<Self>, RuntimeError> {
        let (own, shape) = row.shape()?;
        let events = bus.events(&row.name)?;
        let listener = events.listener_builder().create();
        let listener =
            listener.map_err(|reason| RuntimeError::bus(format!("listen to topic {}", row.name), reason))?;
        Ok(Rc::new(Self {
            layout: own.layout(),
            numbers: own.numbers(),
            source: member.source(&row),
            is_first: member.is_first(&row.name),
            max_age_ns: member.max_age_ns(&row.name),
            subscriber: bus.subscriber_of(&shape, Queue::Observer, 0)?,
            listener,
            member: Rc::clone(member),
            kept: RefCell::new(VecDeque::with_capacity(row.queue)),
            port: member.port(&row.name, false),
            polled_ns: Cell::default(),
            last: Cell::default(),
            row,
        }))
    }

    /// Readable when a sample may have come.
    pub(super) fn descriptor(&self) -> BorrowedFd<'_> {
        borrow(descriptor(&self.listener))
    }

    /// Takes all samples from the bus and keeps the valid ones.
    pub(super) fn poll(&self) -> Result<(), RuntimeError> {
        clear(&self.listener);
        self.polled_ns.set([self.polled_ns.get()[1], monotonic_ns()]);
        let (before, mut received) = (self.port.borrow().account, 0);
        while received < MAX_QUEUES * self.row.queue {
            let Some(sample) = self.subscriber.receive()? else { break };
            received += 1;
            self.arrive(sample);
        }
        if received >= self.row.queue {
            let is_all = received < MAX_QUEUES * self.row.queue;
            self.port.borrow_mut().account.overflowed_since(&before, self.row.queue as u64, is_all);
        }
        self.show();
        let gaps = |account: &InputAccount| account.missing + account.overwritten;
        let missed = gaps(&self.port.borrow().account).saturating_sub(gaps(&before));
        self.member.report.borrow_mut().missed += missed;
        Ok(())
    }

    /// The oldest sample that was not taken.
    pub(super) fn take(&self) -> Result<Option<Enclosed<Received>>, RuntimeError> {
        if self.kept.borrow().is_empty() {
            self.poll()?;
        }
        let sample = self.kept.borrow_mut().pop_front();
        Ok(sample.map(|sample| self.hand_over(sample)))
    }

    /// The newest sample of a scan up to `scan_id`; in real time the newest that has come.
    pub(super) fn newest(&self, scan_id: u64) -> Result<Option<Enclosed<Received>>, RuntimeError> {
        self.await_scan(scan_id)?;
        let is_wanted = |sample: &Received| !self.is_simulated() || header_of(sample).scan_id <= scan_id;
        Ok(self.take_last(is_wanted))
    }

    /// The oldest sample of a scan up to `scan_id`; in real time the oldest that has come.
    pub(super) fn up_to(&self, scan_id: u64) -> Result<Option<Enclosed<Received>>, RuntimeError> {
        self.await_scan(scan_id)?;
        let mut kept = self.kept.borrow_mut();
        let is_wanted = |sample: &Received| !self.is_simulated() || header_of(sample).scan_id <= scan_id;
        let sample = if kept.front().is_some_and(is_wanted) { kept.pop_front() } else { None };
        drop(kept);
        Ok(sample.map(|sample| self.hand_over(sample)))
    }

    /// The sample of one scan.
    pub(super) fn by_scan(&self, scan_id: u64) -> Result<Option<Enclosed<Received>>, RuntimeError> {
        self.await_scan(scan_id)?;
        Ok(self.take_last(|sample| header_of(sample).scan_id == scan_id))
    }

    fn is_simulated(&self) -> bool {
        self.member.clock.is_simulated()
    }

    /// The last sample that is wanted; those before it are dropped, those behind it stay.
    fn take_last(&self, is_wanted: impl Fn(&Received) -> bool) -> Option<Enclosed<Received>> {
        let mut kept = self.kept.borrow_mut();
        let index = kept.iter().rposition(is_wanted)?;
        kept.drain(..index).for_each(|older| self.settle(Fate::Replaced, &older));
        let sample = kept.pop_front()?;
        drop(kept);
        Some(self.hand_over(sample))
    }

    fn hand_over(&self, sample: Received) -> Enclosed<Received> {
        self.settle(Fate::Used, &sample);
        self.member.take(header_of(&sample), self.is_first);
        if !self.is_simulated() {
            self.port.borrow_mut().delayed(published_ns(&sample), monotonic_ns());
        }
        self.show();
        Enclosed::new(sample)
    }

    /// In lock-step, waits until the writer is done with the scan, has left the grants, or the system ends.
    fn await_scan(&self, scan_id: u64) -> Result<(), RuntimeError> {
        loop {
            let (holds, answered) = match self.source {
                Source::Companion(index) if self.is_simulated() => self.member.page.progress(index),
                _ => (false, 0),
            };
            // After the progress was read: what was published before it is here.
            self.poll()?;
            if !holds || answered >= scan_id || !self.member.is_waited_for() || self.member.is_over() {
                return Ok(());
            }
            wait_for(&[self.descriptor()], LOCKSTEP_POLL_NS);
        }
    }

    fn arrive(&self, sample: Received) {
        let header = header_of(&sample);
        let report = &mut *self.member.report.borrow_mut();
        if header.layout != self.layout || self.judge_numbers(header).is_err() {
            self.port.borrow_mut().account.unreadable += 1;
            report.invalid += 1;
            return;
        }
        let fate = self.port.borrow_mut().account.arrive(header);
        if let Some(fate) = fate {
            return self.settle(fate, &sample);
        }
        if !self.is_finite(&sample) {
            report.invalid += 1;
            return self.settle(Fate::Invalid, &sample);
        }
        let (incarnation, scan) = self.last.get();
        if let Source::Companion(index) = self.source {
            let authority = self.member.page.companion(index);
            let is_answered = incarnation != header.incarnation && header.scan_id <= scan;
            // A successor does not answer again what the process before it has answered.
            if !authority.accepts(header.incarnation, header.scan_id)
                || (is_answered && authority.previous != 0)
            {
                report.foreign += 1;
                return self.settle(Fate::Foreign, &sample);
            }
        }
        self.last.set((header.incarnation, header.scan_id));
        if self.max_age_ns.is_some_and(|limit| age_ns(&sample) > limit) {
            return self.settle(Fate::Stale, &sample);
        }
        let mut kept = self.kept.borrow_mut();
        if kept.len() == self.row.queue
            && let Some(oldest) = kept.pop_front()
        {
            self.settle(Fate::Replaced, &oldest);
        }
        kept.push_back(sample);
    }

    /// Passes when a scan and a sample can have the numbers of a header by now.
    fn judge_numbers(&self, header: &Header) -> Result<(), Fault> {
        header.check_numbers()?;
        let [before_ns, now_ns] = self.polled_ns.get();
        let port = self.port.borrow();
        let span = port.account.from(header.incarnation);
        let (newest, since_ns) = span.map_or((0, 0), |span| (span.last, before_ns));
        require_sequence(header.sequence, newest, now_ns.saturating_sub(since_ns))
    }

    fn settle(&self, fate: Fate, sample: &[u8]) {
        self.port.borrow_mut().settle(fate, header_of(sample));
    }

    /// Shows the counts to the orchestrator.
    fn show(&self) {
        self.port.borrow_mut().show(self.kept.borrow().iter().map(|sample| header_of(sample)));
    }

    fn is_finite(&self, sample: &[u8]) -> bool {
        self.numbers
            .iter()
            .all(|at| bytemuck::pod_read_unaligned::<f64>(&sample[*at..at + size_of::<f64>()]).is_finite())
    }
}

fn header_of(sample: &[u8]) -> &Header {
    bytemuck::from_bytes(&sample[..size_of::<Header>()])
}

/// When a sample was published [ns].
fn published_ns(sample: &[u8]) -> u64 {
    let stage = &sample[sample.len() - size_of::<StageStamps>()..];
    bytemuck::pod_read_unaligned::<StageStamps>(stage).published_ns
}

/// The time since a sample was measured, or published when that is not known [ns].
fn age_ns(sample: &[u8]) -> u64 {
    let acquired_ns = header_of(sample).acquired_ns;
    monotonic_ns().saturating_sub(if acquired_ns > 0 { acquired_ns } else { published_ns(sample) })
}

/// Observes a topic of your own without being a process: for tools and the orchestrator.
pub struct OwnObserver {
    own: OwnType,
    subscriber: Enclosed<ByteSubscriber>,
}

impl OwnObserver {
    /// Observes the topic from now on.
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`], and [`RuntimeError::Bus`] when it can't be opened.
    pub fn new(bus: &Bus, table: &OwnTopics, topic: &str) -> Result<Self, RuntimeError> {
        let unknown = || RuntimeError::NoOwnTopic { process: "observer".to_owned(), topic: topic.to_owned() };
        let (own, shape) = table.find(topic).ok_or_else(unknown)?.shape()?;
        let subscriber = Enclosed::new(bus.subscriber_of(&shape, Queue::Observer, 0)?);
        bus.allocate()?;
        Ok(Self { own, subscriber })
    }

    /// The type of the samples.
    pub fn own_type(&self) -> &OwnType {
        &self.own
    }

    /// Makes this end of all connections.
    pub fn connect(&self) {
        self.subscriber.connect();
    }

    /// Copies the next sample, whatever its content; `None` when there is none now.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn next(&self) -> Result<Option<Vec<u8>>, RuntimeError> {
        Ok(self.subscriber.receive()?.map(|sample| sample.to_vec()))
    }
}
