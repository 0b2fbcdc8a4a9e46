//! Reading topics as an observer, and publishing as the orchestrator, without being a process of the loop.
#![expect(unsafe_code, reason = "publishers that move from one thread to another")]

use std::cell::{Cell, RefCell};
use std::marker::PhantomData;
use std::sync::Arc;

use bytemuck::{bytes_of, bytes_of_mut};
use shared_types::{Fault, Sample, SampleType, Topic};

use crate::bell::{Bells, bit};
use crate::enclosed::Enclosed;
use crate::port::{BytePublisher, ByteSubscriber, Queue, Received};
use crate::qos::qos;
use crate::view::view;
use crate::waiter::{Ringer, Waiter};
use crate::{Bus, Domain, RuntimeError, monotonic_ns, wait_for};

/// Rounds over all publishers in one poll, at most; more than the longest queue of a topic needs.
const MAX_ROUNDS: usize = 64;

/// A sample, and whether its content may be used.
pub type Checked<S> = (S, Result<(), Fault>);

/// Copies samples of one topic. It never slows the loop, because a full queue replaces its oldest sample.
pub struct Observer<S: Sample>(Enclosed<Source>, PhantomData<S>);

impl<S: Sample> Observer<S> {
    /// Observes the topic from now on; call [`Observer::poll`] before the queue is full.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Source::open(bus, S::TYPE, false).map(|source| Self(source, PhantomData))
    }

    /// An observer that samples wake, see [`Observer::wait`].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn waking(bus: &Bus) -> Result<Self, RuntimeError> {
        Source::open(bus, S::TYPE, true).map(|source| Self(source, PhantomData))
    }

    /// Sleeps until a sample may have come, or `timeout_ns` has passed; returns whether it ended before that. Without
    /// [`Observer::waking`] it always sleeps for `timeout_ns`.
    ///
    /// A sample that came since the start of the last [`Observer::poll`] or [`Observer::poll_checked`] ends it at
    /// once.
    pub fn wait(&self, timeout_ns: u64) -> bool {
        self.0.wait(timeout_ns)
    }

    /// Makes this end of all connections.
    pub fn connect(&self) {
        self.0.subscriber.connect();
    }

    /// How many samples of one publisher can wait here. A poll that finds fewer has missed none.
    pub fn capacity(&self) -> usize {
        self.0.subscriber.capacity()
    }

    /// The next sample, whatever its content; `None` when there is none now. A loop over it may never end where a
    /// publisher floods the topic; [`Observer::poll_checked`] always ends.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn next(&self) -> Result<Option<Checked<S>>, RuntimeError> {
        let sample = self.0.next()?;
        Ok(sample.map(|sample| (*view::<S>(&sample), view::<S>(&sample).check())))
    }

    /// Hands all waiting valid samples to `each`; returns how many were invalid.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn poll(&self, mut each: impl FnMut(&S)) -> Result<u64, RuntimeError> {
        let mut invalid = 0;
        self.poll_checked(|sample, check| match check {
            Ok(()) => each(sample),
            Err(_) => invalid += 1,
        })?;
        Ok(invalid)
    }

    /// Hands all waiting samples to `each`, with the result of their check; returns whether none waits any more.
    ///
    /// A publisher that floods the topic delays neither this call nor the samples of others: each round takes a
    /// limited number of samples per publisher, and the number of rounds is limited.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn poll_checked(&self, mut each: impl FnMut(&S, Result<(), Fault>)) -> Result<bool, RuntimeError> {
        self.0.poll(&mut |sample| {
            let sample = view::<S>(sample);
            each(sample, sample.check());
        })
    }
}

/// Copies samples of one topic as bytes: for observers of all topics.
pub struct TopicObserver(Enclosed<Source>);

