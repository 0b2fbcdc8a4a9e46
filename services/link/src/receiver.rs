//! Publishes here what other hosts send: new samples only, in order, and young enough.
//!
//! It works in the thread of Zenoh that has read the sample: no other thread is woken between the network and the stage
//! that the sample is for.

use std::sync::{Arc, Mutex, PoisonError};

use runtime::{Domain, LossReason, RuntimeError, TopicPublishers, monotonic_ns};
use shared_types::Topic;

use crate::batch::frames;
use crate::clock::Offset;
use crate::frame::{Aligned, Content, published_ns, to_local, unpack};
use crate::gate::{Arriving, Refusal, admit, limit_ns};
use crate::link::Link;
use crate::newest::{Arrival, Newest};
use crate::offsets::Offsets;
use crate::sender::is_batched;

/// What comes from other hosts.
pub(crate) struct Receiver {
    link: Arc<Link>,
    topics: Vec<Topic>,
    /// At the host of the orchestrator: the offsets of the others.
    offsets: Option<Arc<Offsets>>,
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
    pub(crate) fn open(
        link: &Arc<Link>,
        domain: &Domain,
        topics: Vec<Topic>,
        offsets: Option<Arc<Offsets>>,
    ) -> Result<Self, RuntimeError> {
        let inlets = Inlets {
            publishers: TopicPublishers::open(domain, "link", &topics)?,
            newest: vec![Newest::default(); topics.len()],
            sample: Aligned::default(),
        };
        Ok(Self { link: Arc::clone(link), topics, offsets, inlets: Mutex::new(Some(inlets)) })
    }

    /// Publishes what a message of a host about the topic of this place in the list contains, if it counts. An error of the
    /// bus ends the link.
    pub(crate) fn take(&self, index: usize, host: &str, message: &[u8]) {
        let mut inlets = self.inlets.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(inlets) = inlets.as_mut() else { return };
        let mut take = |frame: &[u8]| {
            let noted = inlets.take(&self.link, self.topics[index], index, frame)?;
            match (&self.offsets, noted) {
                (Some(offsets), Some((scan_id, clock))) => offsets.note(host, scan_id, clock, monotonic_ns()),
                _ => Ok(()),
            }
        };
        let taken = match is_batched(self.topics[index]) {
            true => frames(message).try_for_each(take),
            false => take(message),
        };
        if let Err(error) = taken {
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
    /// Publishes a sample if it counts. Returns its scan and how the times of that were mapped, unless it was there before.
    fn take(
        &mut self,
        link: &Link,
        topic: Topic,
        index: usize,
        frame: &[u8],
    ) -> Result<Option<(u64, Offset)>, RuntimeError> {
        let Self { publishers, newest, sample } = self;
        let (of, Link { counters, losses, .. }, now_ns) = (topic.sample_type(), link, monotonic_ns());
        let content = unpack(of, frame, sample);
        if content == Content::Damaged {
            counters.damaged.add(1);
            return Ok(None);
        }
        let header = *(of.header)(sample.bytes());
        if header.check_numbers().is_err() {
            // Its readers drop, count and name it. Nothing follows from its numbers here.
            publishers.publish(index, sample.bytes())?;
            return Ok(None);
        }
        match newest[index].arrive(header.incarnation, header.sequence) {
            // A link that was started again does not know which numbers came before.
            Arrival::First => losses.add_before(topic, &header, header.sequence.saturating_sub(1), now_ns),
            Arrival::New { missing } => {
                counters.missing.add(missing);
                losses.add_before(topic, &header, missing, now_ns);
            }
            Arrival::Repeated => {
                counters.repeated.add(1);
                return Ok(None);
            }
            Arrival::Older => {
                counters.old.add(1);
                return Ok(None);
            }
        }
        let Content::Sample(clock) = content else {
            counters.damaged.add(1);
            losses.add(topic, &header, LossReason::Layout, now_ns);
            return Ok(None);
        };
        let noted = (clock != Offset::UNKNOWN).then_some((header.scan_id, clock));
        if is_batched(topic) {
            // Journals act on nothing, whatever their age.
            publishers.publish(index, sample.bytes())?;
            counters.received.add(1);
            return Ok(noted);
        }
        let (offset, period_ns) = (link.clock.offset(now_ns), link.table.period_ns);
        let now = offset.map(|clock| (now_ns.saturating_add_signed(clock.offset_ns), clock.bound_ns));
        let published_ns = published_ns(topic, &header, sample.bytes());
        let arriving = Arriving { published_ns, sender_bound_ns: clock.bound_ns, now };
        let offset = match topic.writer() {
            Some(_) => link.clock.offset_of(header.scan_id, now_ns),
            None => offset,
        };
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
        Ok(noted.filter(|_| topic.writer().is_some()))
    }
}
