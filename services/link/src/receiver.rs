//! Publishes here what other hosts send: new samples only, in order, and young enough.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use runtime::{Bus, Domain, TopicPublisher, monotonic_ns};
use shared_types::Topic;

use crate::frame::{Aligned, Content, published_ns, to_local, unpack};
use crate::gate::{Arriving, Refusal, admit, limit_ns};
use crate::link::Link;
use crate::newest::{Arrival, Newest};

/// Longest sleep, after which the end of the link is noticed.
const POLL: Duration = Duration::from_millis(50);

/// A frame as it came from the network.
pub(crate) type Incoming = (Topic, Vec<u8>);

/// Where the samples of one topic go.
struct Inlet {
    publisher: TopicPublisher,
    newest: Newest,
}

/// Publishes what comes until the link ends.
///
/// # Errors
/// Errors of the bus.
pub(crate) fn run(
    link: &Arc<Link>,
    domain: &Domain,
    topics: &[Topic],
    incoming: &Receiver<Incoming>,
) -> anyhow::Result<()> {
    let bus = Bus::open(domain, "link")?;
    let open = |topic: &Topic| {
        Ok((*topic, Inlet { publisher: TopicPublisher::new(&bus, *topic)?, newest: Newest::default() }))
    };
    let mut inlets = topics.iter().map(open).collect::<Result<BTreeMap<_, _>, runtime::RuntimeError>>()?;
    let mut sample = Aligned::default();
    while link.is_running() {
        match incoming.recv_timeout(POLL) {
            Ok((topic, frame)) => {
                if let Some(inlet) = inlets.get_mut(&topic) {
                    inlet.take(link, topic, &frame, &mut sample)?;
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    Ok(())
}

impl Inlet {
    fn take(&mut self, link: &Link, topic: Topic, frame: &[u8], sample: &mut Aligned) -> anyhow::Result<()> {
        let (of, counters) = (topic.sample_type(), &link.counters);
        let Content::Sample(sender_bound_ns) = unpack(of, frame, sample) else {
            counters.damaged.add(1);
            return Ok(());
        };
        let header = *(of.header)(sample.bytes());
        match self.newest.arrive(header.incarnation, header.sequence) {
            Arrival::New { missing } => counters.missing.add(missing),
            Arrival::Repeated => {
                counters.repeated.add(1);
                return Ok(());
            }
            Arrival::Older => {
                counters.old.add(1);
                return Ok(());
            }
        }
        let (now_ns, period_ns) = (monotonic_ns(), link.table.period_ns);
        let offset = link.clock.offset(now_ns);
        let now = offset.map(|clock| (now_ns.saturating_add_signed(clock.offset_ns), clock.bound_ns));
        let arriving =
            Arriving { published_ns: published_ns(topic, &header, sample.bytes()), sender_bound_ns, now };
        match (admit(arriving, limit_ns(topic, period_ns), period_ns), offset) {
            (Ok(()), Some(clock)) => {
                to_local(of, sample.bytes_mut(), clock);
                self.publisher.publish(sample.bytes())?;
                counters.received.add(1);
            }
            (Err(Refusal::Old), _) => counters.old.add(1),
            (Err(Refusal::Clock), _) | (Ok(()), None) => counters.clock.add(1),
        }
        Ok(())
    }
}