impl TopicObserver {
    /// Observes the topic from now on; call [`TopicObserver::poll`] before the queue is full.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        Source::open(bus, topic.sample_type(), false).map(Self)
    }

    /// An observer that samples wake, see [`TopicObserver::wait`].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn waking(bus: &Bus, topic: Topic) -> Result<Self, RuntimeError> {
        Source::open(bus, topic.sample_type(), true).map(Self)
    }

    /// As [`Observer::wait`].
    pub fn wait(&self, timeout_ns: u64) -> bool {
        self.0.wait(timeout_ns)
    }

    /// Makes this end of all connections.
    pub fn connect(&self) {
        self.0.subscriber.connect();
    }

    /// The topic.
    pub fn topic(&self) -> Topic {
        self.0.of.topic
    }

    /// Hands all waiting samples to `each`, whatever their content; see [`Observer::poll_checked`].
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when receiving fails.
    pub fn poll(&self, each: &mut dyn FnMut(&[u8])) -> Result<(), RuntimeError> {
        self.0.poll(each).map(|_| ())
    }
}

/// [`Observer`] of samples of any type.
struct Source {
    of: &'static SampleType,
    subscriber: ByteSubscriber,
    waking: Option<Waking>,
    borrowed: RefCell<Vec<Received>>,
}

/// What an observer sleeps on.
struct Waking {
    bells: Arc<Bells>,
    waiter: Waiter,
    seen: Cell<u32>,
}

impl Source {
    fn open(bus: &Bus, of: &'static SampleType, waking: bool) -> Result<Enclosed<Self>, RuntimeError> {
        let waiter = if waking { Some(Waiter::new(bus, of.topic)?) } else { None };
        let waking =
            waiter.map(|waiter| Waking { bells: Arc::clone(bus.bells()), waiter, seen: Cell::new(0) });
        let borrowed = RefCell::new(Vec::with_capacity(qos(of.topic, u64::MAX).max_borrowed()));
        let subscriber = bus.subscriber(of, Queue::Observer)?;
        bus.allocate()?;
        Ok(Enclosed::new(Self { of, subscriber, waking, borrowed }))
    }

    fn wait(&self, timeout_ns: u64) -> bool {
        let Some(waking) = &self.waking else { return wait_for(&[], timeout_ns) };
        let bell = waking.bells.topic(self.of.topic);
        let on = waking.waiter.is_needed(false);
        if on && waking.waiter.descriptor().is_none() {
            // Earlier notifications do not reach the new listener: poll first.
            waking.waiter.listen(true);
            return true;
        }
        waking.waiter.listen(on);
        let (seen, bit) = (waking.seen.get(), bit(self.of.topic));
        let awake = match waking.waiter.descriptor() {
            Some(descriptor) => bell.poll() != seen || wait_for(&[descriptor], timeout_ns),
            None => bell.sleep(seen, monotonic_ns().saturating_add(timeout_ns), bit),
        };
        if !awake {
            waking.waiter.is_needed(true);
        }
        awake
    }

    fn next(&self) -> Result<Option<Enclosed<Received>>, RuntimeError> {
        self.mark_seen();
        Ok(self.subscriber.receive()?.map(Enclosed::new))
    }

