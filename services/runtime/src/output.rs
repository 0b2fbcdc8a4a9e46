//! The writing end of a topic.
#![expect(unsafe_code, reason = "samples are written in shared memory, which holds bytes of older ones")]

use std::cell::{Cell, RefCell};
use std::mem::MaybeUninit;
use std::rc::Rc;

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ipc;
use iceoryx2::sample_mut_uninit::SampleMutUninit;
use iceoryx2::service::port_factory::{PortFactory, publish_subscribe};
use shared_types::{Role, Sample, Topic};

use crate::bell::LINE;
use crate::bus::WirePublisher;
use crate::counters::count;
use crate::ear::Ringer;
use crate::process::Shared;
use crate::wire::Wire;
use crate::{Bus, RuntimeError};

/// Of a large sample only the beginning is kept in the caches [bytes].
const WARMED: usize = 16_384;

/// A place in shared memory that is not written yet.
type Loaned<S> = SampleMutUninit<ipc::Service, MaybeUninit<Wire<S>>, ()>;

/// Publishes samples of one type.
pub struct Output<S: Sample> {
    // Dropped before its publisher.
    next: RefCell<Option<Loaned<S>>>,
    publisher: WirePublisher<S>,
    service: publish_subscribe::PortFactory<ipc::Service, Wire<S>, ()>,
    ringer: Ringer,
    shared: Rc<Shared>,
    sequence: Cell<u64>,
    /// How many readers there were when it was looked up last.
    readers: Cell<usize>,
}

impl<S: Sample> Output<S> {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        let (publisher, service) = bus.publisher::<S>()?;
        let ringer = Ringer::new(bus, S::TOPIC)?;
        Ok(Self {
            next: RefCell::new(None),
            publisher,
            service,
            ringer,
            shared,
            sequence: Cell::new(0),
            readers: Cell::new(usize::MAX),
        })
    }

    /// Completes the header of `sample` and publishes it to all readers, then wakes them.
    ///
    /// Filled here: layout, incarnation, sequence, and the stamps of this stage. The sample keeps what was filled.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses; a reader that was not reached is counted, not an error.
    pub fn publish(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.publish_silently(sample)?;
        self.wake();
        Ok(())
    }

    /// [`Output::publish`] without waking anyone: for samples that are looked at from time to time.
    ///
    /// # Errors
    /// As [`Output::publish`].
    pub fn publish_silently(&self, sample: &mut S) -> Result<(), RuntimeError> {
        self.complete(sample);
        self.send(sample)
    }

    /// [`Output::publish`] of a sample that `fill` writes where it will be read: for samples too large to be copied.
    ///
    /// What `fill` leaves as it is holds the bytes of an older sample.
    ///
    /// # Errors
    /// As [`Output::publish`].
    pub fn publish_in_place(&self, fill: impl FnOnce(&mut S)) -> Result<(), RuntimeError> {
        let loaned = self.loan()?;
        // SAFETY: the bytes are shared memory, which the kernel hands out zeroed and samples were written to since: they
        // have values, and a sample is `Pod`, so that all values are valid.
        let mut loaned = unsafe { loaned.assume_init() };
        let sample = &mut loaned.payload_mut().0;
        fill(sample);
        self.complete(sample);
        self.stamp(sample);
        self.account(loaned.send().map_err(|reason| bus_error::<S>("send", reason))?);
        self.wake();
        Ok(())
    }

    /// The first step of [`Output::publish`]: the result is there. Everything of the header but its last stamp is
    /// filled; from here on the number of the sample is used up.
    pub fn complete(&self, sample: &mut S) {
        let shared = &*self.shared;
        shared.guard.hold_back(sample);
        self.sequence.set(self.sequence.get() + 1);
        let header = sample.header_mut();
        header.layout = S::LAYOUT;
        header.incarnation = shared.incarnation;
        header.sequence = self.sequence.get();
        if S::TOPIC.writer() == Some(shared.role) {
            let stage = header.stage_mut(shared.role);
            *stage = shared.stamps.get();
            stage.computed_ns = shared.clock.now_ns();
            shared.counters.write(shared.role, sample);
        }
    }

    /// The second step of [`Output::publish`]: sends a completed sample to all readers.
    ///
    /// # Errors
    /// As [`Output::publish`].
    pub fn send(&self, sample: &mut S) -> Result<(), RuntimeError> {
        let mut loaned = self.loan()?;
        self.stamp(sample);
        loaned.payload_mut().write(Wire(*sample));
        // SAFETY: written in the line before; this way it is copied once, not by way of the stack.
        let delivered = unsafe { loaned.assume_init() }.send();
        self.account(delivered.map_err(|reason| bus_error::<S>("send", reason))?);
        Ok(())
    }

    fn stamp(&self, sample: &mut S) {
        let shared = &*self.shared;
        if S::TOPIC.writer() == Some(shared.role) {
            sample.header_mut().stage_mut(shared.role).published_ns = shared.answered();
        }
    }

    fn account(&self, delivered: usize) {
        if S::TOPIC == Topic::Actuation && self.shared.is_in_charge() {
            self.shared.guard.tell();
        }
        if delivered != self.readers.get() {
            // Looked up now only: the list of readers lies in memory that nothing else needs.
            self.readers.set(self.service.dynamic_config().number_of_subscribers());
            count(&self.shared.counters.undelivered, u64::from(delivered < self.readers.get()));
        }
    }

    /// The last step of [`Output::publish`]: wakes the readers. Then nobody waits for this process, and it looks for the
    /// place of the next sample.
    pub fn wake(&self) {
        self.ringer.ring();
        let mut next = self.next.borrow_mut();
        if next.is_none() {
            *next = self.publisher.loan_uninit().ok();
        }
    }

    fn loan(&self) -> Result<Loaned<S>, RuntimeError> {
        match self.next.borrow_mut().take() {
            Some(loaned) => Ok(loaned),
            None => self.publisher.loan_uninit().map_err(|reason| bus_error::<S>("loan", reason)),
        }
    }

    pub(crate) fn connect(&self) {
        // A connection that fails now is tried again at the next send.
        let _ = self.publisher.update_connections();
    }
}

