//! Samples that were lost between two hosts: what the links report, and which missing samples that explains.
//!
//! A link knows the numbers that did not come through it and why. A sample that a reader or the orchestrator misses is
//! explained when a link reports its number; it waits for that report for a while, because reports get lost as samples do.
//! What no link reports stays a fault.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use runtime::{LinkLoss, LossReason};
use shared_types::{MAX_NUMBER, Topic};

use super::fault::{DeliveryFault, DeliveryFaultKind};

/// A missing sample waits for the report of a link for this long: reports repeat for longer than any outage after which
/// processes continue [ns].
const REPORT_NS: u64 = 5_000_000_000;
/// Entries that are stored per writer and topic.
const SPANS: usize = 256;
/// Explained numbers that are stored per reader and topic, so that each is counted once.
const EXPLAINED: usize = 8192;
/// Numbers of one entry whose scans are looked up.
const MAX_SCANS: u64 = 64;
/// Writers and topics of which losses are stored.
const MAX_WRITERS: usize = 1024;
/// Missing samples that wait; when there are more, the oldest are faults at once.
const MAX_WAITING: usize = 4 * EXPLAINED;

/// Numbers of one writer on one topic that were lost for one reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span {
    first: u64,
    last: u64,
    reason: LossReason,
    /// The last number whose scan was looked up.
    named: u64,
}

/// Losses between hosts, and the missing samples that wait for an explanation.
#[derive(Debug, Clone, Default)]
pub(super) struct Crossing {
    lost: BTreeMap<(Topic, u32), VecDeque<Span>>,
    waiting: Vec<(DeliveryFault, u64)>,
    /// By topic and by what noticed them: writer and number.
    explained: BTreeMap<(String, String), BTreeSet<(u32, u64)>>,
    /// Topics and scans of explained samples.
    scans: BTreeSet<(String, u64)>,
    /// By topic, by what noticed them, and by reason.
    counts: BTreeMap<(String, String, LossReason), u64>,
    is_linked: bool,
}

impl Crossing {
    /// The system has several hosts.
    pub(super) fn link(&mut self) {
        self.is_linked = true;
    }

    /// Notes what a link reports; the same report may come any number of times.
    pub(super) fn note(&mut self, loss: &LinkLoss) {
        let Ok(topic) = loss.topic.parse::<Topic>() else { return };
        let LinkLoss { incarnation, first, last, reason, .. } = *loss;
        // What another host says is checked as its samples are.
        let is_possible = (1..=last).contains(&first) && last <= MAX_NUMBER;
        let is_known = self.lost.contains_key(&(topic, incarnation));
        if !is_possible || !is_known && self.lost.len() >= MAX_WRITERS {
            return;
        }
        let spans = self.lost.entry((topic, incarnation)).or_default();
        if let Some(known) = spans.iter_mut().rev().find(|span| (span.first, span.reason) == (first, reason))
        {
            known.last = known.last.max(last);
            return;
        }
        if spans.len() == SPANS {
            spans.pop_front();
        }
        spans.push_back(Span { first, last, reason, named: first - 1 });
    }

    /// Lost numbers whose scans were not looked up yet: topic, writer, number and reason.
    pub(super) fn take_unnamed(&mut self) -> Vec<(Topic, u32, u64, LossReason)> {
        let mut found = Vec::new();
        for ((topic, incarnation), spans) in &mut self.lost {
            for span in spans.iter_mut().filter(|span| span.named < span.last) {
                let first = (span.named + 1).max(span.last.saturating_sub(MAX_SCANS - 1));
                found.extend((first..=span.last).map(|number| (*topic, *incarnation, number, span.reason)));
                span.named = span.last;
            }
        }
        found
    }

