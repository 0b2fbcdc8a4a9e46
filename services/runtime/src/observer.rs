//! Looking at topics, and speaking as the orchestrator, without being a process of the loop.

use std::cell::{Cell, RefCell};
use std::sync::Arc;

use iceoryx2::port::ReceiveError;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ipc;
use iceoryx2::sample::Sample as BusSample;
use shared_types::{Fault, Sample};

use crate::bell::{Bells, bit};
use crate::bus::{WirePublisher, WireSubscriber};
use crate::ear::{Ear, Ringer};
use crate::quality::quality;
use crate::wire::Wire;
use crate::{Bus, RuntimeError, monotonic_ns, wait_for};

/// Most goes at all producers in one look; more than the longest queue of a topic needs.
const GOES: usize = 32;

/// A sample, and whether its content may be used.
pub type Checked<S> = (S, Result<(), Fault>);

/// Copies samples of one topic; never slows the loop, because the oldest waiting sample is replaced.
pub struct Observer<S: Sample> {
    subscriber: WireSubscriber<S>,
    waking: Option<Waking>,
    borrowed: RefCell<Vec<BusSample<ipc::Service, Wire<S>, ()>>>,
}

/// What an observer sleeps on.
struct Waking {
    bells: Arc<Bells>,
    ear: Ear,
    seen: Cell<u32>,
}

impl<S: Sample> Observer<S> {
    /// Looks at the topic from now on; call [`Observer::poll`] often enough.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Self::with(bus, None)
    }

    /// Looks at the topic and can be slept on, see [`Observer::wait`].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn waking(bus: &Bus) -> Result<Self, RuntimeError> {
        let (bells, ear) = (Arc::clone(bus.bells()), Ear::new(bus, S::TOPIC)?);
        Self::with(bus, Some(Waking { bells, ear, seen: Cell::new(0) }))
    }

    fn with(bus: &Bus, waking: Option<Waking>) -> Result<Self, RuntimeError> {
        let borrowed = RefCell::new(Vec::with_capacity(quality(S::TOPIC).most_borrowed()));
        let subscriber = bus.subscriber::<S>()?;
        bus.allocate()?;
        Ok(Self { subscriber, waking, borrowed })
    }

    /// Sleeps until a sample may have come, or `timeout_ns` has passed; returns whether it ended before that. Without
    /// [`Observer::waking`] it always sleeps to the end.
    ///
    /// What came after the last [`Observer::poll`] or [`Observer::look`] had begun ends the sleep at once.
    pub fn wait(&self, timeout_ns: u64) -> bool {
        let Some(waking) = &self.waking else { return wait_for(&[], timeout_ns) };
        let bell = waking.bells.topic(S::TOPIC);
        let on = waking.ear.is_needed(false);
        if on && waking.ear.descriptor().is_none() {
            // What was notified before this is not heard: look first.
            waking.ear.listen(true);
            return true;
        }
        waking.ear.listen(on);
        let awake = match waking.ear.descriptor() {
            Some(descriptor) => bell.look() != waking.seen.get() || wait_for(&[descriptor], timeout_ns),
            None => bell.sleep(waking.seen.get(), monotonic_ns().saturating_add(timeout_ns), bit(S::TOPIC)),
        };
        if !awake {
            waking.ear.is_needed(true);
        }
        awake
    }

    /// Makes this end of all connections.
    pub fn connect(&self) {
        let _ = self.subscriber.update_connections();
    }

    /// The next sample, whatever its content; `None` when there is none now. Where a producer may flood the topic,
    /// [`Observer::look`] ends and this does not have to.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn next(&self) -> Result<Option<Checked<S>>, RuntimeError> {
        self.hear();
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
        self.look(|sample, check| match check {
            Ok(()) => each(sample),
            Err(_) => invalid += 1,
        })?;
        Ok(invalid)
    }

    /// Hands all samples that are there to `each`, with what is wrong with them.
    ///
    /// A producer that publishes without a pause holds up neither this call nor the samples of others: of each,
    /// what is borrowed in one go is followed by the next one's, and so many goes must do.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn look(&self, mut each: impl FnMut(&S, Result<(), Fault>)) -> Result<(), RuntimeError> {
        self.hear();
        for _ in 0..GOES {
            let mut borrowed = self.borrowed.borrow_mut();
            let is_all = loop {
                match self.subscriber.receive() {
                    Ok(Some(sample)) => {
                        each(&sample.payload().0, sample.payload().0.check());
                        borrowed.push(sample);
                    }
                    Ok(None) => break true,
                    Err(ReceiveError::ExceedsMaxBorrows) => break false,
                    Err(reason) => {
                        return Err(RuntimeError::bus(format!("receive from topic {}", S::TOPIC), reason));
                    }
                }
            };
            borrowed.clear();
            if is_all {
                break;
            }
        }
        Ok(())
    }

    /// What is rung or notified from here on was not seen yet.
    fn hear(&self) {
        if let Some(waking) = &self.waking {
            waking.seen.set(waking.bells.topic(S::TOPIC).look());
            waking.ear.clear();
        }
    }
}

/// Publishes samples that belong to no role: the orchestrator's directives and relayed checkpoints.
pub struct Voice<S: Sample> {
    publisher: WirePublisher<S>,
    ringer: Ringer,
    sequence: u64,
}

impl<S: Sample> Voice<S> {
    /// Opens the topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        let publisher = bus.publisher::<S>()?.0;
        bus.allocate()?;
        Ok(Self { publisher, ringer: Ringer::new(bus, S::TOPIC)?, sequence: 0 })
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
            self.ringer.look_for_listeners();
            self.ringer.ring();
        }
        Ok(())
    }
}
