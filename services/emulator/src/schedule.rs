//! When scans are taken, how they are stamped, and which are missing.

use crate::noise::{Purpose, Stream};
use crate::scenario::{Scanner, Scenario};

/// The first scans are never missing: the stages begin with them.
const NEVER_MISSING: u64 = 10;

/// The largest error of a stamp, in standard deviations.
const STAMP_ERROR_SIGMA: f64 = 3.0;

/// The schedule of scanner and odometer.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    seed: u64,
    period_ns: u64,
    jitter_ns: f64,
    missing_every: u64,
    /// Faults that act for a time.
    scanner: Scanner,
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
            scanner: scenario.scanner.clone(),
        }
    }

    /// Time of the front beam of a scan [ns].
    pub fn acquired_ns(&self, scan_id: u64) -> u64 {
        scan_id.saturating_mul(self.period_ns)
    }

    /// When the sweep of a scan is complete: a third of the period after its front beam [ns].
    pub fn complete_ns(&self, scan_id: u64) -> u64 {
        self.acquired_ns(scan_id).saturating_add(self.period_ns / 3)
    }

    /// When a scan is published: when its sweep is complete, or later by `scanner.late_s`, in the order of scans [ns].
    pub fn ready_ns(&self, scan_id: u64) -> u64 {
        let late_ns = (self.scanner.late_s * 1e9).round() as u64;
        // Scans after the fault wait for the last late one.
        let last_late = self.scanner.end_ns().saturating_sub(1) / self.period_ns;
        let late_scan = scan_id.min(last_late);
        if late_ns == 0 || !self.scanner.acts_at(self.acquired_ns(late_scan)) {
            return self.complete_ns(scan_id);
        }
        self.complete_ns(scan_id).max(self.complete_ns(late_scan).saturating_add(late_ns))
    }

    /// The time stamp of a scan [ns]: that of the front beam with a normal error.
    ///
    /// The error is at most a quarter of the period, so stamps ascend strictly.
    pub fn stamp_ns(&self, scan_id: u64) -> u64 {
        let jitter_ns = self.jitter_ns_of(scan_id);
        if jitter_ns <= 0.0 {
            return self.acquired_ns(scan_id);
        }
        let normal = Stream::new(self.seed, Purpose::Stamp, scan_id).normal();
        let largest = (STAMP_ERROR_SIGMA * jitter_ns).min(self.period_ns as f64 / 4.0);
        let error = (jitter_ns * normal).clamp(-largest, largest);
        self.acquired_ns(scan_id).saturating_add_signed(error.round() as i64)
    }

    /// Whether a scan is missing.
    pub fn is_missing(&self, scan_id: u64) -> bool {
        let missing_every = self.missing_every_of(scan_id);
        missing_every > 0
            && scan_id > NEVER_MISSING
            && Stream::new(self.seed, Purpose::Missing, scan_id).chance(1.0 / missing_every as f64)
    }

    /// The first scan from `scan_id` on that is not missing; `scan_id` itself where all are.
    pub fn next_scan(&self, scan_id: u64) -> u64 {
        if self.missing_every == 1 {
            return scan_id;
        }
        (scan_id..).find(|scan_id| !self.is_missing(*scan_id)).unwrap_or(scan_id)
    }

    /// Standard deviation of a stamp's error: the larger one of robot and scanner [ns].
    fn jitter_ns_of(&self, scan_id: u64) -> f64 {
        let acts = self.scanner.acts_at(self.acquired_ns(scan_id));
        if acts { self.jitter_ns.max(self.scanner.stamp_jitter_s * 1e9) } else { self.jitter_ns }
    }

    /// One scan in this many is missing: the smaller number of robot and scanner, 0 for none.
    fn missing_every_of(&self, scan_id: u64) -> u64 {
        let acts = self.scanner.acts_at(self.acquired_ns(scan_id));
        match (self.missing_every, self.scanner.missing_every) {
            (robot, scanner) if !acts || scanner == 0 => robot,
            (0, scanner) => scanner,
            (robot, scanner) => robot.min(scanner),
        }
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

    fn faulty(robot: Robot, keys: &str) -> Schedule {
        let scenario = Scenario::parse(&format!("[scanner]\n{keys}"), "test").unwrap();
        Schedule::new(&Scenario { robot, ..scenario }, PERIOD)
    }

    #[test]
    fn late_scans_are_ready_later_and_those_after_them_keep_the_order() {
        let ready = |keys: &str| {
            let schedule = faulty(Robot::default(), keys);
            [1, 2, 3, 4, 5, 6, 7, 8].map(|scan_id| schedule.ready_ns(scan_id) / 1_000_000)
        };
        assert_eq!(ready(""), [133, 233, 333, 433, 533, 633, 733, 833]);
        assert_eq!(ready("late_s = 0.05"), [183, 283, 383, 483, 583, 683, 783, 883]);
        assert_eq!(
            ready("late_s = 0.05\nfrom_s = 0.3\nto_s = 0.5"),
            [133, 233, 383, 483, 533, 633, 733, 833]
        );
        // Scan 4 is published at 683 ms; scans 5 and 6, complete by then, come with it.
        assert_eq!(
            ready("late_s = 0.25\nfrom_s = 0.3\nto_s = 0.5"),
            [133, 233, 583, 683, 683, 683, 733, 833]
        );
        assert_eq!(ready("late_s = 0.25\nfrom_s = 0.31\nto_s = 0.39"), ready(""), "no scan in this time");
        let late = faulty(Robot::default(), "late_s = 0.05");
        assert_eq!((late.acquired_ns(3), late.stamp_ns(3)), (3 * PERIOD, 3 * PERIOD));
        assert_eq!(late.complete_ns(3), 333_333_333);
    }

    #[test]
    fn the_larger_error_of_stamps_acts_while_the_fault_does() {
        let robot = Robot { scan_stamp_jitter_s: Some(0.002), ..Robot::default() };
        let (alone, small) = (faulty(robot, ""), faulty(robot, "stamp_jitter_s = 0.001"));
        let large = faulty(robot, "stamp_jitter_s = 0.006\nfrom_s = 5\nto_s = 15");
        for scan_id in 1..200 {
            let error = |schedule: &Schedule| schedule.stamp_ns(scan_id) as f64 - (scan_id * PERIOD) as f64;
            let factor = if (50..150).contains(&scan_id) { 3.0 } else { 1.0 };
            // Both are rounded to nanoseconds.
            assert!((error(&large) - factor * error(&alone)).abs() <= 2.0, "scan {scan_id}");
            assert_eq!(error(&small), error(&alone));
        }
    }

    #[test]
    fn of_robot_and_scanner_the_one_that_loses_more_scans_acts() {
        let robot = |every| Robot { scan_missing_every: Some(every), ..Robot::default() };
        let missing = |schedule: &Schedule| -> Vec<u64> {
            (1..=2000).filter(|scan_id| schedule.is_missing(*scan_id)).collect()
        };
        let (rare, frequent) = (missing(&faulty(robot(50), "")), missing(&faulty(robot(5), "")));
        assert_eq!(missing(&faulty(robot(50), "missing_every = 5")), frequent);
        assert_eq!(missing(&faulty(robot(5), "missing_every = 50")), frequent);
        assert_eq!(missing(&faulty(robot(0), "missing_every = 5")), frequent);
        let timed = missing(&faulty(robot(50), "missing_every = 5\nfrom_s = 100"));
        let before = rare.iter().filter(|scan_id| **scan_id < 1000);
        let after = frequent.iter().filter(|scan_id| **scan_id >= 1000);
        assert_eq!(timed, before.chain(after).copied().collect::<Vec<_>>());
        // 398 with a standard deviation of 18.
        assert!((320..480).contains(&frequent.len()), "{}", frequent.len());
    }

    #[test]
    fn after_a_time_without_any_scan_they_come_again() {
        let silent = faulty(Robot::default(), "missing_every = 1\nfrom_s = 2\nto_s = 3");
        assert_eq!((silent.next_scan(19), silent.next_scan(20), silent.next_scan(31)), (19, 30, 31));
    }
}