    /// The faults that no link explains: of `found`, and of those that waited for too long at `now_ns`; with `is_last` none
    /// waits any longer.
    pub(super) fn filter(
        &mut self,
        found: Vec<DeliveryFault>,
        now_ns: u64,
        is_last: bool,
    ) -> Vec<DeliveryFault> {
        if !self.is_linked {
            return found;
        }
        let (missing, mut faults): (Vec<_>, Vec<_>) =
            found.into_iter().partition(|fault| fault.kind == DeliveryFaultKind::Missing);
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.extend(missing.into_iter().flat_map(one_by_one).map(|fault| (fault, now_ns)));
        // Those with a number first: they explain the ones of the same scan that have none.
        waiting.sort_by_key(|(fault, _)| fault.sequence == 0);
        let too_many = waiting.len().saturating_sub(MAX_WAITING);
        for (index, (fault, since_ns)) in waiting.into_iter().enumerate() {
            if self.explain(&fault) {
                continue;
            }
            match is_last || index < too_many || now_ns.saturating_sub(since_ns) >= REPORT_NS {
                true => faults.push(fault),
                false => self.waiting.push((fault, since_ns)),
            }
        }
        faults
    }

    /// How many samples of a topic a reader missed, by the reason for which they were lost.
    pub(super) fn counts(&self, topic: &str, reader: &str) -> impl Iterator<Item = (LossReason, u64)> {
        let counts = self.counts.iter();
        counts
            .filter(move |((of, by, _), _)| of == topic && by == reader)
            .map(|((.., reason), count)| (*reason, *count))
    }

    /// How many samples were lost, by reason; one that several processes missed counts once.
    pub(super) fn total(&self) -> BTreeMap<String, u64> {
        let mut distinct: BTreeMap<(&str, u32, u64), LossReason> = BTreeMap::new();
        for ((topic, _), numbers) in &self.explained {
            for (incarnation, number) in numbers {
                if let Some(reason) = self.reason(topic, *incarnation, *number) {
                    distinct.insert((topic, *incarnation, *number), reason);
                }
            }
        }
        let mut total = BTreeMap::new();
        for reason in distinct.into_values() {
            *total.entry(reason.name().to_owned()).or_default() += 1;
        }
        total
    }

    /// Whether a link reports the sample as lost; it counts once per topic and process that noticed it.
    fn explain(&mut self, fault: &DeliveryFault) -> bool {
        let DeliveryFault { topic, incarnation, sequence, scan_id, noticed_by, .. } = fault;
        if *sequence == 0 && *scan_id > 0 {
            return self.scans.contains(&(topic.clone(), *scan_id));
        }
        let key = (topic.clone(), noticed_by.clone());
        let known = self.explained.get(&key);
        if known.is_some_and(|known| known.contains(&(*incarnation, *sequence))) {
            return true;
        }
        let is_new = |number: &(u32, u64)| known.is_none_or(|known| !known.contains(number));
        let number = match sequence {
            0 => self.newest_lost(topic, is_new),
            _ => Some((*incarnation, *sequence)),
        };
        let Some((writer, number)) = number else { return false };
        let Some(reason) = self.reason(topic, writer, number) else { return false };
        let known = self.explained.entry(key).or_default();
        known.insert((writer, number));
        if known.len() > EXPLAINED {
            known.pop_first();
        }
        self.scans.insert((topic.clone(), *scan_id));
        *self.counts.entry((topic.clone(), noticed_by.clone(), reason)).or_default() += 1;
        true
    }

    /// Why a sample was lost; what the sender says holds before what the receiver says.
    fn reason(&self, topic: &str, incarnation: u32, number: u64) -> Option<LossReason> {
        let spans = self.lost.get(&(topic.parse().ok()?, incarnation))?;
        let here = spans.iter().filter(|span| (span.first..=span.last).contains(&number));
        here.map(|span| span.reason).max_by_key(|reason| *reason != LossReason::Link)
    }

    /// The newest lost number of a topic that is new.
    fn newest_lost(&self, topic: &str, is_new: impl Fn(&(u32, u64)) -> bool) -> Option<(u32, u64)> {
        let spans = self.lost.iter().filter(|((of, _), _)| of.name() == topic).rev();
        let spans = spans.flat_map(|((_, writer), spans)| spans.iter().rev().map(|span| (*writer, span)));
        let numbers = spans.flat_map(|(writer, span)| {
            let first = span.first.max(span.last.saturating_sub(EXPLAINED as u64));
            (first..=span.last).rev().map(move |number| (writer, number))
        });
        numbers.into_iter().find(|number| is_new(number))
    }
}

