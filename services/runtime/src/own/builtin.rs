//! A topic of the loop as a companion reads it: copies of the samples that count, each once and in order.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use shared_types::{Fate, Fault, InputAccount, Role, Sample};

use super::member::Member;
use super::ports::Port;
use crate::{Bus, Observer, RuntimeError, monotonic_ns, wait_for};

/// Samples that wait to be taken; the oldest is dropped for a newer one.
const DEPTH: usize = 64;
/// How long one wait in lock-step lasts, at most [ns].
const LOCKSTEP_POLL_NS: u64 = 200_000;

/// Reads a topic of the loop.
pub struct LoopTopic<S: Sample>(Rc<Source<S>>);

pub(super) struct Source<S: Sample> {
    observer: Observer<S>,
    member: Rc<Member>,
    is_first: bool,
    kept: RefCell<VecDeque<S>>,
    port: RefCell<Port>,
    received: Cell<usize>,
}

/// What a companion sleeps on and polls, whatever its type.
pub(super) trait Feed {
    /// Sleeps until a sample may have come; false after a time-out.
    fn sleep(&self, timeout_ns: u64) -> bool;
    /// Takes the samples that have come.
    fn poll(&self) -> Result<(), RuntimeError>;
    /// Makes this end of all connections.
    fn connect(&self);
}

impl<S: Sample> LoopTopic<S> {
    pub(super) fn open(bus: &Bus, member: &Rc<Member>) -> Result<(Self, Rc<Source<S>>), RuntimeError> {
        let is_first = member.is_first(S::TOPIC.name());
        let observer = if is_first { Observer::waking(bus)? } else { Observer::new(bus)? };
        let kept = RefCell::new(VecDeque::with_capacity(DEPTH));
        let member = Rc::clone(member);
        let (port, received) = (member.port(S::TOPIC.name(), false), Cell::default());
        let source = Rc::new(Source { observer, member, is_first, kept, port, received });
        Ok((Self(Rc::clone(&source)), source))
    }

    /// The oldest sample that was not taken yet.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn take(&self) -> Result<Option<S>, RuntimeError> {
        if self.0.kept.borrow().is_empty() {
            self.0.poll()?;
        }
        let sample = self.0.kept.borrow_mut().pop_front();
        Ok(self.0.hand_over(sample))
    }

    /// The newest sample that was not taken; older ones are dropped. In real time it waits for nothing. In lock-step it
    /// waits for the sample of `scan_id`, and leaves samples of later scans.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn newest(&self, scan_id: u64) -> Result<Option<S>, RuntimeError> {
        self.0.await_scan(scan_id)?;
        let simulated = self.0.member.clock.is_simulated();
        Ok(self.0.take_last(|sample| !simulated || sample.header().scan_id <= scan_id))
    }

    /// The sample of one scan; samples before it are dropped. It waits as [`LoopTopic::newest`] does.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn by_scan(&self, scan_id: u64) -> Result<Option<S>, RuntimeError> {
        self.0.await_scan(scan_id)?;
        Ok(self.0.take_last(|sample| sample.header().scan_id == scan_id))
    }
}

impl<S: Sample> Source<S> {
    fn hand_over(&self, sample: Option<S>) -> Option<S> {
        if let Some(sample) = &sample {
            let header = sample.header();
            self.member.take(header, self.is_first);
            let port = &mut *self.port.borrow_mut();
            port.settle(Fate::Used, header);
            if !self.member.clock.is_simulated()
                && let Some(role) = S::TOPIC.writer()
            {
                let published_ns = match role {
                    Role::Robot => header.scan_published_ns(),
                    role => header.stage(role).published_ns,
                };
                port.delayed(published_ns, monotonic_ns());
            }
            port.show(self.kept.borrow().iter().map(Sample::header));
        }
        sample
    }

    fn take_last(&self, is_wanted: impl Fn(&S) -> bool) -> Option<S> {
        let sample = {
            let mut kept = self.kept.borrow_mut();
            let index = kept.iter().rposition(is_wanted)?;
            let port = &mut *self.port.borrow_mut();
            kept.drain(..index).for_each(|older| port.settle(Fate::Replaced, older.header()));
            kept.pop_front()
        };
        self.hand_over(sample)
    }

    fn await_scan(&self, scan_id: u64) -> Result<(), RuntimeError> {
        loop {
            self.poll()?;
            let member = &self.member;
            let is_there = self.kept.borrow().back().is_some_and(|sample| sample.header().scan_id >= scan_id);
            if is_there || !member.clock.is_simulated() || !member.is_waited_for() || member.is_over() {
                return Ok(());
            }
            wait_for(&[], LOCKSTEP_POLL_NS);
        }
    }

    fn arrive(&self, sample: &S, check: Result<(), Fault>) {
        self.received.set(self.received.get() + 1);
        let (header, report) = (sample.header(), &mut *self.member.report.borrow_mut());
        let port = &mut *self.port.borrow_mut();
        if matches!(check, Err(Fault::Layout { .. })) {
            port.account.unreadable += 1;
            report.invalid += 1;
            return;
        }
        let fate = port.account.arrive(header);
        // Checkpoints are relayed, so their numbers may come twice.
        if let Some(fate) = fate.filter(|_| S::TOPIC.writer().is_some()) {
            return port.settle(fate, header);
        }
        if check.is_err() {
            report.invalid += 1;
            return port.settle(Fate::Invalid, header);
        }
        if let Some(role) = S::TOPIC.writer()
            && !self.member.page.role(role).accepts(header.incarnation, header.scan_id)
        {
            report.foreign += 1;
            return port.settle(Fate::Foreign, header);
        }
        let mut kept = self.kept.borrow_mut();
        if kept.len() == DEPTH
            && let Some(oldest) = kept.pop_front()
        {
            port.settle(Fate::Replaced, oldest.header());
        }
        kept.push_back(*sample);
    }
}

impl<S: Sample> Feed for Source<S> {
    fn sleep(&self, timeout_ns: u64) -> bool {
        self.observer.wait(timeout_ns)
    }

    fn poll(&self) -> Result<(), RuntimeError> {
        let before = self.port.borrow().account;
        self.received.set(0);
        let is_all = self.observer.poll_checked(|sample, check| self.arrive(sample, check))?;
        let port = &mut *self.port.borrow_mut();
        if self.received.get() >= self.observer.capacity() {
            port.account.overflowed_since(&before, self.observer.capacity() as u64, is_all);
        }
        let gaps = |account: &InputAccount| account.missing + account.overwritten;
        let missed = gaps(&port.account).saturating_sub(gaps(&before));
        self.member.report.borrow_mut().missed += missed;
        port.show(self.kept.borrow().iter().map(Sample::header));
        Ok(())
    }

    fn connect(&self) {
        self.observer.connect();
    }
}
