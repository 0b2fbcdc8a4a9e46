//! The samples of one writer on one topic, as the orchestrator received them.
//!
//! Numbers of a writer have no gaps, and its scans only grow. A gap is a sample that is missing, unless so many came
//! at once that the orchestrator's buffer was full: then it is *unobserved*, and only its readers can count it. A number
//! that the writer cannot have reached since the last poll is *impossible*: it opens no gap.

use std::collections::VecDeque;
use std::ops::RangeInclusive;

use shared_types::{Header, MAX_LATE, Topic, require_sequence};

use super::TIMEOUT_NS;
use super::fault::{DeliveryFault, DeliveryFaultKind};

/// Number of newest samples that are stored.
const RECENT: usize = 64;
/// Number of gaps that are stored, to tell a late sample from a repeated one.
const HOLES: usize = 16;
/// Number of gaps that are named one by one when samples are reconciled; the samples of others are only counted.
const MAX_NAMED: usize = 64;

/// One writer's samples.
#[derive(Debug, Clone)]
pub(super) struct Stream {
    topic: Topic,
    incarnation: u32,
    newest: u64,
    newest_scan: u64,
    claim: Option<Claim>,
    /// The newest sample that came late or again.
    late: u64,
    holes: VecDeque<Hole>,
    /// Missing samples whose gaps are not stored.
    unnamed: u64,
    recent: VecDeque<Seen>,
    /// The first number must be 1: all readers were connected before it was published.
    pub(super) from_start: bool,
    pub(super) unobserved: u64,
    pub(super) ended_ns: Option<u64>,
}

/// A sample that arrived between two polls.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub(super) sequence: u64,
    pub(super) scan_id: u64,
    /// The poll before, when it had not arrived yet [ns].
    pub(super) after_ns: u64,
    /// The poll that found it [ns].
    pub(super) seen_ns: u64,
}

/// Numbers that did not arrive.
#[derive(Debug, Clone, Copy)]
struct Hole {
    first: u64,
    last: u64,
    /// Scan of the sample before; 0 before the first scan.
    after_scan: u64,
    /// Scan of the sample after; 0 when none has come.
    before_scan: u64,
    seen_ns: u64,
    is_reported: bool,
}

impl Hole {
    /// The scan of one of its numbers, where scans grew like numbers; else 0.
    fn scan_of(&self, sequence: u64) -> u64 {
        let scan_id = self.after_scan.saturating_add(1).saturating_add(sequence - self.first);
        let behind = self.after_scan.saturating_add(self.count()).saturating_add(1);
        let is_known = self.before_scan == 0 || self.before_scan == behind;
        if is_known { scan_id } else { 0 }
    }

    fn count(&self) -> u64 {
        (self.last - self.first).saturating_add(1)
    }

    fn contains(&self, sequence: u64) -> bool {
        (self.first..=self.last).contains(&sequence)
    }
}

/// The last number that the writer reports to have used.
#[derive(Debug, Clone, Copy)]
struct Claim {
    sequence: u64,
    since_ns: u64,
}

impl Stream {
    /// An empty stream; unless `from_start`, samples before the number `first` count for no reader.
    pub(super) fn new(topic: Topic, incarnation: u32, first: u64, from_start: bool) -> Self {
        Self {
            topic,
            incarnation,
            newest: if from_start { 0 } else { first.saturating_sub(1) },
            newest_scan: 0,
            claim: None,
            late: 0,
            unnamed: 0,
            holes: VecDeque::new(),
            recent: VecDeque::with_capacity(RECENT),
            from_start,
            unobserved: 0,
            ended_ns: None,
        }
    }

    /// The largest number known to be used up.
    pub(super) fn newest(&self) -> u64 {
        self.newest
    }

