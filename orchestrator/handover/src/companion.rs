//! The swap of a companion: decisions without clock, process or bus.
//!
//! A companion is no part of the loop, so a new process may take over as soon as it is connected. With bounds on fields
//! of its topics it first runs in shadow, as the candidate of a role does: its samples of each scan are compared with those
//! of the old process. After enough scans in a row within the bounds it takes over. After its first [`WARM_UP`] scans a
//! difference beyond a bound refuses it, with the value and the bound.
//!
//! Limit: the old process ends at the handover, so there is no standby and no rollback. A new one that dies after it is
//! started again like any companion.

use std::collections::BTreeMap;

use crate::swap::{Certificate, Party, SwapOutcome, WARM_UP};

/// Scans whose samples of one process wait for those of the other, at most.
const MAX_WAITING: usize = 64;

/// How far the numbers of one field may differ.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldBound {
    /// The topic.
    pub topic: String,
    /// The field.
    pub field: String,
    /// Largest difference of any of its numbers, in their unit.
    pub bound: f64,
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum CompanionStep {
    /// Nothing yet.
    Wait,
    /// The new process takes over.
    TakeOver,
    /// The new process is ended.
    Refuse(String),
}

/// The numbers of each bounded field of a sample.
type Numbers = Vec<Vec<f64>>;

/// One swap of a companion.
#[derive(Debug, Clone)]
pub struct CompanionSwap {
    bounds: Vec<FieldBound>,
    shadow_scans: u64,
    warm_up: u32,
    agreed: u64,
    /// Numbers of the bounded fields, by scan and topic: of the old process and of the new one.
    waiting: BTreeMap<(u64, String), [Option<Numbers>; 2]>,
    /// Topics of the scan that is being compared, and whether all agreed so far.
    compared: BTreeMap<u64, usize>,
    refused: Option<String>,
    /// Scans with a sample of the first bounded topic that counts, since the first one of the new process.
    counted: BTreeMap<u64, u64>,
    certificate: Certificate,
}

impl CompanionSwap {
    /// A swap of the companion `name`; without bounds the new process takes over as soon as it is connected.
    pub fn new(name: &str, from: &str, to: &str, bounds: Vec<FieldBound>, shadow_scans: u64) -> Self {
        let certificate = Certificate {
            role: name.to_owned(),
            from: from.to_owned(),
            to: to.to_owned(),
            ..Certificate::default()
        };
        Self {
            bounds,
            shadow_scans,
            warm_up: WARM_UP,
            agreed: 0,
            waiting: BTreeMap::new(),
            compared: BTreeMap::new(),
            refused: None,
            counted: BTreeMap::new(),
            certificate,
        }
    }

    /// The bounds.
    pub fn bounds(&self) -> &[FieldBound] {
        &self.bounds
    }

    /// A sample of a topic has come: the numbers of each bounded field, in the order of the bounds of that topic.
    pub fn see(&mut self, topic: &str, side: Party, scan: u64, numbers: Vec<Vec<f64>>) {
        let key = (scan, topic.to_owned());
        let pair = self.waiting.entry(key.clone()).or_default();
        pair[side as usize].get_or_insert(numbers);
        if let [Some(old), Some(new)] = pair {
            let difference = difference(&self.bounds, topic, old, new);
            self.waiting.remove(&key);
            self.judge(scan, difference);
        }
        while self.waiting.len() > MAX_WAITING {
            self.waiting.pop_first();
        }
    }

    fn judge(&mut self, scan: u64, difference: Option<String>) {
        if let Some(difference) = difference {
            self.agreed = 0;
            self.compared.clear();
            if self.warm_up == 0 {
                self.refused.get_or_insert(format!("scan {scan}: {difference}"));
            }
            self.warm_up = self.warm_up.saturating_sub(1);
            return;
        }
        self.warm_up = self.warm_up.saturating_sub(1);
        let mut topics: Vec<&str> = self.bounds.iter().map(|bound| bound.topic.as_str()).collect();
        topics.dedup();
        let compared = self.compared.entry(scan).or_default();
        *compared += 1;
        if *compared >= topics.len() {
            self.compared = self.compared.split_off(&(scan + 1));
            self.agreed += 1;
        }
    }

    /// A sample that readers use has come, of any topic without a bound or with one; counts scans answered twice.
    pub fn count(&mut self, scan: u64) {
        *self.counted.entry(scan).or_default() += 1;
    }

    /// What is to be done now that the new process is connected.
    pub fn step(&self) -> CompanionStep {
        match &self.refused {
            Some(reason) => CompanionStep::Refuse(reason.clone()),
            None if self.bounds.is_empty() || self.agreed >= self.shadow_scans => CompanionStep::TakeOver,
            None => CompanionStep::Wait,
        }
    }

    /// Scans in a row on which both agreed.
    pub fn agreed(&self) -> u64 {
        self.agreed
    }

