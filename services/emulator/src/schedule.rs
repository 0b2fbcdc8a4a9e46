//! When scans are taken, how they are stamped, and which are missing.

use crate::noise::{Purpose, Stream};
use crate::scenario::Scenario;

/// The first scans are never missing: the stages begin with them.
const NEVER_MISSING: u64 = 10;

/// The largest error of a stamp, in standard deviations.
const STAMP_ERROR_SIGMA: f64 = 3.0;

/// The schedule of scanner and odometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    seed: u64,
    period_ns: u64,
    jitter_ns: f64,
    missing_every: u64,
}

impl Schedule {
    /// The schedule of a scenario with a scan each `period_ns`.
    pub fn new(scenario: &Scenario, period_ns: u64) -> Self {
        let values = scenario.robot_values();
        Self {
            seed: scenario.seed,
            period_ns,
            jitter_ns: values.scan_stamp_jitter_s * 1e9,
            missing_every: values.scan_missing_every,
        }
    }

    /// Time of the front beam of a scan [ns].
    pub fn acquired_ns(&self, scan_id: u64) -> u64 {
        scan_id.saturating_mul(self.period_ns)
    }

    /// The time stamp of a scan [ns]: that of the front beam with a normal error.
    ///
    /// The error is at most a quarter of the period, so stamps ascend strictly.
    pub fn stamp_ns(&self, scan_id: u64) -> u64 {
        if self.jitter_ns <= 0.0 {
            return self.acquired_ns(scan_id);
        }
        let normal = Stream::new(self.seed, Purpose::Stamp, scan_id).normal();
        let largest = (STAMP_ERROR_SIGMA * self.jitter_ns).min(self.period_ns as f64 / 4.0);
        let error = (self.jitter_ns * normal).clamp(-largest, largest);
        self.acquired_ns(scan_id).saturating_add_signed(error.round() as i64)
    }

    /// Whether a scan is missing.
    pub fn is_missing(&self, scan_id: u64) -> bool {
        self.missing_every > 0
            && scan_id > NEVER_MISSING
            && Stream::new(self.seed, Purpose::Missing, scan_id).chance(1.0 / self.missing_every as f64)
    }

    /// The first scan from `scan_id` on that is not missing; `scan_id` itself where all are.
    pub fn next_scan(&self, scan_id: u64) -> u64 {
        if self.missing_every == 1 {
            return scan_id;
        }
        (scan_id..).find(|scan_id| !self.is_missing(*scan_id)).unwrap_or(scan_id)
    }
}
