//! When scans are taken, how they are stamped, and which are missing.
//!
//! Scans are taken each period, or at irregular times as by a driver that is delayed at times: scan k is due at k T, its
//! driver is ready a random time later, and two scans are at least the shortest period apart:
//!
//! ```text
//! t(k) = max(k T + delay(k), t(k-1) + shortest),   0 <= delay(k) <= longest - T
//! ```
//!
//! So a long period is followed by short ones, no period is outside the bounds, and the mean is T. Nine of ten delays are
//! uniform up to a quarter of the largest, one of ten up to all of it. Only the last few scans can delay one, so the
//! time of each scan follows from the seed alone.

use crate::noise::{NoiseStream, Purpose};
use crate::scenario::{Scanner, Scenario};

/// The largest error of a stamp, in standard deviations.
const STAMP_ERROR_SIGMA: f64 = 3.0;

/// Share of the scans whose delay may be the largest.
const LONG_DELAYS: f64 = 0.1;

/// Largest delay of the other scans, as a share of the largest of all.
const SHORT_DELAY: f64 = 0.25;

/// A delay lasts for this many scans at most; a larger one is cut.
const MAX_DELAYED: u64 = 100;

/// The schedule of scanner and odometer.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    seed: u64,
    period_ns: u64,
    /// Time from the front beam to the end of the sweep [ns].
    pub(crate) after_front_ns: u64,
    jitter_ns: f64,
    missing_every: u64,
    /// Faults that act for a time.
    scanner: Scanner,
    /// Shortest time between two irregular scans [ns].
    shortest_ns: u64,
    /// Largest delay of a scan; zero for a regular scanner [ns].
    max_delay_ns: u64,
}

impl Schedule {
    /// The schedule of a scenario with a scan each `period_ns`.
    pub fn new(scenario: &Scenario, period_ns: u64) -> Self {
        let values = scenario.robot_values();
        let [shortest_ns, longest_ns] = scenario.scanner.periods_ns().unwrap_or([period_ns; 2]);
        let caught_up_ns = period_ns.saturating_sub(shortest_ns);
        Self {
            seed: scenario.seed,
            period_ns,
            after_front_ns: scenario.true_scanner().after_front_ns(period_ns),
            jitter_ns: values.scan_stamp_jitter_s * 1e9,
            missing_every: values.scan_missing_every,
            scanner: scenario.scanner.clone(),
            shortest_ns,
            max_delay_ns: longest_ns.saturating_sub(period_ns).min(MAX_DELAYED.saturating_mul(caught_up_ns)),
        }
    }

    /// Time of the front beam of a scan [ns].
    pub fn acquired_ns(&self, scan_id: u64) -> u64 {
        let due_ns = scan_id.saturating_mul(self.period_ns);
        if self.max_delay_ns == 0 {
            return due_ns;
        }
        let caught_up_ns = self.period_ns - self.shortest_ns;
        let delaying = 0..=self.max_delay_ns.div_ceil(caught_up_ns).min(scan_id);
        let delay_ns = delaying
            .map(|scans| self.delay_ns(scan_id - scans).saturating_sub(scans.saturating_mul(caught_up_ns)));
        due_ns.saturating_add(delay_ns.max().unwrap_or(0))
    }

    /// How long the driver is delayed at a scan [ns].
    fn delay_ns(&self, scan_id: u64) -> u64 {
        if !self.scanner.acts_at(scan_id.saturating_mul(self.period_ns)) {
            return 0;
        }
        let mut stream = NoiseStream::new(self.seed, Purpose::Period, scan_id);
        let share = if stream.chance(LONG_DELAYS) { 1.0 } else { SHORT_DELAY };
        (self.max_delay_ns as f64 * share * stream.uniform()) as u64
    }

    /// When the sweep of a scan is complete: when its last beam is taken [ns].
    pub fn complete_ns(&self, scan_id: u64) -> u64 {
        self.acquired_ns(scan_id).saturating_add(self.after_front_ns)
    }

    /// When a scan is published: when its sweep is complete, or later by `scanner.late_s`, in the order of scans [ns].
    pub fn ready_ns(&self, scan_id: u64) -> u64 {
        let (late_ns, end_ns) = ((self.scanner.late_s * 1e9).round() as u64, self.scanner.end_ns());
        // Scans after the fault wait for the last late one.
        let last_late = scan_id.min(end_ns.saturating_sub(1) / self.period_ns);
        let late_scan = (0..=last_late).rev().find(|scan_id| self.acquired_ns(*scan_id) < end_ns);
        match late_scan.filter(|scan_id| late_ns > 0 && self.scanner.acts_at(self.acquired_ns(*scan_id))) {
            Some(late) => self.complete_ns(scan_id).max(self.complete_ns(late).saturating_add(late_ns)),
            None => self.complete_ns(scan_id),
        }
    }

