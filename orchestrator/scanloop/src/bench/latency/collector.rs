//! Collects the latencies of a run scan by scan.
//!
//! **Coordinated omission.** Scans are published by a schedule. A machine that stalls delays the emulated scanner too,
//! so the time of publication in the sample hides the stall; and a scan without an answer has no latency at all. The
//! corrected series counts like a scanner that is a separate device: a scan's latency starts when it was due on the
//! robot's schedule. A scan that was lost or skipped waits until the next actuation. The emulator's time to make a scan
//! is left out, because a real scanner does not make it on this machine. Limit: scans in flight at the end of the run
//! are not counted.

use std::collections::BTreeMap;

use figures::Distribution;
use report::latency::{Attribution, attribute};
use shared_types::{Actuation, Header, Role};

use super::intervals::{Intervals, Series};

/// Number of first scans of the run that are stored.
const MAX_FIRST: usize = 1000;
/// Number of slowest scans that are stored.
const MAX_SLOWEST: usize = 100;

/// The latencies of a run.
#[derive(Debug)]
pub(crate) struct Collector {
    period_ns: u64,
    /// From when the scan was due, with lost and skipped scans.
    pub corrected: Distribution,
    /// How late the robot woke for a scan.
    pub lateness: Distribution,
    /// Scan to actuation.
    pub reaction: Distribution,
    /// Scan to actuation without compute.
    pub transport: Distribution,
    /// Compute per stage, in the order of `latency::STAGES`.
    pub compute: [Distribution; 4],
    /// Actuations whose chain has all stamps.
    pub complete: u64,
    intervals: Intervals,
    newest: Option<(u64, u64)>,
    waiting: Vec<u64>,
    first: Vec<Header>,
    slowest: BTreeMap<(u64, u64), Header>,
}

impl Collector {
    /// An empty collector for about `expected_scans` scans.
    pub(crate) fn new(period_ns: u64, expected_scans: u64) -> Self {
        Self {
            period_ns,
            corrected: Distribution::of_times(),
            lateness: Distribution::of_times(),
            reaction: Distribution::of_times(),
            transport: Distribution::of_times(),
            compute: std::array::from_fn(|_| Distribution::of_times()),
            complete: 0,
            intervals: Intervals::new(expected_scans),
            newest: None,
            waiting: Vec::new(),
            first: Vec::new(),
            slowest: BTreeMap::new(),
        }
    }

    /// One scan, in order, and the actuations that came with it.
    pub(crate) fn scan(&mut self, header: &Header, actuations: &[Actuation]) {
        let scan_id = header.scan_id;
        let due_ns = self.due_ns(header);
        // Numbers that the robot skipped were due one period after the other.
        if let Some((newest, newest_due_ns)) = self.newest {
            let skipped = scan_id.saturating_sub(newest + 1).min(100_000);
            self.waiting.extend((1..=skipped).map(|number| newest_due_ns + number * self.period_ns));
        }
        self.newest = Some((scan_id, due_ns));
        self.intervals.scan(scan_id, due_ns);
        let answers = actuations.iter().filter(|actuation| actuation.answers == 1);
        let mut answered = false;
        for Actuation { header, .. } in answers {
            answered |= header.scan_id == scan_id;
            self.answer(header);
        }
        if !answered {
            self.waiting.push(due_ns);
        }
    }

    fn answer(&mut self, header: &Header) {
        let answered_ns = header.stage(Role::Actuator).published_ns;
        for due_ns in std::mem::take(&mut self.waiting) {
            self.correct(answered_ns.saturating_sub(due_ns));
        }
        if let Some(reaction_ns) = report::latency::reaction_ns(header) {
            let robot = header.stage(Role::Robot);
            let late_ns = robot.taken_ns.saturating_sub(self.due_ns(header));
            self.lateness.record(late_ns);
            self.correct(reaction_ns + late_ns);
            self.reaction.record(reaction_ns);
            self.intervals.record(Series::ScanToActuation, reaction_ns);
            self.store(reaction_ns, header);
        }
        if let Ok(attribution) = attribute(header) {
            self.attribution(&attribution);
        }
    }

    fn attribution(&mut self, attribution: &Attribution) {
        self.complete += 1;
        self.transport.record(attribution.transport_ns);
        self.intervals.record(Series::Transport, attribution.transport_ns);
        for (index, times) in attribution.stages.iter().enumerate() {
            self.compute[index].record(times.compute_ns);
            self.intervals.record(Series::Stage(index), times.compute_ns);
        }
    }