/// The samples of a fault, because a link reports each by its number. Of very many, the first stay one fault.
fn one_by_one(fault: DeliveryFault) -> Vec<DeliveryFault> {
    let rest = fault.count.saturating_sub(EXPLAINED as u64);
    let numbered = |number: u64, ahead: u64| if number == 0 { 0 } else { number.saturating_add(ahead) };
    let single = |ahead| {
        let (sequence, scan_id) = (numbered(fault.sequence, ahead), numbered(fault.scan_id, ahead));
        // Without a number it is not known either which scan each belongs to.
        let scan_id = if sequence == 0 { fault.scan_id } else { scan_id };
        fault.clone().count(1).sequence(sequence).scan(scan_id)
    };
    let mut faults: Vec<DeliveryFault> = (rest..fault.count).map(single).collect();
    if rest > 0 {
        faults.push(fault.count(rest));
    }
    faults
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loss(first: u64, last: u64, reason: LossReason) -> LinkLoss {
        LinkLoss { topic: "scan".to_owned(), incarnation: 1, first, last, reason }
    }

    fn missing(sequence: u64, scan_id: u64, noticed_by: &str) -> DeliveryFault {
        DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Missing, 1)
            .sequence(sequence)
            .scan(scan_id)
            .noticed_by(noticed_by)
    }

    #[test]
    fn each_number_counts_once_as_long_as_it_is_stored() {
        let mut crossing = Crossing::default();
        crossing.link();
        let all = EXPLAINED as u64 + 1;
        crossing.note(&loss(1, all, LossReason::Link));
        let counted =
            |crossing: &Crossing| crossing.counts("scan", "obstacles").map(|(_, count)| count).sum::<u64>();
        let found = (1..=all).map(|number| missing(number, 0, "obstacles")).collect();
        assert_eq!(crossing.filter(found, 10, false), []);
        assert_eq!(counted(&crossing), all);
        // The first one had to go for the last one; the second is still there.
        assert_eq!(crossing.filter(vec![missing(2, 0, "obstacles")], 20, false), []);
        assert_eq!(counted(&crossing), all);
        assert_eq!(crossing.filter(vec![missing(1, 0, "obstacles")], 30, false), []);
        assert_eq!(counted(&crossing), all + 1);
    }

    #[test]
    fn a_gap_becomes_its_samples_and_of_a_very_long_one_the_first_stay_together() {
        let numbers = |faults: &[DeliveryFault]| -> Vec<[u64; 3]> {
            faults.iter().map(|fault| [fault.sequence, fault.scan_id, fault.count]).collect()
        };
        assert_eq!(numbers(&one_by_one(missing(6, 8, "bus"))), [[6, 8, 1]]);
        assert_eq!(numbers(&one_by_one(missing(6, 8, "bus").count(2))), [[6, 8, 1], [7, 9, 1]]);
        assert_eq!(numbers(&one_by_one(missing(6, 0, "bus").count(2))), [[6, 0, 1], [7, 0, 1]]);
        assert_eq!(numbers(&one_by_one(missing(0, 8, "bus").count(2))), [[0, 8, 1], [0, 8, 1]]);
        let all = EXPLAINED as u64;
        for (sequence, last) in [(6, 6 + all + 2), (0, 0)] {
            let many = numbers(&one_by_one(missing(sequence, 0, "bus").count(all + 3)));
            assert_eq!(many.len(), EXPLAINED + 1);
            assert_eq!(many[EXPLAINED - 1..], [[last, 0, 1], [sequence, 0, 3]]);
        }
    }

    #[test]
    fn a_missing_sample_that_a_link_reports_is_no_fault_and_has_its_reason() {
        let mut crossing = Crossing::default();
        crossing.link();
        let found = vec![missing(7, 9, "obstacles"), missing(8, 10, "obstacles"), missing(8, 10, "bus")];
        assert_eq!(crossing.filter(found, 10, false), [], "the report may be on its way");
        crossing.note(&loss(7, 7, LossReason::Link));
        crossing.note(&loss(7, 8, LossReason::Link));
        crossing.note(&loss(8, 8, LossReason::Age));
        assert_eq!(crossing.filter(Vec::new(), 20, true), []);
        let counts: Vec<_> = crossing.counts("scan", "obstacles").collect();
        assert_eq!(counts, [(LossReason::Link, 1), (LossReason::Age, 1)]);
        assert_eq!(crossing.total(), [("age".to_owned(), 1), ("link".to_owned(), 1)].into());
        assert_eq!(crossing.filter(vec![missing(7, 9, "obstacles")], 30, true), [], "it counts once");
        assert_eq!(crossing.counts("scan", "obstacles").map(|(_, count)| count).sum::<u64>(), 2);
        assert_eq!(crossing.filter(vec![missing(0, 9, "bus")], 30, true), [], "by its scan");
    }

    #[test]
    fn what_no_link_reports_stays_a_fault() {
        let mut crossing = Crossing::default();
        assert_eq!(crossing.filter(vec![missing(7, 9, "bus")], 1, false), [missing(7, 9, "bus")], "one host");
        crossing.link();
        crossing.note(&loss(8, 9, LossReason::Link));
        assert_eq!(crossing.filter(vec![missing(7, 9, "bus")], 1, false), []);
        assert_eq!(crossing.filter(Vec::new(), REPORT_NS, false), []);
        assert_eq!(crossing.filter(Vec::new(), REPORT_NS + 1, false), [missing(7, 9, "bus")]);
        let vanished = DeliveryFault::new(Topic::Scan, DeliveryFaultKind::Vanished, 1).sequence(8);
        assert_eq!(crossing.filter(vec![vanished.clone()], 1, false), [vanished]);
    }

    #[test]
    fn a_reader_that_names_no_number_has_as_many_explained_as_were_lost() {
        let mut crossing = Crossing::default();
        crossing.link();
        crossing.note(&loss(3, 4, LossReason::Link));
        let found = vec![missing(0, 0, "obstacles"); 3];
        assert_eq!(crossing.filter(found, 1, true), [missing(0, 0, "obstacles")]);
    }

    #[test]
    fn reports_that_can_not_be_are_ignored_and_all_that_is_stored_is_limited() {
        let mut crossing = Crossing::default();
        crossing.link();
        for (first, last) in [(0, 5), (0, u64::MAX), (9, 8), (1, 1 << 63), (u64::MAX, u64::MAX)] {
            crossing.note(&loss(first, last, LossReason::Link));
        }
        assert!(crossing.lost.is_empty());
        for incarnation in 0..5_000 {
            crossing.note(&LinkLoss { incarnation, ..loss(1, 1, LossReason::Link) });
        }
        assert_eq!(crossing.lost.len(), MAX_WRITERS);
        let mut faults = 0;
        for round in 0..20 {
            let many = missing(round << 40, 0, "obstacles").sequence((round << 40) + 2).count(1 << 39);
            faults += crossing.filter(vec![many], round, false).len();
            assert!(crossing.waiting.len() <= MAX_WAITING);
        }
        assert!(faults > 0, "the oldest do not wait");
    }

    #[test]
    fn of_a_gap_what_a_link_reports_is_explained() {
        let mut crossing = Crossing::default();
        crossing.link();
        crossing.note(&loss(7, 8, LossReason::Link));
        let faults = crossing.filter(vec![missing(6, 8, "bus").count(4)], 1, true);
        assert_eq!(faults, [missing(6, 8, "bus"), missing(9, 11, "bus")]);
    }

    #[test]
    fn each_lost_number_is_looked_up_once() {
        let mut crossing = Crossing::default();
        crossing.note(&loss(3, 4, LossReason::Link));
        let numbers = |crossing: &mut Crossing| -> Vec<u64> {
            crossing.take_unnamed().iter().map(|(.., number, _)| *number).collect()
        };
        assert_eq!(numbers(&mut crossing), [3, 4]);
        crossing.note(&loss(3, 6, LossReason::Link));
        assert_eq!((numbers(&mut crossing), numbers(&mut crossing)), (vec![5, 6], vec![]));
        crossing.note(&loss(100, 1_000, LossReason::Link));
        assert_eq!(numbers(&mut crossing).len(), MAX_SCANS as usize);
    }
}
