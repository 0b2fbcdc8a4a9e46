//! The ledger of topics beside the loop: what was published, and what became of it at each reader.
//!
//! For every process that reads a topic of your own, and every companion that reads one of the loop,
//! `published = used + replaced + lost + in_flight + residual`, as for the loop. The sources are the counts of the ports
//! alone: what writers say that they have published, and what readers say that has become of it. The *residual* has numbers
//! that never arrived although the queue of the reader was not full, samples that came after later ones, samples that
//! disappeared in a reader, and those that a reader polled for in vain long after they had been published.
//!
//! Limits: samples that were published before a reader was there are not for it, nor are those that had not arrived when it
//! died. Those of a writer that is not counted (an operator, or a process that counts nothing) are known from the
//! numbers that arrived.

use std::collections::{BTreeMap, BTreeSet};

use runtime::{OwnTopics, PortCount};

use super::TIMEOUT_NS;
use super::rows::{DelayRow, LedgerRow};

/// Writers that have ended are kept until so many newer ones have: their readers may still hold samples.
const ENDED_WRITERS: usize = 8;

/// Reasons that point at a fault of the writer, with what they say.
const NAMED: [(&str, &str); 3] = [
    ("content", "a number is not finite or not allowed"),
    ("layout", "another layout, or a number that no sample has by now"),
    ("queue_full", "more came at once than its queue holds"),
];

/// The ledger of the topics beside the loop.
#[derive(Debug, Clone, Default)]
pub struct CompanionLedger {
    /// By topic, incarnation and end.
    ports: BTreeMap<(u32, u32, bool), Known>,
    /// Readers that have ended, added up, by topic and process.
    ended: BTreeMap<(u32, u32), LedgerRow>,
    delays: BTreeMap<(u32, u32, bool), DelayRow>,
    /// Drops that were named: topic, reader and reason.
    named: BTreeSet<(String, String, &'static str)>,
}

#[derive(Debug, Clone, Copy)]
struct Known {
    count: PortCount,
    has_ended: bool,
}

impl CompanionLedger {
    /// Takes the counts of all ports, and whether the process of each has ended.
    pub fn update(&mut self, counts: &[PortCount], has_ended: impl Fn(&PortCount) -> bool) {
        // A process writes its counts itself: what no port can have counted is not added up.
        for count in counts.iter().filter(|count| count.account.check().is_ok()) {
            let known = Known { count: *count, has_ended: has_ended(count) };
            self.ports.insert((count.topic, count.incarnation, count.writes), known);
        }
        self.settle();
    }

    /// Adds up what can't change any more, so that a run with any number of restarts needs no more memory.
    fn settle(&mut self) {
        let ended: Vec<_> =
            self.ports.iter().filter(|(_, known)| known.has_ended).map(|(key, _)| *key).collect();
        for key in ended.iter().filter(|(.., writes)| !writes) {
            if let Some(known) = self.ports.remove(key) {
                let row = self.row(&known);
                self.ended.entry((known.count.topic, known.count.process)).or_default().add(&row);
                self.add_delays(&known.count);
            }
        }
        let writers: Vec<_> = ended.iter().filter(|(.., writes)| *writes).collect();
        for key in &writers[..writers.len().saturating_sub(ENDED_WRITERS)] {
            if let Some(known) = self.ports.remove(key) {
                self.add_delays(&known.count);
            }
        }
    }

    fn add_delays(&mut self, count: &PortCount) {
        self.delays.entry((count.topic, count.process, count.writes)).or_default().add(&count.delays);
    }

    /// Counts per topic and process that reads it.
    pub fn rows(&self, table: &OwnTopics) -> Vec<LedgerRow> {
        let mut rows = self.ended.clone();
        for known in self.ports.values().filter(|known| !known.count.writes) {
            rows.entry((known.count.topic, known.count.process)).or_default().add(&self.row(known));
        }
        let named = |((topic, process), row): ((u32, u32), LedgerRow)| {
            let (topic, reader) =
                (table.topic_name(topic)?.to_owned(), table.process_name(process)?.to_owned());
            Some(LedgerRow { topic, reader, ..row })
        };
        rows.into_iter().filter_map(named).collect()
    }

    /// Drops by content or layout, and by a full queue, that were not returned before: once for each topic, reader and
    /// reason, as text.
    pub fn new_drops(&mut self, table: &OwnTopics) -> Vec<String> {
        let mut found = Vec::new();
        for LedgerRow { topic, reader, reasons, .. } in self.rows(table) {
            for (reason, text) in NAMED {
                let key = (topic.clone(), reader.clone(), reason);
                if reasons.contains_key(reason) && self.named.insert(key) {
                    found.push(format!("{reader} dropped samples of topic {topic}: {text}"));
                }
            }
        }
        found
    }

    /// The delays of each port, in real time.
    pub fn delays(&self, table: &OwnTopics) -> Vec<DelayRow> {
        let mut all = Self { delays: self.delays.clone(), ..Self::default() };
        self.ports.values().for_each(|known| all.add_delays(&known.count));
        let named = |((topic, process, writes), row): ((u32, u32, bool), DelayRow)| {
            let (topic, process) =
                (table.topic_name(topic)?.to_owned(), table.process_name(process)?.to_owned());
            (row.count > 0).then_some(DelayRow { topic, process, writes, ..row })
        };
        all.delays.into_iter().filter_map(named).collect()
    }