    fn poll(&self, each: &mut dyn FnMut(&[u8])) -> Result<bool, RuntimeError> {
        self.mark_seen();
        let mut borrowed = self.borrowed.borrow_mut();
        for _ in 0..MAX_ROUNDS {
            let is_all = self.subscriber.receive_all(|sample| {
                each(&sample);
                borrowed.push(sample);
            })?;
            borrowed.clear();
            if is_all {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// From here on, a ring or a notification means new samples.
    fn mark_seen(&self) {
        if let Some(waking) = &self.waking {
            waking.seen.set(waking.bells.topic(self.of.topic).poll());
            waking.waiter.clear();
        }
    }
}

/// Publishes samples that belong to no role: the orchestrator's directives and relayed checkpoints.
pub struct Publisher<S: Sample>(Enclosed<Sender>, PhantomData<S>);

impl<S: Sample> Publisher<S> {
    /// Opens the topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when the topic can't be opened.
    pub fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Sender::open(bus, S::TYPE).map(|sender| Self(sender, PhantomData))
    }

    /// Publishes, and wakes the readers when `wake`. Layout and sequence are filled here.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    #[inline(always)]
    pub fn publish(&mut self, sample: &mut S, wake: bool) -> Result<(), RuntimeError> {
        self.0.number(bytes_of_mut(sample));
        self.publish_unchanged(sample, wake)
    }

    /// Publishes a sample with its header as it is, right or wrong: for tests of readers.
    ///
    /// # Errors
    /// As [`Publisher::publish`].
    pub fn publish_unchanged(&mut self, sample: &S, wake: bool) -> Result<(), RuntimeError> {
        self.0.send(bytes_of(sample), wake)
    }
}

/// Publishes samples of some topics as bytes: for a bridge between buses, and for those who play roles. It may move from one
/// thread to another.
pub struct TopicPublishers {
    publishers: Vec<Enclosed<Sender>>,
    // Dropped last: the ports belong to it.
    _bus: Bus,
}

// SAFETY: the parts are not `Send` because they count references to each other without atomic operations. All of them are
// made in `open` from a bus that nothing else uses, are private, and none is ever handed out; so they move together, and
// `&mut self` admits one thread at a time.
unsafe impl Send for TopicPublishers {}

impl TopicPublishers {
    /// Joins the system as `name`, and opens the topics for writing.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when a topic can't be opened.
    pub fn open(domain: &Domain, name: &str, topics: &[Topic]) -> Result<Self, RuntimeError> {
        let bus = Bus::open(domain, name)?;
        let publishers = topics.iter().map(|topic| Sender::open(&bus, topic.sample_type()));
        Ok(Self { publishers: publishers.collect::<Result<_, _>>()?, _bus: bus })
    }

    /// Publishes a sample as it is on the topic of this place in the list, and wakes the readers.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    ///
    /// # Panics
    /// When there is no such place, and when the bytes are not as many as the type of the topic has.
    pub fn publish(&mut self, index: usize, sample: &[u8]) -> Result<(), RuntimeError> {
        self.publishers[index].send(sample, true)
    }

    /// Publishes on a topic, and wakes the readers; nothing happens when it was not opened. Layout and sequence are
    /// filled here, unless the sample is to go out `exactly` as it is.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    ///
    /// # Panics
    /// When the bytes are not as many as the type of the topic has.
    pub fn publish_on(&mut self, topic: Topic, sample: &mut [u8], exactly: bool) -> Result<(), RuntimeError> {
        let opened = self.publishers.iter().find(|publisher| publisher.of.topic == topic);
        opened.map_or(Ok(()), |publisher| {
            if !exactly {
                publisher.number(sample);
            }
            publisher.send(sample, true)
        })
    }
}

/// [`Publisher`] of samples of any type.
struct Sender {
    of: &'static SampleType,
    publisher: BytePublisher,
    ringer: Ringer,
    sequence: Cell<u64>,
}

impl Sender {
    fn open(bus: &Bus, of: &'static SampleType) -> Result<Enclosed<Self>, RuntimeError> {
        let publisher = bus.publisher(of)?;
        bus.allocate()?;
        Ok(Enclosed::new(Self { of, publisher, ringer: Ringer::new(bus, of.topic)?, sequence: Cell::new(0) }))
    }

    fn number(&self, sample: &mut [u8]) {
        self.sequence.set(self.sequence.get() + 1);
        let header = (self.of.header_mut)(sample);
        (header.layout, header.sequence) = (self.of.layout, self.sequence.get());
    }

    fn send(&self, sample: &[u8], wake: bool) -> Result<(), RuntimeError> {
        let error = |reason: &dyn std::fmt::Debug| {
            RuntimeError::bus(format!("publish topic {}", self.of.topic), reason)
        };
        let mut place = self.publisher.loan().map_err(|reason| error(&reason))?;
        place.bytes().copy_from_slice(sample);
        place.send().map_err(|reason| error(&reason))?;
        if wake {
            self.ringer.poll_listeners();
            self.ringer.ring();
        }
        Ok(())
    }
}
