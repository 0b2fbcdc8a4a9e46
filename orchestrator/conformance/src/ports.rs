//! Publishers and subscribers of the test bench, for samples of all topics of the loop.

use runtime::{Bus, Observer, Publisher, RuntimeError, wait_for};
use shared_types::{Actuation, Command, Obstacles, Odometry, Pose, Role, Sample, Scan};

use super::message::Message;

/// Publishers of all topics that roles read.
pub(crate) struct Publishers([Box<dyn Publish>; 6]);

trait Publish {
    /// Publishes the message if it is of the publisher's topic.
    fn publish(&mut self, message: &mut Message, exactly: bool) -> Result<(), RuntimeError>;
}

impl<S: Sample> Publish for Publisher<S> {
    fn publish(&mut self, message: &mut Message, exactly: bool) -> Result<(), RuntimeError> {
        match message.sample_mut() {
            Some(sample) if exactly => self.publish_unchanged(sample, true),
            Some(sample) => self.publish(sample, true),
            None => Ok(()),
        }
    }
}

impl Publishers {
    pub(crate) fn new(bus: &Bus) -> Result<Self, RuntimeError> {
        Ok(Self([
            Box::new(Publisher::<Scan>::new(bus)?),
            Box::new(Publisher::<Odometry>::new(bus)?),
            Box::new(Publisher::<Pose>::new(bus)?),
            Box::new(Publisher::<Obstacles>::new(bus)?),
            Box::new(Publisher::<Command>::new(bus)?),
            Box::new(Publisher::<Actuation>::new(bus)?),
        ]))
    }

    /// Publishes; `exactly` leaves layout and sequence as they are, else they are filled and kept in the message.
    pub(crate) fn publish(&mut self, message: &mut Message, exactly: bool) -> Result<(), RuntimeError> {
        self.0.iter_mut().try_for_each(|publisher| publisher.publish(message, exactly))
    }
}

/// Subscribers of all topics that a role writes.
pub(crate) struct Subscribers(Vec<Box<dyn Subscribe>>);

trait Subscribe {
    fn wait(&self, timeout_ns: u64) -> bool;
    fn receive(&self, each: &mut dyn FnMut(Message)) -> Result<(), RuntimeError>;
}

/// A subscriber, and the kind of message that its samples become.
struct Subscriber<S: Sample>(Observer<S>, fn(Box<S>) -> Message);

impl<S: Sample> Subscribe for Subscriber<S> {
    fn wait(&self, timeout_ns: u64) -> bool {
        self.0.wait(timeout_ns)
    }

    fn receive(&self, each: &mut dyn FnMut(Message)) -> Result<(), RuntimeError> {
        while let Some((sample, _)) = self.0.next()? {
            each((self.1)(Box::new(sample)));
        }
        Ok(())
    }
}

impl Subscribers {
    pub(crate) fn new(bus: &Bus, role: Role) -> Result<Self, RuntimeError> {
        fn of<S: Sample>(
            bus: &Bus,
            role: Role,
            kind: fn(Box<S>) -> Message,
        ) -> Result<Option<Box<dyn Subscribe>>, RuntimeError> {
            let is_written = S::TOPIC.writer() == Some(role);
            is_written.then(|| Ok(Box::new(Subscriber(Observer::waking(bus)?, kind)) as _)).transpose()
        }
        let all = [
            of(bus, role, Message::Truth)?,
            of(bus, role, Message::Scan)?,
            of(bus, role, Message::Odometry)?,
            of(bus, role, Message::Pose)?,
            of(bus, role, Message::Obstacles)?,
            of(bus, role, Message::Command)?,
            of(bus, role, Message::Actuation)?,
        ];
        Ok(Self(all.into_iter().flatten().collect()))
    }

    /// Sleeps until the last of the topics may have a new sample, or the time-out.
    pub(crate) fn wait(&self, timeout_ns: u64) -> bool {
        self.0.last().map_or_else(|| wait_for(&[], timeout_ns), |subscriber| subscriber.wait(timeout_ns))
    }

    /// Hands everything that was published since the last call to `each`.
    pub(crate) fn receive(&self, mut each: impl FnMut(Message)) -> Result<(), RuntimeError> {
        self.0.iter().try_for_each(|subscriber| subscriber.receive(&mut each))
    }
}
