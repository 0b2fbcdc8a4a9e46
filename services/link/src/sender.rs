//! Sends the newest samples of one topic to the other hosts; of journals, all.

use std::sync::Arc;

use runtime::{Bus, Domain, LossReason, TopicObserver, monotonic_ns, observer_queue};
use shared_types::Topic;
use zenoh::Wait;
use zenoh::pubsub::Publisher;

use crate::batch::Batch;
use crate::clock::Offset;
use crate::frame::{Aligned, pack};
use crate::link::Link;
use crate::repeats::Repeats;

/// Longest sleep, after which the end of the link is noticed [ns]. Journals, which wake no reader, are sent so often.
const POLL_NS: u64 = 50_000_000;
/// Journals in one message at least: as many as may wait at a recorder, where the queue is shortest.
const MIN_BATCH: usize = 32;

/// One topic on its way out.
struct Sender {
    link: Arc<Link>,
    topic: Topic,
    publisher: Publisher<'static>,
    /// The newest sample of each publisher since the last poll.
    waiting: Vec<(u32, Aligned)>,
    count: usize,
    frame: Vec<u8>,
    repeats: Repeats,
    batch: Batch,
}

/// Whether each sample of a topic counts, and not only the newest.
pub(crate) fn is_batched(topic: Topic) -> bool {
    topic == Topic::Journal
}

/// Sends the samples of a topic until the link ends.
///
/// # Errors
/// Errors of the bus.
pub(crate) fn run(
    link: Arc<Link>,
    domain: &Domain,
    topic: Topic,
    publisher: Publisher<'static>,
) -> anyhow::Result<()> {
    let bus = Bus::open(domain, "link")?;
    let observer = TopicObserver::waking(&bus, topic)?;
    observer.connect();
    let mut sender = Sender {
        link,
        topic,
        publisher,
        waiting: Vec::new(),
        count: 0,
        frame: Vec::with_capacity(2 * topic.size()),
        repeats: Repeats::default(),
        batch: Batch::default(),
    };
    while sender.link.is_running() {
        let wait_ns = sender.repeats.wait_ns(monotonic_ns()).unwrap_or(POLL_NS);
        observer.wait(wait_ns.min(POLL_NS));
        sender.count = 0;
        if is_batched(topic) {
            observer.poll(&mut |sample| sender.add(sample))?;
            sender.send_batch();
            continue;
        }
        observer.poll(&mut |sample| sender.note(sample))?;
        match sender.count {
            0 => sender.repeat(),
            count => (0..count).for_each(|index| sender.send(index)),
        }
    }
    Ok(())
}

impl Sender {
    /// Keeps a sample until all are polled; a newer one of the same publisher replaces it.
    fn note(&mut self, sample: &[u8]) {
        let header = self.topic.sample_type().header;
        let incarnation = header(sample).incarnation;
        if self.topic.writer().is_some() && self.link.is_foreign(incarnation) {
            return;
        }
        let known = self.waiting[..self.count].iter().position(|(of, _)| *of == incarnation);
        if let Some(index) = known {
            self.link.counters.replaced.add(1);
            let replaced = header(self.waiting[index].1.bytes());
            self.link.losses.add(self.topic, replaced, LossReason::Newer, monotonic_ns());
        }
        let index = known.unwrap_or(self.count);
        if index == self.waiting.len() {
            self.waiting.push((incarnation, Aligned::default()));
        }
        let (of, bytes) = &mut self.waiting[index];
        *of = incarnation;
        bytes.fill(sample);
        self.count = self.count.max(index + 1);
    }

    /// Adds a journal to the next message. Its times are those of this host, and stay.
    fn add(&mut self, sample: &[u8]) {
        let (of, link) = (self.topic.sample_type(), &self.link);
        let known = link.clock.known((of.header)(sample).scan_id, monotonic_ns());
        let most = observer_queue(of.size, link.table.period_ns).max(MIN_BATCH);
        if self.waiting.is_empty() {
            self.waiting.push((0, Aligned::default()));
        }
        let journal = &mut self.waiting[0].1;
        journal.fill(sample);
        let is_lost = self.batch.add(most, |frame| {
            pack(of, journal.bytes_mut(), known.unwrap_or(Offset::UNKNOWN), frame);
        });
        self.link.counters.replaced.add(u64::from(is_lost));
    }

    fn send_batch(&mut self) {
        if let Some(first) = self.batch.take(&mut self.frame) {
            self.put();
            self.link.counters.sent.add(first);
        }
    }

    fn send(&mut self, index: usize) {
        let now_ns = monotonic_ns();
        let (of, sample) = (self.topic.sample_type(), &mut self.waiting[index].1);
        let header = *(of.header)(sample.bytes());
        let clock = &self.link.clock;
        let offset = match self.topic.writer() {
            Some(_) => clock.offset_of(header.scan_id, now_ns),
            None => clock.offset(now_ns),
        };
        let Some(offset) = offset else {
            self.link.counters.held.add(1);
            self.link.losses.add(self.topic, &header, LossReason::Clock, now_ns);
            return;
        };
        self.frame.clear();
        pack(of, sample.bytes_mut(), offset, &mut self.frame);
        self.put();
        self.link.counters.sent.add(1);
        if self.topic.writer().is_some() {
            self.repeats.sent(now_ns, self.link.table.period_ns);
        }
    }

    fn repeat(&mut self) {
        if self.repeats.take(monotonic_ns()) {
            self.put();
        }
    }

    fn put(&self) {
        if let Err(error) = self.publisher.put(self.frame.as_slice()).wait() {
            tracing_error(self.topic, &error);
        }
    }
}

/// A session that is closed; its end is noticed elsewhere.
fn tracing_error(topic: Topic, error: &dyn std::fmt::Display) {
    runtime::print(runtime::Priority::Warning, &format!("topic {topic} is not sent: {error}"));
}
