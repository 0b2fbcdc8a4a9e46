//! Publishes here what other hosts send: new samples only, in order, and young enough.
//!
//! It works in the thread of Zenoh that has read the sample: no other thread is woken between the network and the stage
//! that the sample is for.

use std::sync::{Arc, Mutex, PoisonError};

use runtime::{Domain, LossReason, RuntimeError, TopicPublishers, monotonic_ns};
use shared_types::Topic;

use crate::frame::{Aligned, Content, published_ns, to_local, unpack};
use crate::gate::{Arriving, Refusal, admit, limit_ns};
use crate::link::Link;
use crate::newest::{Arrival, Newest};

/// What comes from other hosts.
pub(crate) struct Receiver {
    link: Arc<Link>,
    topics: Vec<Topic>,
    /// `None` when it is closed.
    inlets: Mutex<Option<Inlets>>,
}

/// Where the samples go.
struct Inlets {
    publishers: TopicPublishers,
    /// By topic.
    newest: Vec<Newest>,
    sample: Aligned,
}

impl Receiver {
    /// Publishes these topics on the bus of `domain`.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn open(link: &Arc<Link>, domain: &Domain, topics: Vec<Topic>) -> Result<Self, RuntimeError> {
        let inlets = Inlets {
            publishers: TopicPublishers::open(domain, "link", &topics)?,
            newest: vec![Newest::default(); topics.len()],
            sample: Aligned::default(),
        };
        Ok(Self { link: Arc::clone(link), topics, inlets: Mutex::new(Some(inlets)) })
    }

    /// Publishes a frame of the topic of this place in the list if it counts. An error of the bus ends the link.
    pub(crate) fn take(&self, index: usize, frame: &[u8]) {
        let mut inlets = self.inlets.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(inlets) = inlets.as_mut()
            && let Err(error) = inlets.take(&self.link, self.topics[index], index, frame)
        {
            runtime::print(runtime::Priority::Error, &format!("error: scanloop-link: {error:#}"));
            self.link.end();
        }
    }

    /// Leaves the bus; what comes later is ignored.
    pub(crate) fn close(&self) {
        self.inlets.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}

impl Inlets {
    fn take(&mut self, link: &Link, topic: Topic, index: usize, frame: &[u8]) -> Result<(), RuntimeError> {
        let Self { publishers, newest, sample } = self;
        let (of, Link { counters, losses, .. }, now_ns) = (topic.sample_type(), link, monotonic_ns());
        let content = unpack(of, frame, sample);
        if content == Content::Damaged {
            counters.damaged.add(1);
            return Ok(());
        }
        let header = *(of.header)(sample.bytes());
        match newest[index].arrive(header.incarnation, header.sequence) {
            // A link that was started again does not know which numbers came before.
            Arrival::First => losses.add_before(topic, &header, header.sequence.saturating_sub(1), now_ns),
            Arrival::New { missing } => {
                counters.missing.add(missing);
                losses.add_before(topic, &header, missing, now_ns);
            }
            Arrival::Repeated => {
                counters.repeated.add(1);
                return Ok(());
            }
            Arrival::Older => {
                counters.old.add(1);
                return Ok(());
            }
        }
        let Content::Sample(sender_bound_ns) = content else {
            counters.damaged.add(1);
            losses.add(topic, &header, LossReason::Layout, now_ns);
            return Ok(());
        };
        let (offset, period_ns) = (link.clock.offset(now_ns), link.table.period_ns);
        let now = offset.map(|clock| (now_ns.saturating_add_signed(clock.offset_ns), clock.bound_ns));
        let arriving =
            Arriving { published_ns: published_ns(topic, &header, sample.bytes()), sender_bound_ns, now };
        match (admit(arriving, limit_ns(topic, period_ns), period_ns), offset) {
            (Ok(()), Some(clock)) => {
                to_local(of, sample.bytes_mut(), clock);
                if topic.writer().is_some() {
                    link.note_foreign(header.incarnation);
                }
                publishers.publish(index, sample.bytes())?;
                counters.received.add(1);
                if topic == Topic::Directive {
                    link.note_directive(header.sequence);
                }
            }
            (Err(Refusal::Old), _) => {
                counters.old.add(1);
                losses.add(topic, &header, LossReason::Age, now_ns);
            }
            (Err(Refusal::Clock), _) | (Ok(()), None) => {
                counters.clock.add(1);
                losses.add(topic, &header, LossReason::Clock, now_ns);
            }
        }
        Ok(())
    }
}
