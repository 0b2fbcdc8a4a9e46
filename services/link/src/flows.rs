//! The topics that cross at one host: a thread for each that leaves, and a receiver of those that arrive.
//!
//! When a role moves to another host, more topics cross. The orchestrator's link reads them from its table, which the
//! orchestrator rewrites, and repeats to each host what that is to send and to receive. A topic that has begun to cross
//! does so until the run ends.

use std::sync::Arc;
use std::thread::JoinHandle;

use runtime::{Domain, HUB, LinkTable};
use shared_types::Topic;
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::Priority;

use crate::inbox::Registration;
use crate::link::Link;
use crate::network::{Network, table_key, topic_key};
use crate::offsets::Offsets;
use crate::receiver::Receiver;
use crate::sender;

/// The topics that cross at this host.
pub(crate) struct Flows {
    link: Arc<Link>,
    session: Network,
    domain: Domain,
    received: Vec<Topic>,
    sent: Vec<Topic>,
    offsets: Option<Arc<Offsets>>,
    threads: Vec<JoinHandle<()>>,
    receivers: Vec<Arc<Receiver>>,
    subscribers: Vec<Registration>,
}

impl Flows {
    /// No topic crosses yet.
    pub(crate) fn new(link: &Arc<Link>, session: &Network, domain: &Domain) -> Self {
        Self {
            link: Arc::clone(link),
            session: session.clone(),
            domain: domain.clone(),
            received: Vec::new(),
            sent: Vec::new(),
            offsets: None,
            threads: Vec::new(),
            receivers: Vec::new(),
            subscribers: Vec::new(),
        }
    }

    /// Has topics cross, unless they do already.
    ///
    /// # Errors
    /// Unknown topics, what Zenoh refuses, and errors of the bus.
    pub(crate) fn extend(&mut self, receives: &[String], sends: &[String]) -> anyhow::Result<()> {
        let new = |names: &[String], known: &mut Vec<Topic>| -> anyhow::Result<Vec<Topic>> {
            let all = names.iter().map(|name| name.parse()).collect::<Result<Vec<Topic>, _>>()?;
            let new: Vec<Topic> = all.into_iter().filter(|topic| !known.contains(topic)).collect();
            known.extend(&new);
            Ok(new)
        };
        let (receives, sends) = (new(receives, &mut self.received)?, new(sends, &mut self.sent)?);
        if !receives.is_empty() {
            self.receive(receives)?;
        }
        sends.into_iter().try_for_each(|topic| self.send(topic))
    }

    fn receive(&mut self, topics: Vec<Topic>) -> anyhow::Result<()> {
        if self.offsets.is_none() && self.link.table.here == HUB {
            self.offsets = Some(Arc::new(Offsets::open(&self.domain)?));
        }
        let offsets = self.offsets.clone();
        let receiver = Arc::new(Receiver::open(&self.link, &self.domain, topics.clone(), offsets)?);
        for (index, topic) in topics.into_iter().enumerate() {
            let key = |from: &str| topic_key(&self.link.table.run_id, topic, from);
            // While a writer moves, its topic crosses both ways: what this host has sent comes back to it.
            let (own, shared) = (key(&self.link.table.here), Arc::clone(&receiver));
            self.subscribers.push(self.session.subscribe(key("*"), move |name, frame| {
                if name != own {
                    shared.take(index, name.rsplit('/').next().unwrap_or_default(), frame);
                }
            }));
        }
        self.receivers.push(receiver);
        Ok(())
    }

    fn send(&mut self, topic: Topic) -> anyhow::Result<()> {
        // States and reports never wait in front of samples that drive, nor journals in front of these.
        let priority = match topic {
            Topic::Directive => Priority::RealTime,
            Topic::Journal => Priority::Data,
            _ if topic.writer().is_some() => Priority::RealTime,
            _ => Priority::DataHigh,
        };
        let key = topic_key(&self.link.table.run_id, topic, &self.link.table.here);
        let out = self.session.publisher(key, priority)?;
        let (shared, domain) = (Arc::clone(&self.link), self.domain.clone());
        self.threads.push(self.link.spawn(move || sender::run(shared, &domain, topic, out)));
        Ok(())
    }

    /// Waits for the end of all threads of a link that has ended, and leaves the bus.
    pub(crate) fn join(&mut self) {
        self.subscribers.clear();
        self.receivers.drain(..).for_each(|receiver| receiver.close());
        self.threads.drain(..).for_each(|thread| _ = thread.join());
    }
}

/// Tells each host what it is to send and to receive.
pub(crate) struct Tables(Vec<(String, Publisher<'static>)>);

impl Tables {
    /// Nothing is told yet.
    ///
    /// # Errors
    /// What Zenoh refuses.
    pub(crate) fn new(session: &Network, table: &LinkTable) -> anyhow::Result<Self> {
        let open = |name: &String| {
            let key = table_key(&table.run_id, name);
            Ok((name.clone(), session.publisher(key, Priority::InteractiveHigh)?))
        };
        Ok(Self(table.peers.iter().map(|peer| open(&peer.name)).collect::<anyhow::Result<_>>()?))
    }

    /// Tells all hosts what the table says; call it again and again, because it may be lost.
    pub(crate) fn publish(&self, table: &LinkTable) {
        for (name, publisher) in &self.0 {
            if let Some(peer) = table.peers.iter().find(|peer| peer.name == *name) {
                let _ = publisher.put(text_of(&peer.receives, &peer.sends)).wait();
            }
        }
    }
}

/// A message: the topics that a host receives, and in a second line those that it sends.
fn text_of(receives: &[String], sends: &[String]) -> String {
    format!("{}\n{}", receives.join(" "), sends.join(" "))
}

/// The topics of a message: received, and sent; `None` when it is damaged or names a topic that is unknown here.
pub(crate) fn topics_of(text: &str) -> Option<(Vec<String>, Vec<String>)> {
    let names = |line: &str| {
        let known = |name: &str| name.parse::<Topic>().ok().map(|topic| topic.name().to_owned());
        line.split_whitespace().map(known).collect::<Option<Vec<String>>>()
    };
    let (receives, sends) = text.split_once('\n')?;
    Some((names(receives)?, names(sends)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_read_back_as_it_was_written() {
        let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        for (receives, sends) in
            [(names(&["scan", "odometry"]), names(&["pose"])), (names(&[]), names(&["command"]))]
        {
            assert_eq!(topics_of(&text_of(&receives, &sends)), Some((receives, sends)));
        }
        for damaged in ["scan", "scan\nno-such-topic", "../../scan\n", "scan,pose\n"] {
            assert_eq!(topics_of(damaged), None, "{damaged:?}");
        }
    }
}
