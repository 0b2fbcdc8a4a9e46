//! Sends the newest samples of one topic to the other hosts.

use std::sync::Arc;

use runtime::{Bus, Domain, LossReason, TopicObserver, monotonic_ns};
use shared_types::Topic;
use zenoh::Wait;
use zenoh::pubsub::Publisher;

use crate::frame::{Aligned, pack};
use crate::link::Link;
use crate::repeats::Repeats;

/// Longest sleep, after which the end of the link is noticed [ns].
const POLL_NS: u64 = 50_000_000;

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
        frame: Vec::with_capacity(topic.size() + 8),
        repeats: Repeats::default(),
    };
    while sender.link.is_running() {
        let wait_ns = sender.repeats.wait_ns(monotonic_ns()).unwrap_or(POLL_NS);
        observer.wait(wait_ns.min(POLL_NS));
        sender.count = 0;
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

    fn send(&mut self, index: usize) {
        let now_ns = monotonic_ns();
        let Some(offset) = self.link.clock.offset(now_ns) else {
            self.link.counters.held.add(1);
            let held = (self.topic.sample_type().header)(self.waiting[index].1.bytes());
            self.link.losses.add(self.topic, held, LossReason::Clock, now_ns);
            return;
        };
        pack(self.topic.sample_type(), self.waiting[index].1.bytes_mut(), offset, &mut self.frame);
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