    /// The time stamp of a scan [ns]: that of the front beam with a normal error.
    ///
    /// The error is at most a quarter of the time to the scans before and after it, so stamps ascend strictly.
    pub fn stamp_ns(&self, scan_id: u64) -> u64 {
        let (acquired_ns, jitter_ns) = (self.acquired_ns(scan_id), self.jitter_ns_of(scan_id));
        if jitter_ns <= 0.0 {
            return acquired_ns;
        }
        let normal = NoiseStream::new(self.seed, Purpose::Stamp, scan_id).normal();
        let before_ns = acquired_ns - self.acquired_ns(scan_id.saturating_sub(1));
        let nearest_ns = before_ns.min(self.acquired_ns(scan_id.saturating_add(1)) - acquired_ns);
        let largest = (STAMP_ERROR_SIGMA * jitter_ns).min(nearest_ns as f64 / 4.0);
        let error = (jitter_ns * normal).clamp(-largest, largest);
        acquired_ns.saturating_add_signed(error.round() as i64)
    }

    /// Whether the scanner gives no ranges for a scan.
    pub fn is_missing(&self, scan_id: u64) -> bool {
        let missing_every = self.missing_every_of(scan_id);
        missing_every > 0
            && NoiseStream::new(self.seed, Purpose::Missing, scan_id).chance(1.0 / missing_every as f64)
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
    fn one_scan_in_so_many_is_missing_from_the_first_on() {
        let schedule = schedule(0.0, 50, PERIOD);
        let missing = (1..=100_000).filter(|scan_id| schedule.is_missing(*scan_id)).count();
        // 2000 of them, with a standard deviation of 44.
        assert!((1800..2200).contains(&missing), "{missing}");
        assert!((0..=100_000).all(|scan_id| !self::schedule(0.0, 0, PERIOD).is_missing(scan_id)));
        let all = self::schedule(0.0, 1, PERIOD);
        assert!((1..=20).all(|scan_id| all.is_missing(scan_id)));
    }

    /// Times between scans [ms].
    fn periods(schedule: &Schedule, time_ns: fn(&Schedule, u64) -> u64) -> Vec<f64> {
        let times: Vec<u64> = (1..=20_000).map(|scan_id| time_ns(schedule, scan_id)).collect();
        times.windows(2).map(|pair| (pair[1] - pair[0]) as f64 / 1e6).collect()
    }

    #[test]
    fn irregular_periods_fill_their_bounds_and_have_the_nominal_mean() {
        let irregular = faulty(Robot::default(), "period_s = [0.005, 0.255]");
        let found = periods(&irregular, Schedule::acquired_ns);
        let longest = found.iter().copied().fold(0.0, f64::max);
        let shortest = found.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(
            (5.0..5.001).contains(&shortest) && (250.0..=255.0).contains(&longest),
            "{shortest} {longest}"
        );
        let mean = found.iter().sum::<f64>() / found.len() as f64;
        // The first and the last delay, of 155 ms at most, in 20,000 periods.
        assert!((mean - 100.0).abs() < 0.01, "{mean}");
        let gaps = found.iter().filter(|period| **period > 150.0).count();
        assert!((400..1200).contains(&gaps), "about one in twenty-five is a gap: {gaps}");
        let other = Schedule { seed: 7, ..irregular.clone() };
        assert_ne!(other.acquired_ns(50), irregular.acquired_ns(50));
        assert!((0..20_000).all(|scan_id| irregular.acquired_ns(scan_id) - scan_id * PERIOD <= 155_000_000));
    }

    #[test]
    fn stamps_of_irregular_scans_ascend_however_large_their_errors() {
        let irregular = faulty(Robot::default(), "period_s = [0.005, 0.255]\nstamp_jitter_s = 1");
        let found = periods(&irregular, Schedule::stamp_ns);
        assert!(found.iter().all(|period| *period >= 2.5 - 1e-5));
        assert_ne!(irregular.stamp_ns(9), irregular.acquired_ns(9));
    }

    #[test]
    fn bounds_around_the_nominal_period_hold_also_where_a_delay_lasts_long() {
        for (keys, bounds) in [
            ("period_s = [0.09, 0.11]", 90.0..=110.0),
            ("period_s = [0.0999, 0.5]", 99.9..=500.0),
            ("period_s = [0.1, 0.5]", 100.0..=100.0),
        ] {
            let found = periods(&faulty(Robot::default(), keys), Schedule::acquired_ns);
            assert!(found.iter().all(|period| bounds.contains(period)), "{keys}");
        }
    }

    #[test]
    fn scans_are_irregular_while_the_fault_acts_and_late_in_their_order() {
        let timed =
            faulty(Robot::default(), "period_s = [0.005, 0.255]\nlate_s = 0.2\nfrom_s = 5\nto_s = 15");
        let delay = |scan_id: u64| timed.acquired_ns(scan_id) - scan_id * PERIOD;
        assert!((0..50).chain(152..300).all(|scan_id| delay(scan_id) == 0));
        assert!((50..150).filter(|scan_id| delay(*scan_id) > 0).count() > 90);
        let ready: Vec<u64> = (1..300).map(|scan_id| timed.ready_ns(scan_id)).collect();
        assert!(ready.windows(2).all(|pair| pair[0] <= pair[1]));
        for scan_id in 1..300 {
            let is_late = timed.ready_ns(scan_id) >= timed.complete_ns(scan_id) + 200_000_000;
            let acts = (5_000_000_000..15_000_000_000).contains(&timed.acquired_ns(scan_id));
            assert_eq!(is_late, acts, "scan {scan_id}");
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
}