    fn correct(&mut self, time_ns: u64) {
        self.corrected.record(time_ns);
        self.intervals.record(Series::Corrected, time_ns);
    }

    /// Stores the header if the scan is among the first or the slowest.
    fn store(&mut self, reaction_ns: u64, header: &Header) {
        if self.first.len() < MAX_FIRST {
            return self.first.push(*header);
        }
        self.slowest.insert((reaction_ns, header.scan_id), *header);
        if self.slowest.len() > MAX_SLOWEST {
            self.slowest.pop_first();
        }
    }

    /// When a scan was to be published: a third of a period after its front beam.
    fn due_ns(&self, header: &Header) -> u64 {
        header.acquired_ns + self.period_ns / 3
    }

    /// The stored scans in order: the first thousand, and the hundred slowest after them.
    pub(crate) fn stored(&self) -> Vec<Header> {
        let mut all: Vec<Header> = self.first.iter().chain(self.slowest.values()).copied().collect();
        all.sort_by_key(|header| header.scan_id);
        all
    }

    /// Scans of a stretch.
    pub(crate) fn interval_scans(&self) -> u64 {
        self.intervals.scans()
    }

    /// The lines of the log of all stretches; the stretches are then empty.
    pub(crate) fn take_lines(&mut self) -> Vec<String> {
        std::mem::replace(&mut self.intervals, Intervals::new(0)).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::latency::chain;

    const PERIOD_NS: u64 = 30_000;

    /// A scan on schedule, and its answer whose robot woke `late_ns` after the scan was due.
    fn scan(scan_id: u64, late_ns: u64) -> (Header, Actuation) {
        let acquired_ns = 1_000_000 + scan_id * PERIOD_NS;
        let due_ns = acquired_ns + PERIOD_NS / 3;
        // The emulator takes 500 ns to make a scan.
        let mut header = chain(scan_id, due_ns + late_ns + 500);
        header.acquired_ns = acquired_ns;
        header.stage_mut(Role::Robot).taken_ns = due_ns + late_ns;
        (header, Actuation { header, answers: 1, ..Actuation::default() })
    }

    fn collect(scans: impl IntoIterator<Item = (u64, u64, bool)>) -> Collector {
        let mut collector = Collector::new(PERIOD_NS, 100);
        for (scan_id, late_ns, answered) in scans {
            let (header, actuation) = scan(scan_id, late_ns);
            collector.scan(&header, if answered { std::slice::from_ref(&actuation) } else { &[] });
        }
        collector
    }

    #[test]
    fn a_late_scanner_counts_in_the_corrected_time_only() {
        let collector = collect([(1, 0, true), (2, 7_000, true)]);
        assert_eq!((collector.reaction.figures().max, collector.complete), (2.55, 2));
        assert_eq!((collector.corrected.figures().max, collector.lateness.figures().max), (9.55, 7.0));
    }

    #[test]
    fn lost_and_skipped_scans_wait_for_the_next_actuation() {
        // Scan 2 is not answered, 3 and 4 are skipped, 5 is answered 2550 + 500 - 500 after it was due.
        let collector = collect([(1, 0, true), (2, 0, false), (5, 0, true)]);
        let figures = collector.corrected.figures();
        assert_eq!((figures.count, collector.reaction.count()), (5, 2));
        let max_us = (3 * PERIOD_NS + 500 + 2550) as f64 * 1e-3;
        assert_eq!(figures.max, max_us, "{figures:?}");
    }

    #[test]
    fn the_first_scans_and_the_slowest_are_stored() {
        let collector = collect((1..=1500).map(|scan_id| (scan_id, 0, true)));
        let stored = collector.stored();
        assert_eq!(stored.len(), MAX_FIRST + MAX_SLOWEST);
        assert!(stored.is_sorted_by_key(|header| header.scan_id));
    }

    #[test]
    fn the_lines_hold_all_scans() {
        let mut collector = collect((1..=240).map(|scan_id| (scan_id, 0, true)));
        let lines = collector.take_lines();
        let read = super::super::intervals::read(&lines, "scan_to_actuation").unwrap();
        assert_eq!(read.iter().map(hdrhistogram::Histogram::len).sum::<u64>(), 240);
    }
}
