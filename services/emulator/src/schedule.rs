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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Robot;

    const PERIOD: u64 = 100_000_000;

    fn schedule(jitter_s: f64, missing_every: u64, period_ns: u64) -> Schedule {
        let robot = Robot {
            scan_stamp_jitter_s: Some(jitter_s),
            scan_missing_every: Some(missing_every),
            ..Robot::default()
        };
        Schedule::new(&Scenario { robot, ..Scenario::default() }, period_ns)
    }

    fn errors(schedule: &Schedule, count: u64) -> Vec<f64> {
        let error = |scan_id| schedule.stamp_ns(scan_id) as f64 - schedule.acquired_ns(scan_id) as f64;
        (1..=count).map(error).collect()
    }

    #[test]
    fn stamps_err_as_asked_for_and_by_three_deviations_at_most() {
        let errors = errors(&schedule(0.002, 0, PERIOD), 20_000);
        let mean = errors.iter().sum::<f64>() / 2e4;
        let deviation = (errors.iter().map(|error| error * error).sum::<f64>() / 2e4).sqrt();
        // The standard error of the mean is 14 us; cutting at three deviations takes 0.7 % of the deviation.
        assert!(mean.abs() < 6e4, "{mean}");
        assert!((deviation / 2e6 - 0.993).abs() < 0.02, "{deviation}");
        let largest = errors.iter().fold(0.0, |largest: f64, error| largest.max(error.abs()));
        assert!((5.9e6..=6e6).contains(&largest), "{largest}");
    }

    #[test]
    fn stamps_ascend_however_large_their_errors() {
        let schedule = schedule(1.0, 0, PERIOD);
        let stamps: Vec<u64> = (1..5000).map(|scan_id| schedule.stamp_ns(scan_id)).collect();
        assert!(stamps.windows(2).all(|pair| pair[1] >= pair[0] + PERIOD / 2));
        assert!(errors(&self::schedule(0.0, 0, PERIOD), 100).iter().all(|error| *error == 0.0));
    }

    #[test]
    fn one_scan_in_so_many_is_missing_but_none_of_the_first_ten() {
        let schedule = schedule(0.0, 50, PERIOD);
        let missing = (1..=100_000).filter(|scan_id| schedule.is_missing(*scan_id)).count();
        // 2000 of them, with a standard deviation of 44.
        assert!((1800..2200).contains(&missing), "{missing}");
        assert!((0..=100_000).all(|scan_id| !self::schedule(0.0, 0, PERIOD).is_missing(scan_id)));
        let all = self::schedule(0.0, 1, PERIOD);
        assert_eq!((1..=20).filter(|scan_id| all.is_missing(*scan_id)).count(), 10);
        assert_eq!((all.next_scan(3), all.next_scan(15)), (3, 15));
    }

    #[test]
    fn the_next_scan_is_the_first_that_is_not_missing() {
        let schedule = schedule(0.0, 2, PERIOD);
        for scan_id in 1..200 {
            let next = schedule.next_scan(scan_id);
            assert!(!schedule.is_missing(next));
            assert!((scan_id..next).all(|scan_id| schedule.is_missing(scan_id)));
        }
    }
}