    /// Notes a sample, found by the poll at `seen_ns` and not by the one at `after_ns`. When it `answers` a scan, its
    /// scan must be newer than the one before.
    pub(super) fn see(
        &mut self,
        header: &Header,
        answers: bool,
        after_ns: u64,
        seen_ns: u64,
    ) -> Option<DeliveryFault> {
        let Header { sequence, scan_id, .. } = *header;
        let (topic, incarnation) = (self.topic, self.incarnation);
        let fault = |kind| DeliveryFault::new(topic, kind, incarnation).sequence(sequence).scan(scan_id);
        let elapsed_ns = if self.recent.is_empty() { seen_ns } else { seen_ns.saturating_sub(after_ns) };
        if require_sequence(sequence, self.newest, elapsed_ns).is_err() {
            return Some(fault(DeliveryFaultKind::Impossible));
        }
        if sequence <= self.newest {
            // As in `InputAccount`: the second in a row far below shows that the newest was wrong.
            let goes_on = self.newest - sequence > MAX_LATE && self.late.saturating_add(1) == sequence;
            self.late = sequence;
            if !goes_on {
                let is_late = self.fill_hole(sequence, scan_id);
                return Some(fault(if is_late {
                    DeliveryFaultKind::Reordered
                } else {
                    DeliveryFaultKind::Duplicate
                }));
            }
            self.go_back(sequence, scan_id);
        }
        let found = match scan_id.cmp(&self.newest_scan) {
            _ if !answers || self.newest_scan == 0 => None,
            std::cmp::Ordering::Less => Some(fault(DeliveryFaultKind::Reordered)),
            std::cmp::Ordering::Equal => Some(fault(DeliveryFaultKind::Duplicate)),
            std::cmp::Ordering::Greater => None,
        };
        if sequence > self.newest.saturating_add(1) {
            self.open_hole(sequence - 1, scan_id, seen_ns);
        }
        self.newest = sequence;
        if answers {
            self.newest_scan = self.newest_scan.max(scan_id);
        }
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(Seen { sequence, scan_id, after_ns, seen_ns });
        found
    }

    /// Notes that the poll at `seen_ns` found a full buffer, so that samples may have been overwritten. A gap of that
    /// poll counts only with fewer than `capacity` newer samples: it takes so many to overwrite one. Returns the scans
    /// that were not observed.
    pub(super) fn overflowed(&mut self, seen_ns: u64, capacity: u64) -> Vec<RangeInclusive<u64>> {
        let Self { newest, unobserved, holes, .. } = self;
        let mut scans = Vec::new();
        holes.retain(|hole| {
            let counts = hole.seen_ns < seen_ns || *newest < hole.last.saturating_add(capacity);
            if !counts {
                *unobserved = unobserved.saturating_add(hole.count());
                scans.push(hole.after_scan.saturating_add(1)..=hole.before_scan.saturating_sub(1));
            }
            counts
        });
        scans
    }

    /// Whether the first sample came in the poll at `now_ns`, but is not the first of its writer.
    pub(super) fn began_midway(&self, now_ns: u64) -> bool {
        !self.from_start && self.recent.front().is_some_and(|seen| seen.seen_ns == now_ns)
    }

    /// Notes that the writer reports to have used the numbers up to `sequence`.
    pub(super) fn claimed(&mut self, sequence: u64, now_ns: u64) {
        if sequence > self.newest && self.claim.is_none_or(|claim| claim.sequence <= self.newest) {
            self.claim = Some(Claim { sequence, since_ns: now_ns });
        }
    }

    /// Notes that the writer ended. When it died, samples that it claimed may have been lost with it.
    pub(super) fn ended(&mut self, now_ns: u64, is_death: bool) {
        self.ended_ns.get_or_insert(now_ns);
        if is_death {
            self.claim = None;
        }
    }

    /// The samples that are certainly missing after the poll at `now_ns`; with `is_last` without waiting for late ones.
    pub(super) fn reconcile(&mut self, now_ns: u64, is_last: bool) -> Vec<DeliveryFault> {
        if let Some(Claim { sequence, since_ns }) = self.claim
            && sequence > self.newest
            && (is_last || now_ns.saturating_sub(since_ns) >= TIMEOUT_NS)
        {
            self.open_hole(sequence, 0, now_ns);
            self.newest = sequence;
            self.claim = None;
        }
        let missing = || DeliveryFault::new(self.topic, DeliveryFaultKind::Missing, self.incarnation);
        let mut faults = Vec::new();
        if self.unnamed > 0 {
            faults.push(missing().count(std::mem::take(&mut self.unnamed)));
        }
        for hole in self.holes.iter_mut().filter(|hole| !hole.is_reported) {
            hole.is_reported = true;
            faults.push(missing().sequence(hole.first).count(hole.count()).scan(hole.scan_of(hole.first)));
        }
        faults
    }

