//! The writing end of a topic.
#![expect(unsafe_code, reason = "samples written in place begin as bytes of older ones")]

use std::cell::Cell;
use std::rc::Rc;

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ipc;
use iceoryx2::service::port_factory::{PortFactory, publish_subscribe};
use shared_types::{Role, Sample};

use crate::bus::WirePublisher;
use crate::counters::count;
use crate::ear::Ringer;
use crate::process::Shared;
use crate::wire::Wire;
use crate::{Bus, RuntimeError};

/// Publishes samples of one type.
pub struct Output<S: Sample> {
    publisher: WirePublisher<S>,
    service: publish_subscribe::PortFactory<ipc::Service, Wire<S>, ()>,
    ringer: Ringer,
    shared: Rc<Shared>,
    sequence: Cell<u64>,
}

impl<S: Sample> Output<S> {
    pub(crate) fn new(bus: &Bus, shared: Rc<Shared>) -> Result<Self, RuntimeError> {
        let (publisher, service) = bus.publisher::<S>()?;
        Ok(Self { publisher, service, ringer: Ringer::new(bus, S::TOPIC)?, shared, sequence: Cell::new(0) })
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
        let loaned = self.publisher.loan_uninit().map_err(|reason| bus_error::<S>("loan", reason))?;
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
        self.stamp(sample);
        let loaned = self.publisher.loan_uninit().map_err(|reason| bus_error::<S>("loan", reason))?;
        let delivered = loaned.write_payload(Wire(*sample)).send();
        self.account(delivered.map_err(|reason| bus_error::<S>("send", reason))?);
        Ok(())
    }

    fn stamp(&self, sample: &mut S) {
        let shared = &*self.shared;
        if S::TOPIC.writer() == Some(shared.role) {
            sample.header_mut().stage_mut(shared.role).published_ns = shared.clock.now_ns();
            shared.produced.set(true);
            shared.worked.set(true);
        }
    }

    fn account(&self, delivered: usize) {
        if delivered < self.service.dynamic_config().number_of_subscribers() {
            count(&self.shared.counters.undelivered, 1);
        }
    }

    /// The last step of [`Output::publish`]: wakes the readers.
    pub fn wake(&self) {
        self.ringer.ring();
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
}

impl<S: Sample> Connect for Output<S> {
    fn connect(&self) {
        Self::connect(self);
    }
}

fn bus_error<S: Sample>(action: &str, reason: impl std::fmt::Debug) -> RuntimeError {
    RuntimeError::bus(format!("{action} a sample of topic {}", S::TOPIC), reason)
}

/// Whether a topic belongs to the writes of a role, or is one that every process writes.
pub(crate) fn may_write(role: Role, topic: shared_types::Topic) -> bool {
    topic.writer().is_none() || topic.writer() == Some(role)
}