    /// What became of the samples at one reader.
    fn row(&self, reader: &Known) -> LedgerRow {
        let PortCount { topic, opened_ns, active_ns, account, .. } = &reader.count;
        let mut row = LedgerRow {
            published: account.arrived - account.duplicate.min(account.arrived)
                + account.missing
                + account.overwritten,
            used: account.used,
            duplicates: account.duplicate,
            reordered: account.reordered,
            ..LedgerRow::default()
        };
        row.replace(account);
        *(if reader.has_ended { &mut row.lost } else { &mut row.in_flight }) += account.waiting;
        for known in self.ports.values() {
            let writer = &known.count;
            if !writer.writes || writer.topic != *topic || reader.has_ended {
                continue;
            }
            let newest = writer.account.arrived;
            // A reader knows its newest writers only.
            let knows_all = account.writers.iter().any(|span| span.incarnation == 0);
            let last = match account.from(writer.incarnation) {
                Some(span) => span.last,
                // All that it has published was for this reader.
                None if writer.opened_ns > *opened_ns && knows_all => 0,
                None => newest,
            };
            let tail = newest.saturating_sub(last);
            row.published += tail;
            // A reader that polled long after the writer had published has what there was.
            let is_late = *active_ns > writer.active_ns.saturating_add(TIMEOUT_NS);
            match (known.has_ended, is_late) {
                (true, _) => row.lost += tail,
                (false, false) => row.in_flight += tail,
                (false, true) => {}
            }
        }
        row.residual = row.published.saturating_sub(row.used + row.replaced + row.lost + row.in_flight);
        row.count("layout", account.unreadable);
        row
    }
}

#[cfg(test)]
mod tests {
    use runtime::Delays;
    use shared_types::{Fate, Header, InputAccount};

    use super::*;

    const TOPIC: u32 = 3;

    fn port(incarnation: u32, writes: bool, account: InputAccount) -> PortCount {
        PortCount {
            incarnation,
            process: incarnation,
            pid: 1,
            topic: TOPIC,
            writes,
            opened_ns: 10,
            active_ns: 1000,
            delays: Delays::default(),
            account,
        }
    }

    /// A writer that has published so many samples.
    fn writer(incarnation: u32, published: u64) -> PortCount {
        port(incarnation, true, InputAccount { arrived: published, ..InputAccount::default() })
    }

    /// A reader that has used these numbers of writer 1.
    fn reader(numbers: impl IntoIterator<Item = u64>) -> PortCount {
        let mut account = InputAccount::default();
        for sequence in numbers {
            let header = Header { incarnation: 1, sequence, ..Header::default() };
            let fate = account.arrive(&header).unwrap_or(Fate::Used);
            account.settle(fate, &header);
        }
        port(2, false, account)
    }

    fn row(ports: &[PortCount]) -> LedgerRow {
        let mut ledger = CompanionLedger::default();
        ledger.update(ports, |_| false);
        ledger.row(&ledger.ports[&(TOPIC, 2, false)])
    }

    #[test]
    fn what_was_published_is_used_or_on_its_way() {
        let row = row(&[writer(1, 12), reader(1..=10)]);
        assert_eq!((row.published, row.used, row.in_flight, row.residual), (12, 10, 2, 0));
    }

    #[test]
    fn a_number_that_never_arrived_is_the_residual_unless_the_queue_was_full() {
        let mut lossy = reader([1, 2, 4, 5]);
        assert_eq!(row(&[writer(1, 5), lossy]).residual, 1);
        (lossy.account.missing, lossy.account.overwritten) = (0, 1);
        let row = row(&[writer(1, 5), lossy]);
        assert_eq!((row.residual, row.replaced, row.reasons["queue_full"]), (0, 1, 1));
    }

    #[test]
    fn samples_that_disappear_in_a_reader_are_the_residual_and_those_that_wait_are_not() {
        let mut holding = reader(1..=3);
        for sequence in 4..=6 {
            holding.account.arrive(&Header { incarnation: 1, sequence, ..Header::default() });
        }
        assert_eq!(row(&[writer(1, 6), holding]).residual, 3);
        holding.account.waiting = 3;
        let row = row(&[writer(1, 6), holding]);
        assert_eq!((row.residual, row.in_flight), (0, 3));
    }

    #[test]
    fn samples_that_a_reader_polled_for_in_vain_are_the_residual() {
        let mut waiting = reader(1..=3);
        waiting.active_ns = 1000 + TIMEOUT_NS + 1;
        assert_eq!(row(&[writer(1, 5), waiting]).residual, 2);
    }

    #[test]
    fn what_was_published_before_a_reader_came_is_not_for_it() {
        let late = row(&[writer(1, 50), reader(41..=50)]);
        assert_eq!((late.published, late.used, late.residual), (10, 10, 0));
        let mut unseen = reader([]);
        unseen.opened_ns = 20;
        assert_eq!(row(&[writer(1, 50), unseen]).published, 0);
    }

    #[test]
    fn readers_that_end_are_added_up() {
        let mut ledger = CompanionLedger::default();
        for incarnation in 2..1000 {
            let mut dying = PortCount { incarnation, process: 2, ..reader(1..=9) };
            dying.account.arrive(&Header { incarnation: 1, sequence: 10, ..Header::default() });
            dying.account.waiting = 1;
            // A writer that was started after its death had nothing for it.
            let counts = [writer(1, 12), PortCount { opened_ns: 2000, ..writer(1000, 20) }, dying];
            ledger.update(&counts, |count| count.incarnation == incarnation);
        }
        assert!(ledger.ports.len() < 4);
        let row = &ledger.ended[&(TOPIC, 2)];
        assert_eq!((row.used, row.lost, row.residual), (998 * 9, 998, 0));
    }
}
