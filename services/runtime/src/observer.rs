//! Looking at topics, and speaking as the orchestrator, without being a process of the loop.

use std::os::fd::BorrowedFd;

use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ipc;
use shared_types::{Fault, Sample};

use crate::bus::{WirePublisher, WireSubscriber};
use crate::wake::{borrow, clear, descriptor};
use crate::wire::Wire;
use crate::{Bus, RuntimeError};

/// A sample, and whether its content may be used.
pub type Checked<S> = (S, Result<(), Fault>);

/// Copies samples of one topic; never slows the loop, because the oldest waiting sample is replaced.
pub struct Observer<S: Sample> {
    subscriber: WireSubscriber<S>,
    listener: Option<Listener<ipc::Service>>,
}

impl<S: Sample> Observer<S> {
    /// Looks at the topic from now on; call [`Observer::poll`] often enough.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self { subscriber: bus.subscriber::<S>()?, listener: None })
    }

    /// Looks at the topic and can be waited on, see [`Observer::descriptor`].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn waking(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self { subscriber: bus.subscriber::<S>()?, listener: Some(bus.listener(S::TOPIC)?) })
    }

    /// Readable when a sample may have come; only for [`Observer::waking`].
    pub fn descriptor(&self) -> Option<BorrowedFd<'_>> {
        self.listener.as_ref().map(|listener| borrow(descriptor(listener)))
    }

    /// Makes this end of all connections.
    pub fn connect(&self) {
        let _ = self.subscriber.update_connections();
    }

    /// The next sample, whatever its content; `None` when there is none now.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn next(&self) -> Result<Option<Checked<S>>, RuntimeError> {
        if let Some(listener) = &self.listener {
            clear(listener);
        }
        let error = |reason| RuntimeError::bus(format!("receive from topic {}", S::TOPIC), reason);
        let sample = self.subscriber.receive().map_err(error)?;
        Ok(sample.map(|sample| (sample.payload().0, sample.payload().0.check())))
    }

    /// Hands all valid samples that are there to `each`; returns how many were invalid.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn poll(&self, mut each: impl FnMut(&S)) -> Result<u64, RuntimeError> {
        let mut invalid = 0;
        while let Some((sample, check)) = self.next()? {
            match check {
                Ok(()) => each(&sample),
                Err(_) => invalid += 1,
            }
        }
        Ok(invalid)
    }
}

/// Publishes samples that belong to no role: the orchestrator's directives and relayed checkpoints.
pub struct Voice<S: Sample> {
    publisher: WirePublisher<S>,
    notifier: Notifier<ipc::Service>,
    sequence: u64,
}

impl<S: Sample> Voice<S> {
    /// Opens the topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self { publisher: bus.publisher::<S>()?.0, notifier: bus.notifier(S::TOPIC)?, sequence: 0 })
    }

    /// Publishes, and wakes the readers when `wake`. Layout and sequence are filled here.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn say(&mut self, sample: &mut S, wake: bool) -> Result<(), RuntimeError> {
        self.sequence += 1;
        sample.header_mut().layout = S::LAYOUT;
        sample.header_mut().sequence = self.sequence;
        self.say_as_it_is(sample, wake)
    }

    /// Publishes a sample whose header is complete, right or wrong: for tests of those who read it.
    ///
    /// # Errors
    /// As [`Voice::say`].
    pub fn say_as_it_is(&mut self, sample: &S, wake: bool) -> Result<(), RuntimeError> {
        let error =
            |reason: &dyn std::fmt::Debug| RuntimeError::bus(format!("publish topic {}", S::TOPIC), reason);
        let loaned = self.publisher.loan_uninit().map_err(|reason| error(&reason))?;
        loaned.write_payload(Wire(*sample)).send().map_err(|reason| error(&reason))?;
        if wake {
            let _ = self.notifier.notify();
        }
        Ok(())
    }
}
