//! Reports of samples that a process drops because of their content: a line in its log, and a row in its heartbeat.

use std::cell::RefCell;

use shared_types::{Fault, Header, Refusal, Topic};

use crate::monotonic_ns;

/// After the first sample that fails a rule, one line counts all that follow within this time [ns].
const SUMMARY_NS: u64 = 5_000_000_000;

/// The samples of one input that were dropped or refused.
#[derive(Debug, Default)]
pub(crate) struct Refusals(RefCell<Log>);

#[derive(Debug, Default)]
struct Log {
    newest: Refusal,
    of_content: u64,
    /// Incarnation of the newest one's publisher, and a bit for each rule that was logged for it.
    writer: u32,
    rules: u32,
    /// How many samples the lines so far counted, and the time of the last line [ns].
    count: u64,
    at_ns: u64,
}

impl Refusals {
    /// Counts a sample that fails a rule; true when it was logged because its rule or its publisher is new.
    pub(crate) fn note(&self, topic: Topic, header: &Header, fault: &Fault) -> bool {
        let mut log = self.0.borrow_mut();
        let (is_new, line) = log.note(header, fault, monotonic_ns());
        if let Some(count) = line {
            let writer = topic.writer().map_or("orchestrator", |role| role.name());
            let (incarnation, scan) = (header.incarnation, header.scan_id);
            tracing::warn!(%topic, writer, incarnation, scan, count, "dropped: {fault}");
        }
        is_new
    }

    /// How many samples failed a rule that holds for every reader.
    pub(crate) fn of_content(&self) -> u64 {
        self.0.borrow().of_content
    }

    /// The row of the heartbeat.
    pub(crate) fn newest(&self) -> Refusal {
        self.0.borrow().newest
    }
}

impl Log {
    /// Counts a sample; whether its rule is new for its publisher, and how many samples to log in a line now.
    fn note(&mut self, header: &Header, fault: &Fault, now_ns: u64) -> (bool, Option<u64>) {
        self.newest.note(header, fault);
        self.of_content += u64::from(fault.rule().is_of_content());
        if self.writer != header.incarnation {
            (self.writer, self.rules) = (header.incarnation, 0);
        }
        let bit = 1 << (fault.rule().wire() % u32::BITS);
        let is_new = self.rules & bit == 0;
        self.rules |= bit;
        if !is_new && now_ns.saturating_sub(self.at_ns) < SUMMARY_NS {
            return (false, None);
        }
        let count = self.newest.count - self.count;
        (self.count, self.at_ns) = (self.newest.count, now_ns);
        (is_new, Some(count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_each_rule_and_writer_is_logged_then_one_line_counts_all() {
        let mut log = Log::default();
        let mut note = |incarnation, fault: Fault, now_ns| {
            log.note(&Header { incarnation, ..Header::default() }, &fault, now_ns)
        };
        let (unverified, infinite) = (Fault::NotVerified { value: 0 }, Fault::NotFinite { field: "x" });
        assert_eq!(note(3, unverified, 1), (true, Some(1)));
        assert_eq!(note(3, unverified, 2), (false, None));
        assert_eq!(note(3, infinite, 3), (true, Some(2)), "another rule");
        assert_eq!(note(3, unverified, 4), (false, None));
        assert_eq!(note(3, unverified, 3 + SUMMARY_NS), (false, Some(2)));
        assert_eq!(note(4, unverified, 4 + SUMMARY_NS), (true, Some(1)), "another writer");
        assert_eq!(log.newest.count, 6);
    }
}
