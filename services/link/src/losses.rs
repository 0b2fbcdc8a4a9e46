//! Samples of the loop that did not reach this host, by number and reason, for the ledger of the orchestrator.
//!
//! Neighbours of one reason are one entry, so that an outage is one entry per writer. Reports repeat what was lost within
//! [`REPORTED_NS`]: a report may be lost as any message.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use runtime::{LinkLoss, LossReason};
use shared_types::{Header, Topic};

/// Entries that are stored.
const ENTRIES: usize = 64;
/// How long an entry is reported [ns].
const REPORTED_NS: u64 = 10_000_000_000;

/// What was lost lately.
#[derive(Debug, Default)]
pub(crate) struct Losses(Mutex<VecDeque<Entry>>);

#[derive(Debug, Clone, Copy)]
struct Entry {
    topic: Topic,
    incarnation: u32,
    first: u64,
    last: u64,
    reason: LossReason,
    at_ns: u64,
}

impl Losses {
    /// Notes that a sample was dropped.
    pub(crate) fn add(&self, topic: Topic, header: &Header, reason: LossReason, now_ns: u64) {
        self.add_span(topic, header.incarnation, (header.sequence, header.sequence), reason, now_ns);
    }

    /// Notes that the numbers before that of a sample never came.
    pub(crate) fn add_before(&self, topic: Topic, header: &Header, missing: u64, now_ns: u64) {
        if missing > 0 {
            let span = (header.sequence - missing, header.sequence - 1);
            self.add_span(topic, header.incarnation, span, LossReason::Link, now_ns);
        }
    }

    /// What is to be reported.
    pub(crate) fn recent(&self, now_ns: u64) -> Vec<LinkLoss> {
        let entries = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let recent = entries.iter().filter(|entry| now_ns.saturating_sub(entry.at_ns) < REPORTED_NS);
        let report = |entry: &Entry| {
            let Entry { topic, incarnation, first, last, reason, .. } = *entry;
            LinkLoss { topic: topic.name().to_owned(), incarnation, first, last, reason }
        };
        recent.map(report).collect()
    }

    fn add_span(
        &self,
        topic: Topic,
        incarnation: u32,
        (first, last): (u64, u64),
        reason: LossReason,
        now_ns: u64,
    ) {
        // Of other topics only the newest sample counts, and none has readers that count.
        if topic.writer().is_none() {
            return;
        }
        let mut entries = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |entry: &&mut Entry| {
            (entry.topic, entry.incarnation, entry.reason) == (topic, incarnation, reason)
        };
        if let Some(entry) = entries.iter_mut().rev().find(is_same)
            && entry.last + 1 == first
        {
            (entry.last, entry.at_ns) = (last, now_ns);
            return;
        }
        if entries.len() == ENTRIES {
            entries.pop_front();
        }
        entries.push_back(Entry { topic, incarnation, first, last, reason, at_ns: now_ns });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(sequence: u64) -> Header {
        Header { incarnation: 3, sequence, ..Header::default() }
    }

    fn reported(losses: &Losses, now_ns: u64) -> Vec<(String, u64, u64, LossReason)> {
        let recent = losses.recent(now_ns).into_iter();
        recent.map(|loss| (loss.topic, loss.first, loss.last, loss.reason)).collect()
    }

    #[test]
    fn an_outage_is_one_entry_per_writer_and_reason() {
        let losses = Losses::default();
        losses.add_before(Topic::Pose, &header(40), 0, 1);
        losses.add_before(Topic::Pose, &header(40), 30, 1);
        (40..=45).for_each(|sequence| losses.add(Topic::Pose, &header(sequence), LossReason::Age, 2));
        losses.add(Topic::Scan, &header(7), LossReason::Clock, 2);
        losses.add(Topic::Pose, &header(46), LossReason::Age, 3);
        losses.add(Topic::Pose, &header(48), LossReason::Age, 3);
        assert_eq!(
            reported(&losses, 4),
            [
                ("pose".to_owned(), 10, 39, LossReason::Link),
                ("pose".to_owned(), 40, 46, LossReason::Age),
                ("scan".to_owned(), 7, 7, LossReason::Clock),
                ("pose".to_owned(), 48, 48, LossReason::Age),
            ]
        );
        assert_eq!(reported(&losses, 3 + REPORTED_NS), []);
    }

    #[test]
    fn topics_beside_the_loop_are_not_counted_one_by_one() {
        let losses = Losses::default();
        losses.add(Topic::Heartbeat, &header(7), LossReason::Age, 2);
        assert_eq!(reported(&losses, 2), []);
    }

    #[test]
    fn the_oldest_entries_are_forgotten() {
        let losses = Losses::default();
        (1..=100).for_each(|number| losses.add(Topic::Pose, &header(2 * number), LossReason::Age, 2));
        let reported = reported(&losses, 2);
        assert_eq!((reported.len(), reported[0].1), (ENTRIES, 2 * 37));
    }
}