    /// The scan of a sample, if it or its neighbours are among the newest; else 0.
    pub(super) fn scan_of(&self, sequence: u64) -> u64 {
        let after = self.recent.iter().position(|seen| seen.sequence >= sequence);
        let Some(after) = after else { return 0 };
        let (next, before) = (self.recent[after], after.checked_sub(1).map(|index| self.recent[index]));
        match before {
            _ if next.sequence == sequence => next.scan_id,
            // Scans grew like the numbers.
            Some(before)
                if next.scan_id.checked_sub(before.scan_id) == Some(next.sequence - before.sequence) =>
            {
                before.scan_id + (sequence - before.sequence)
            }
            _ => 0,
        }
    }

    /// The arrival of a sample, or of the first one after it.
    pub(super) fn arrival_of(&self, sequence: u64) -> Option<&Seen> {
        self.recent.iter().find(|seen| seen.sequence >= sequence)
    }

    fn open_hole(&mut self, last: u64, before_scan: u64, seen_ns: u64) {
        let first = self.newest + 1;
        let after_scan = match self.recent.back() {
            Some(seen) => seen.scan_id,
            // The first of a writer: only the numbers are known.
            None => before_scan.saturating_sub((last - first).saturating_add(2)),
        };
        // A gap that was not reported yet stays until samples are reconciled, unless there are too many.
        if self.holes.len() >= HOLES
            && let Some(oldest) = self.holes.iter().position(|hole| hole.is_reported)
        {
            self.holes.remove(oldest);
        } else if self.holes.len() >= MAX_NAMED {
            let oldest = self.holes.pop_front();
            self.unnamed = self.unnamed.saturating_add(oldest.map_or(0, |hole| hole.count()));
        }
        self.holes.push_back(Hole { first, last, after_scan, before_scan, seen_ns, is_reported: false });
    }

    /// Continues with a lower number: what lies above it was never published.
    fn go_back(&mut self, sequence: u64, scan_id: u64) {
        self.newest = sequence - 1;
        self.newest_scan = self.newest_scan.min(scan_id.saturating_sub(1));
        self.holes.retain(|hole| hole.first < sequence);
        for hole in &mut self.holes {
            hole.last = hole.last.min(sequence - 1);
        }
        // The one before came, as a late sample.
        self.fill_hole(sequence - 1, scan_id.saturating_sub(1));
        self.recent.retain(|seen| seen.sequence < sequence);
    }