/// An output as its process sees it.
pub(crate) trait Connect {
    /// Makes this end of all connections.
    fn connect(&self);
    /// Notes how many read the topic, and whether anybody listens to its events.
    fn look_for_listeners(&self) {}
    /// Touches what the next sample will need.
    fn rehearse(&self) {
        self.connect();
    }
}

impl<S: Sample> Connect for Output<S> {
    fn connect(&self) {
        Self::connect(self);
    }

    fn look_for_listeners(&self) {
        self.readers.set(self.service.dynamic_config().number_of_subscribers());
        self.ringer.look_for_listeners();
    }

    fn rehearse(&self) {
        Self::connect(self);
        let mut next = self.next.borrow_mut();
        *next = None;
        if let Ok(mut loaned) = self.publisher.loan_uninit() {
            warm(loaned.payload_mut());
            *next = Some(loaned);
        }
    }
}

/// Writes one byte of each cache line, the one that is there, so that the processor has the line and may write it.
fn warm<S>(place: &mut MaybeUninit<S>) {
    let bytes = std::ptr::from_mut(place).cast::<u8>();
    for offset in (0..size_of::<S>().min(WARMED)).step_by(LINE) {
        // SAFETY: inside of the place, which is borrowed for writing; it is shared memory, whose bytes have values.
        unsafe {
            let byte = bytes.add(offset);
            byte.write_volatile(byte.read_volatile());
        }
    }
}

fn bus_error<S: Sample>(action: &str, reason: impl std::fmt::Debug) -> RuntimeError {
    RuntimeError::bus(format!("{action} a sample of topic {}", S::TOPIC), reason)
}

/// Whether a topic belongs to the writes of a role, or is one that every process writes.
pub(crate) fn may_write(role: Role, topic: shared_types::Topic) -> bool {
    topic.writer().is_none() || topic.writer() == Some(role)
}
