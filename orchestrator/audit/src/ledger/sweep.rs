//! The samples of the robot scan by scan: it publishes one per scan on each of its topics. A sample that one topic
//! lacks was dropped before it got a number.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use shared_types::Topic;

use super::TIMEOUT_NS;

/// Topics of the robot; the truth only where it is published.
const TOPICS: [Topic; 3] = [Topic::Odometry, Topic::Scan, Topic::Truth];
const TRUTH: usize = 2;

/// Samples of each scan of one robot.
#[derive(Debug, Clone, Default)]
pub(super) struct Sweep {
    open: BTreeMap<u64, Scan>,
    settled: u64,
    has_truth: bool,
}

#[derive(Debug, Clone, Copy)]
struct Scan {
    came: [bool; TOPICS.len()],
    since_ns: u64,
}

/// A fault of a scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Lack {
    /// One topic lacks it.
    Sample(Topic, u64),
    /// All topics lack them: the robot skipped them.
    Skipped(RangeInclusive<u64>),
}

impl Sweep {
    /// An empty sweep; the scan numbered `first` is the first that must come.
    pub(super) fn new(first: u64) -> Self {
        Self { settled: first.saturating_sub(1), ..Self::default() }
    }

    /// Notes a sample of the robot.
    pub(super) fn see(&mut self, topic: Topic, scan_id: u64, now_ns: u64) {
        let Some(index) = TOPICS.iter().position(|of_robot| *of_robot == topic) else { return };
        self.has_truth |= index == TRUTH;
        if scan_id > self.settled {
            let scan = self.open.entry(scan_id).or_insert(Scan { came: [false; 3], since_ns: now_ns });
            scan.came[index] = true;
        }
    }

    /// Whether the robot has published its true state.
    pub(super) fn has_truth(&self) -> bool {
        self.has_truth
    }

    /// Notes that samples may not have been observed, so that scans so far are not judged. Returns those without any
    /// sample, which the robot may have skipped.
    pub(super) fn overflowed(&mut self) -> Vec<RangeInclusive<u64>> {
        let mut unseen = Vec::new();
        for scan_id in self.open.keys() {
            unseen.extend(between(self.settled, *scan_id));
            self.settled = *scan_id;
        }
        self.open.clear();
        unseen
    }

    /// Samples and scans that are certainly lacking: later scans are complete, or the time is up, or with `is_last`
    /// nothing can follow.
    pub(super) fn reconcile(&mut self, now_ns: u64, is_last: bool) -> Vec<Lack> {
        let mut lacks = Vec::new();
        let complete = |scan: &Scan| {
            scan.came[..TRUTH].iter().all(|came| *came) && (scan.came[TRUTH] || !self.has_truth)
        };
        let newest = self.open.iter().rev().find(|(_, scan)| complete(scan)).map_or(0, |(newest, _)| *newest);
        while let Some((&scan_id, scan)) = self.open.first_key_value() {
            let may_follow = now_ns.saturating_sub(scan.since_ns) < TIMEOUT_NS && !is_last;
            if scan_id > newest && may_follow {
                break;
            }
            lacks.extend(between(self.settled, scan_id).map(Lack::Skipped));
            let expected = if self.has_truth { TOPICS.len() } else { TRUTH };
            let missing = TOPICS.iter().zip(scan.came).take(expected).filter(|(_, came)| !came);
            lacks.extend(missing.map(|(topic, _)| Lack::Sample(*topic, scan_id)));
            self.settled = scan_id;
            self.open.pop_first();
        }
        lacks
    }
}

/// The scans between two, if there are any.
fn between(before: u64, after: u64) -> Option<RangeInclusive<u64>> {
    (before + 1 < after).then(|| before + 1..=after - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep in which these scans came on all topics.
    fn sweep(scans: &[u64]) -> Sweep {
        let mut sweep = Sweep::new(1);
        for &scan in scans {
            TOPICS.iter().for_each(|topic| sweep.see(*topic, scan, 0));
        }
        sweep
    }

    #[test]
    fn a_sample_that_one_topic_lacks_is_named() {
        let mut sweep = sweep(&[1, 2]);
        sweep.see(Topic::Truth, 3, 5);
        sweep.see(Topic::Scan, 3, 5);
        assert_eq!(sweep.reconcile(6, false), [], "the odometry may be on its way");
        assert_eq!(
            sweep.clone().reconcile(6, true),
            [Lack::Sample(Topic::Odometry, 3)],
            "it is not any more"
        );
        assert_eq!(sweep.reconcile(5 + TIMEOUT_NS, false), [Lack::Sample(Topic::Odometry, 3)]);
        assert_eq!(sweep.reconcile(6 + TIMEOUT_NS, false), []);
    }

    #[test]
    fn a_scan_that_all_topics_lack_was_skipped() {
        assert_eq!(sweep(&[1, 2, 4]).reconcile(0, false), [Lack::Skipped(3..=3)]);
        assert_eq!(sweep(&[2]).reconcile(0, false), [Lack::Skipped(1..=1)]);
    }

    #[test]
    fn a_robot_without_truth_lacks_none() {
        let mut sweep = Sweep::new(1);
        sweep.see(Topic::Scan, 1, 0);
        sweep.see(Topic::Odometry, 1, 0);
        assert_eq!(sweep.reconcile(TIMEOUT_NS, false), []);
    }

    #[test]
    fn scans_behind_a_full_buffer_are_not_judged() {
        let mut sweep = sweep(&[1, 2]);
        sweep.see(Topic::Scan, 9, 0);
        assert_eq!(sweep.overflowed(), [3..=8]);
        assert_eq!(sweep.reconcile(TIMEOUT_NS, false), []);
        assert_eq!(sweep.overflowed(), []);
    }
}
