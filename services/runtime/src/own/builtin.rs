//! A topic of the loop as a companion reads it: copies of the samples that count, each once and in order.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use shared_types::{Fault, Sample};

use super::member::Member;
use crate::{Bus, Observer, RuntimeError, wait_for};

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
    last: Cell<(u32, u64)>,
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
        let source = Rc::new(Source { observer, member, is_first, kept, last: Cell::default() });
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
            self.member.take(sample.header(), self.is_first);
        }
        sample
    }

    fn take_last(&self, is_wanted: impl Fn(&S) -> bool) -> Option<S> {
        let sample = {
            let mut kept = self.kept.borrow_mut();
            let index = kept.iter().rposition(is_wanted)?;
            kept.drain(..=index).next_back()
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
        let (header, report) = (sample.header(), &mut *self.member.report.borrow_mut());
        if check.is_err() {
            report.invalid += 1;
            return;
        }
        if let Some(role) = S::TOPIC.writer()
            && !self.member.page.role(role).accepts(header.incarnation, header.scan_id)
        {
            report.foreign += 1;
            return;
        }
        let (incarnation, sequence) = self.last.get();
        if S::TOPIC.writer().is_some() && incarnation == header.incarnation {
            if header.sequence <= sequence {
                return;
            }
            report.missed += header.sequence - sequence - 1;
        }
        self.last.set((header.incarnation, header.sequence));
        let mut kept = self.kept.borrow_mut();
        if kept.len() == DEPTH {
            kept.pop_front();
        }
        kept.push_back(*sample);
    }
}

impl<S: Sample> Feed for Source<S> {
    fn sleep(&self, timeout_ns: u64) -> bool {
        self.observer.wait(timeout_ns)
    }

    fn poll(&self) -> Result<(), RuntimeError> {
        self.observer.poll_checked(|sample, check| self.arrive(sample, check))
    }

    fn connect(&self) {
        self.observer.connect();
    }
}
