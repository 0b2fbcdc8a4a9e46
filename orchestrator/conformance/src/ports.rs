//! Subscribers of the test bench, for samples of all topics that a role writes.

use runtime::{Bus, RuntimeError, TopicObserver, monotonic_ns};
use shared_types::{Role, Topic};

use super::message::Message;

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
