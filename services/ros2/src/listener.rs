//! A topic on which one publisher tells this program something.

use std::time::Duration;

use driver::clock::ServerClock;
use driver::ros2::Ros2Config;
use ros2_client::qos::History;
use ros2_client::{Gid, Subscription};
use runtime::monotonic_ns;
use rustdds::mio1::{Events, Interest, Poll, Token};
use serde::de::DeserializeOwned;

use crate::message::{Named, Time};
use crate::node::{RosNode, best_effort};
use crate::watch::Watch;

/// Longest sleep.
const SLEEP: Duration = Duration::from_millis(20);
/// A sleep that lasts for so long was none [ns].
const SUSPENDED_NS: u64 = 1_000_000_000;
/// Messages that wait to be read: a tenth of a second of an inertial sensor with 1 kHz.
const DEPTH: usize = 100;
/// A message that is older is late: networks without wires delay by tens of milliseconds [ns].
const MAX_AGE_NS: u64 = 200_000_000;
/// A publisher that comes again within this time, after another one has come, makes two [ns].
const TURNS_NS: u64 = 1_000_000_000;

/// Reads a topic.
pub(crate) struct Listener<M: 'static> {
    messages: Subscription<M>,
    stamp: fn(&M) -> Option<&Time>,
    watch: Watch<Gid>,
    clock: ServerClock,
    dropped: u64,
    poll: Poll,
    events: Events,
    _node: RosNode,
}

/// A message that has come.
pub(crate) struct Received<M> {
    /// The message.
    pub(crate) message: M,
    /// When it was stamped, on CLOCK_MONOTONIC [ns].
    pub(crate) stamped_ns: u64,
    /// Why it is not to be used: it is late, or there are two publishers.
    pub(crate) fault: Option<String>,
}

impl<M: Named + DeserializeOwned + 'static> Listener<M> {
    /// Reads a topic as a node of that name. `stamp` finds the stamp in a message; without one, that of DDS counts.
    ///
    /// # Errors
    /// Those of DDS.
    pub(crate) fn open(
        config: &Ros2Config,
        name: &str,
        topic: &str,
        stamp: fn(&M) -> Option<&Time>,
    ) -> anyhow::Result<Self> {
        let mut node = RosNode::open(config, name)?;
        let topic = config.topic(topic);
        let qos = best_effort().history(History::KeepLast { depth: DEPTH });
        let mut messages = node.subscribe::<M>(&topic, qos)?;
        let poll = Poll::new()?;
        poll.registry().register(&mut messages, Token(0), Interest::READABLE)?;
        let watch = Watch::new(topic, TURNS_NS);
        let events = Events::with_capacity(4);
        Ok(Self {
            messages,
            stamp,
            watch,
            clock: ServerClock::new(0.0),
            dropped: 0,
            poll,
            events,
            _node: node,
        })
    }

    /// Sleeps until a message may have come, 20 ms at most.
    ///
    /// # Errors
    /// Those of the kernel, and a process that was suspended meanwhile.
    pub(crate) fn sleep(&mut self) -> anyhow::Result<()> {
        let begun_ns = monotonic_ns();
        match self.poll.poll(&mut self.events, Some(SLEEP)) {
            Err(error) if error.kind() != std::io::ErrorKind::Interrupted => return Err(error.into()),
            _ => {}
        }
        // The threads of DDS end then, and no message would come any more.
        anyhow::ensure!(
            monotonic_ns() - begun_ns < SUSPENDED_NS,
            "this program was suspended, which its connection to ROS 2 does not survive: start it again"
        );
        Ok(())
    }

    /// The oldest message that was not taken.
    pub(crate) fn take(&mut self) -> Option<Received<M>> {
        let (message, info) = match self.messages.take() {
            Ok(taken) => taken?,
            Err(error) => {
                self.drop_message(&format!("it can't be read: {error}"));
                return None;
            }
        };
        let now_ns = monotonic_ns();
        self.watch.note(info.publisher_gid(), now_ns);
        let own_s = (self.stamp)(&message).map(Time::seconds).filter(|stamp_s| *stamp_s > 0.0);
        let sent_s = || info.source_timestamp().map(|time| time.to_nanos() as f64 * 1e-9);
        let stamped_ns = match own_s.or_else(sent_s) {
            Some(stamp_s) => self.clock.arrival(stamp_s, now_ns),
            None => Some(now_ns),
        };
        let late = || late(stamped_ns.map(|stamped_ns| now_ns.saturating_sub(stamped_ns)));
        let fault = self.watch.wrong(now_ns).or_else(late);
        Some(Received { message, stamped_ns: stamped_ns.unwrap_or_default(), fault })
    }

    /// Counts a message that is not used, and names the reason, less and less often.
    pub(crate) fn drop_message(&mut self, reason: &str) {
        self.dropped += 1;
        if self.dropped.is_power_of_two() {
            tracing::warn!(
                topic = self.watch.topic,
                dropped = self.dropped,
                "a message was dropped: {reason}"
            );
        }
    }
}

/// What is wrong with a message of this age, which one that others have overtaken does not have.
fn late(age_ns: Option<u64>) -> Option<String> {
    let Some(age_ns) = age_ns else { return Some("others have overtaken it".to_owned()) };
    let [age_ms, limit_ms] = [age_ns, MAX_AGE_NS].map(|ns| ns / 1_000_000);
    (age_ns > MAX_AGE_NS).then(|| format!("it is {age_ms} ms old, at most {limit_ms} ms are allowed"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_that_is_late_is_named_with_its_age() {
        assert_eq!(late(Some(MAX_AGE_NS)), None);
        assert_eq!(late(Some(350_000_000)).unwrap(), "it is 350 ms old, at most 200 ms are allowed");
        assert_eq!(late(None).unwrap(), "others have overtaken it");
    }
}