    /// The certificate of a new process that counts from `scan` on.
    pub fn taken_over(mut self, scan: u64) -> Certificate {
        let scans: Vec<u64> = self.counted.keys().copied().collect();
        let steps = scans.windows(2).map(|pair| pair[1] - pair[0] - 1);
        // A companion may answer every other scan: only gaps wider than before count.
        let usual = steps.clone().min().unwrap_or(0);
        self.certificate.missed_scans = steps.map(|gap| gap - usual).sum();
        self.certificate.duplicate_scans = self.counted.values().map(|count| count - 1).sum();
        self.certificate.shadow_scans = self.agreed;
        self.certificate.last_scan_old = Some(scan.saturating_sub(1));
        self.certificate.first_scan_new = Some(scan);
        self.certificate.outcome = SwapOutcome::Swapped;
        self.certificate
    }

    /// The certificate of a new process that was ended.
    pub fn refused(mut self, reason: &str) -> Certificate {
        self.certificate.shadow_scans = self.agreed;
        self.certificate.reason = reason.to_owned();
        self.certificate.outcome = SwapOutcome::Refused;
        self.certificate
    }
}

/// The first field of a topic whose numbers differ by more than its bound. Numbers that are not finite always do.
fn difference(bounds: &[FieldBound], topic: &str, old: &[Vec<f64>], new: &[Vec<f64>]) -> Option<String> {
    let of_topic = bounds.iter().filter(|bound| bound.topic == topic);
    of_topic.zip(old.iter().zip(new)).find_map(|(FieldBound { field, bound, .. }, (old, new))| {
        let off = |(old, new): (&f64, &f64)| (old - new).abs();
        let differences = old.iter().zip(new).map(off);
        let beyond = |difference: &f64| !difference.is_finite() || difference > bound;
        let difference = differences.clone().find(beyond)?;
        Some(format!("field {field} of topic {topic} differs by {difference:.6}, allowed are {bound}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn swap(shadow_scans: u64) -> CompanionSwap {
        let bound =
            |field: &str, bound| FieldBound { topic: "imu".to_owned(), field: field.to_owned(), bound };
        let bounds = vec![bound("yaw_rate_radps", 0.1), bound("axes", 1.0)];
        CompanionSwap::new("sensor", "./old", "./new", bounds, shadow_scans)
    }

    /// Both processes publish for a scan; the new one's rate is off by so much.
    fn scan(swap: &mut CompanionSwap, scan: u64, off: f64) {
        swap.see("imu", Party::Old, scan, vec![vec![0.5], vec![1.0, 2.0]]);
        swap.see("imu", Party::New, scan, vec![vec![0.5 + off], vec![1.5, 2.5]]);
    }

    #[test]
    fn without_bounds_it_takes_over_at_once_and_with_bounds_after_enough_scans_that_agree() {
        assert_eq!(CompanionSwap::new("sensor", "a", "b", Vec::new(), 10).step(), CompanionStep::TakeOver);
        let mut swap = swap(3);
        (1..=2).for_each(|id| scan(&mut swap, id, 0.09));
        swap.see("imu", Party::New, 3, vec![vec![0.5], vec![1.0, 2.0]]);
        assert_eq!(swap.step(), CompanionStep::Wait, "the old one has not answered");
        scan(&mut swap, 3, 0.0);
        assert_eq!(swap.step(), CompanionStep::TakeOver);
        let certificate = swap.taken_over(7);
        assert_eq!((certificate.shadow_scans, certificate.outcome), (3, SwapOutcome::Swapped));
        assert_eq!((certificate.last_scan_old, certificate.first_scan_new), (Some(6), Some(7)));
    }

    #[test]
    fn a_difference_starts_the_count_again_and_refuses_after_the_warm_up_with_value_and_bound() {
        let mut swap = swap(10);
        (1..=3).for_each(|id| scan(&mut swap, id, 0.0));
        scan(&mut swap, 4, 0.2);
        assert_eq!((swap.agreed(), swap.step()), (0, CompanionStep::Wait));
        scan(&mut swap, 5, 0.0);
        scan(&mut swap, 6, f64::NAN);
        let CompanionStep::Refuse(reason) = swap.step() else { panic!("{swap:?}") };
        assert!(reason.starts_with("scan 6: field yaw_rate_radps of topic imu differs by NaN"), "{reason}");
        let certificate = swap.refused(&reason);
        assert_eq!(certificate.outcome, SwapOutcome::Refused);
        assert!(certificate.to_string().contains("./new was refused, ./old keeps driving"));
    }

    #[test]
    fn scans_that_neither_answers_are_missed_unless_the_companion_answers_every_other_one() {
        let mut every = swap(1);
        [1, 2, 3, 5, 6, 6].into_iter().for_each(|scan| every.count(scan));
        let certificate = every.taken_over(5);
        assert_eq!((certificate.missed_scans, certificate.duplicate_scans), (1, 1));
        let mut other = swap(1);
        [2, 4, 6, 8].into_iter().for_each(|scan| other.count(scan));
        assert_eq!(other.taken_over(6).missed_scans, 0);
    }
}
