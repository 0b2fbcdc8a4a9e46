//! Publishers and subscribers of the test bench, for samples of all topics of the loop.

use runtime::{Bus, Publisher, RuntimeError, TopicObserver, monotonic_ns};
use shared_types::{Actuation, Command, Obstacles, Odometry, Pose, Role, Sample, Scan, Topic};

use super::message::Message;

/// Publishers of all topics that roles read.
pub(crate) struct Publishers([Publish; 6]);

/// Publishes the message if it is of the topic of the publisher.
type Publish = Box<dyn FnMut(&mut Message, bool) -> Result<(), RuntimeError>>;

fn publisher<S: Sample>(bus: &Bus) -> Result<Publish, RuntimeError> {
    let mut publisher = Publisher::<S>::new(bus)?;
    Ok(Box::new(move |message, exactly| match message.sample_mut() {
        Some(sample) if exactly => publisher.publish_unchanged(sample, true),
        Some(sample) => publisher.publish(sample, true),
        None => Ok(()),
    }))
}

impl Publishers {
    pub(crate) fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self([
            publisher::<Scan>(bus)?,
            publisher::<Odometry>(bus)?,
            publisher::<Pose>(bus)?,
            publisher::<Obstacles>(bus)?,
            publisher::<Command>(bus)?,
            publisher::<Actuation>(bus)?,
        ]))
    }

    /// Publishes; `exactly` leaves layout and sequence as they are, else they are filled and kept in the message.
    pub(crate) fn publish(&mut self, message: &mut Message, exactly: bool) -> Result<(), RuntimeError> {
        self.0.iter_mut().try_for_each(|publish| publish(message, exactly))
    }
}

/// Subscribers of all topics that a role writes.
pub(crate) struct Subscribers(Vec<TopicObserver>);

impl Subscribers {
    pub(crate) fn new(bus: &Bus, role: Role) -> Result<Self, RuntimeError> {
        // Not every robot has a truth, so it is not the last one, which is waited for.
        let truth = (role == Role::Robot).then_some(Topic::Truth);
        let topics = truth.iter().chain(role.writes());
        topics.map(|topic| TopicObserver::waking(bus, *topic)).collect::<Result<_, _>>().map(Self)
    }

    /// Sleeps until the last of the topics may have a new sample, or the time-out.
    pub(crate) fn wait(&self, timeout_ns: u64) -> bool {
        self.0.last().is_some_and(|subscriber| subscriber.wait(timeout_ns))
    }

    /// Hands everything that was published since the last call to `each`.
    pub(crate) fn receive(&self, mut each: impl FnMut(Message)) -> Result<(), RuntimeError> {
        self.0.iter().try_for_each(|subscriber| {
            subscriber.poll(&mut |bytes| each(Message::from_bytes(subscriber.topic(), bytes, monotonic_ns())))
        })
    }
}
