//! The writing end of a topic for samples of any type.
#![expect(unsafe_code, reason = "shared memory is touched without changing it")]

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use bytemuck::bytes_of_mut;
use shared_types::{Journal, Role, SampleType, Topic};

use super::filter::Filter;
use crate::bell::LINE;
use crate::counters::count;
use crate::journal::Publish;
use crate::port::{BytePublisher, Loan};
use crate::shared::Shared;
use crate::waiter::Ringer;
use crate::{Bus, RuntimeError};

/// Of a large sample only this much is warmed up [bytes].
const WARMED: usize = 16_384;

/// Publishes samples of one type, which it is given as bytes.
pub(crate) struct Writer {
    of: &'static SampleType,
    // Dropped before its publisher.
    next: RefCell<Option<Loan>>,
    publisher: BytePublisher,
    ringer: Ringer,
    shared: Rc<Shared>,
    sequence: Cell<u64>,
    /// How many readers there were when last counted.
    readers: Cell<usize>,
    filter: Filter,
}

impl Writer {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>, of: &'static SampleType) -> Result<Self, RuntimeError> {
        Ok(Self {
            of,
            next: RefCell::new(None),
            publisher: bus.publisher(of)?,
            ringer: Ringer::new(bus, of.topic)?,
            filter: Filter::new(of, Rc::clone(&shared)),
            shared,
            sequence: Cell::new(0),
            readers: Cell::new(usize::MAX),
        })
    }

    pub(crate) fn publish(&self, sample: &mut [u8]) -> Result<(), RuntimeError> {
        self.publish_silently(sample)?;
        self.wake();
        Ok(())
    }

    pub(super) fn publish_silently(&self, sample: &mut [u8]) -> Result<(), RuntimeError> {
        self.complete(sample);
        self.send(sample)
    }

    pub(super) fn publish_in_place(&self, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), RuntimeError> {
        let mut place = self.loan()?;
        let sample = place.bytes();
        fill(sample);
        self.complete(sample);
        self.publish_journal(sample);
        self.stamp(sample);
        if self.filter.leave(sample) {
            self.send_place(place)?;
        }
        self.wake();
        Ok(())
    }

    pub(super) fn complete(&self, sample: &mut [u8]) {
        let (of, shared) = (self.of, &*self.shared);
        self.filter.enter(sample);
        let is_answer = (of.is_answer)(sample);
        let header = (of.header_mut)(sample);
        self.sequence.set(self.sequence.get() + 1);
        header.layout = of.layout;
        header.incarnation = shared.incarnation;
        header.sequence = self.sequence.get();
        if of.topic.writer() == Some(shared.role) {
            let stage = header.stage_mut(shared.role);
            *stage = shared.stamps.get();
            stage.computed_ns = shared.clock.now_ns();
            shared.counters.write(shared.role, of.topic, header, is_answer);
            if shared.role == Role::Robot {
                shared.note_scan(header);
            }
        }
    }

    pub(super) fn send(&self, sample: &mut [u8]) -> Result<(), RuntimeError> {
        self.publish_journal(sample);
        let mut place = self.loan()?;
        self.stamp(sample);
        if !self.filter.leave(sample) {
            return Ok(());
        }
        place.bytes().copy_from_slice(sample);
        self.send_place(place)
    }

    pub(super) fn wake(&self) {
        self.ringer.ring();
        self.take_place();
        self.shared.notes.take_next_place();
    }

    /// Takes the place of the next sample.
    fn take_place(&self) {
        let mut next = self.next.borrow_mut();
        if next.is_none() {
            *next = self.publisher.loan().ok();
        }
    }

    /// Before the first output of the role for a scan: what it follows from.
    fn publish_journal(&self, sample: &[u8]) {
        if self.shared.role.writes().first() == Some(&self.of.topic) {
            let header = (self.of.header)(sample);
            self.shared.notes.publish(header.scan_id, header.sequence);
        }
    }

    fn stamp(&self, sample: &mut [u8]) {
        let shared = &*self.shared;
        if self.of.topic.writer() == Some(shared.role) {
            (self.of.header_mut)(sample).stage_mut(shared.role).published_ns = shared.answered();
        }
    }

    fn loan(&self) -> Result<Loan, RuntimeError> {
        match self.next.borrow_mut().take() {
            Some(place) => Ok(place),
            None => self.publisher.loan().map_err(|reason| self.error("loan", reason)),
        }
    }

    fn send_place(&self, place: Loan) -> Result<(), RuntimeError> {
        let delivered = place.send().map_err(|reason| self.error("send", reason))?;
        self.filter.sent();
        if delivered != self.readers.get() {
            // Counted only now: the list of readers lies in memory that nothing else needs.
            self.readers.set(self.publisher.subscribers());
            count(&self.shared.counters.undelivered, u64::from(delivered < self.readers.get()));
        }
        Ok(())
    }

    fn error(&self, action: &str, reason: impl std::fmt::Debug) -> RuntimeError {
        RuntimeError::bus(format!("{action} a sample of topic {}", self.of.topic), reason)
    }
}

/// An output as its process sees it.
pub(crate) trait Connect {
    /// Makes this end of all connections.
    fn connect(&self);
    /// Counts the readers of the topic, and those that listen to its events.
    fn poll_listeners(&self) {}
    /// Loads what the next sample will need into the caches.
    fn warm_up(&self) {
        self.connect();
    }
}

impl<F: Fn()> Connect for F {
    fn connect(&self) {
        self();
    }
}

impl Publish for Writer {
    fn publish(&self, journal: &mut Journal) {
        let _ = self.publish_silently(bytes_of_mut(journal));
    }

    fn take_next_place(&self) {
        self.take_place();
    }
}

impl Connect for Writer {
    fn connect(&self) {
        self.publisher.connect();
    }

    fn poll_listeners(&self) {
        self.readers.set(self.publisher.subscribers());
        self.ringer.poll_listeners();
    }

    fn warm_up(&self) {
        self.connect();
        let mut next = self.next.borrow_mut();
        *next = None;
        if let Ok(mut place) = self.publisher.loan() {
            warm(place.bytes());
            *next = Some(place);
        }
    }
}

/// Rewrites one byte of each cache line with its own value, so that the processor holds the line for writing.
fn warm(place: &mut [u8]) {
    for byte in place.iter_mut().take(WARMED).step_by(LINE) {
        // SAFETY: a reference to a byte may be read and written.
        unsafe {
            let byte = std::ptr::from_mut(byte);
            byte.write_volatile(byte.read_volatile());
        }
    }
}

/// Whether a role writes a topic, or every process does.
pub(crate) fn may_write(role: Role, topic: Topic) -> bool {
    topic.writer().is_none() || topic.writer() == Some(role)
}