    /// Takes a late sample out of the gap it belongs to, if there is one.
    fn fill_hole(&mut self, sequence: u64, scan_id: u64) -> bool {
        let index = self.holes.iter().position(|hole| hole.contains(sequence));
        let Some(hole) = index.and_then(|index| self.holes.remove(index)) else { return false };
        if hole.first < sequence {
            self.holes.push_back(Hole { last: sequence - 1, before_scan: scan_id, ..hole });
        }
        if sequence < hole.last {
            self.holes.push_back(Hole { first: sequence + 1, after_scan: scan_id, ..hole });
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(sequence: u64, scan_id: u64) -> Header {
        Header { incarnation: 2, sequence, scan_id, ..Header::default() }
    }

    /// The faults of these numbers in this order, each for the scan 10 later.
    fn noticed(sequences: &[u64]) -> Vec<(DeliveryFaultKind, u64, u64)> {
        let mut stream = Stream::new(Topic::Pose, 2, 1, true);
        let mut faults = Vec::new();
        for &sequence in sequences {
            faults.extend(stream.see(&header(sequence, sequence.saturating_add(10)), true, 0, 1));
        }
        faults.extend(stream.reconcile(2, false));
        faults.iter().map(|fault| (fault.kind, fault.sequence, fault.scan_id)).collect()
    }

    #[test]
    fn a_dropped_repeated_or_reordered_sample_is_named() {
        assert_eq!(noticed(&[1, 2, 3, 4]), []);
        assert_eq!(noticed(&[1, 2, 4]), [(DeliveryFaultKind::Missing, 3, 13)]);
        assert_eq!(
            noticed(&[2, 3]),
            [(DeliveryFaultKind::Missing, 1, 11)],
            "all were connected before the first"
        );
        assert_eq!(noticed(&[1, 2, 2, 3]), [(DeliveryFaultKind::Duplicate, 2, 12)]);
        assert_eq!(noticed(&[1, 3, 2, 4]), [(DeliveryFaultKind::Reordered, 2, 12)]);
    }

    #[test]
    fn scans_that_do_not_grow_are_noticed_under_any_number() {
        let mut stream = Stream::new(Topic::Command, 2, 1, true);
        assert_eq!(stream.see(&header(1, 5), true, 0, 1), None);
        assert_eq!(stream.see(&header(2, 7), true, 0, 1), None);
        assert_eq!(stream.see(&header(3, 6), true, 0, 1).unwrap().kind, DeliveryFaultKind::Reordered);
        assert_eq!(stream.see(&header(4, 7), true, 0, 1).unwrap().kind, DeliveryFaultKind::Duplicate);
        assert_eq!(stream.see(&header(5, 7), false, 0, 1), None, "a block that answers no scan");
    }

    #[test]
    fn a_gap_behind_a_full_buffer_is_unobserved() {
        let mut stream = Stream::new(Topic::Pose, 2, 1, true);
        stream.see(&header(1, 1), true, 0, 1);
        for sequence in (9..=30).filter(|sequence| *sequence != 20) {
            stream.see(&header(sequence, sequence), true, 1, 2);
        }
        assert_eq!(stream.overflowed(2, 16), [2..=8]);
        assert_eq!(stream.unobserved, 7);
        let missing: Vec<u64> = stream.reconcile(3, true).iter().map(|fault| fault.sequence).collect();
        assert_eq!(missing, [20], "too few have followed it");
    }

    #[test]
    fn one_number_that_can_not_be_is_named_and_costs_nothing_else() {
        for wrong in [1 << 63, u64::MAX, u64::MAX - 1, 100_000] {
            let faults = noticed(&[1, 2, wrong, 3, 4]);
            assert_eq!(faults, [(DeliveryFaultKind::Impossible, wrong, wrong.saturating_add(10))]);
        }
    }

    #[test]
    fn one_number_that_could_be_costs_one_sample_and_no_memory() {
        let numbers: Vec<u64> = (1..=25).chain([1_026]).chain(27..=60).collect();
        // 27 is late; 28 shows that the writer continues there, so only 26 is missing.
        let late = (DeliveryFaultKind::Reordered, 27, 37);
        assert_eq!(noticed(&numbers), [late, (DeliveryFaultKind::Missing, 26, 36)]);
    }

    #[test]
    fn gaps_take_a_limited_amount_of_memory() {
        let mut stream = Stream::new(Topic::Pose, 2, 1, true);
        for sequence in (1..=100_000).map(|index| 2 * index) {
            assert_eq!(stream.see(&header(sequence, sequence), true, 0, 1), None);
        }
        assert!(stream.holes.len() <= MAX_NAMED && stream.recent.len() <= RECENT);
        let missing: u64 = stream.reconcile(2, false).iter().map(|fault| fault.count).sum();
        assert_eq!(missing, 100_000);
    }

    #[test]
    fn a_claimed_number_of_a_writer_that_died_is_not_missing() {
        for (is_death, missing) in [(true, 0), (false, 1)] {
            let mut stream = Stream::new(Topic::Pose, 2, 1, true);
            stream.see(&header(1, 1), true, 0, 1);
            stream.claimed(2, 10);
            stream.ended(20, is_death);
            assert_eq!(stream.reconcile(10 + 10 * TIMEOUT_NS, true).len(), missing, "death: {is_death}");
        }
    }

    #[test]
    fn a_number_that_was_used_up_must_come() {
        let mut stream = Stream::new(Topic::Pose, 2, 1, true);
        stream.see(&header(1, 1), true, 0, 1);
        stream.claimed(2, 10);
        assert_eq!(stream.reconcile(10 + TIMEOUT_NS - 1, false), []);
        let faults = stream.reconcile(10 + TIMEOUT_NS, false);
        assert_eq!((faults.len(), faults[0].sequence, faults[0].scan_id), (1, 2, 2));
        assert_eq!(
            stream.see(&header(2, 2), true, 0, 1).unwrap().kind,
            DeliveryFaultKind::Reordered,
            "it came late"
        );
    }
}
