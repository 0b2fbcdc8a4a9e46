//! Detects while driving that a calibration is wrong, and which one.
//!
//! A filter with a correct model has innovations that scatter about zero. Four residuals are monitored: speed at the
//! wheels against the speed desired (while it changes, against the range from the speed that the lag explains to the
//! desired one), and the innovations of the filter ahead, to the left and in yaw, each in units of
//! its expected standard deviation. The median over the last [`WINDOW`] pieces of time decides, each of one scan or, at fast
//! rates, of some: it ignores single outliers (a
//! command that came late, a wheel that slipped), and with a correct model it has a standard deviation of 0.28. A sudden
//! jump is detected earlier: three measurements in a row that the gate refuses are enough.
//!
//! A speed is a way by a time, so stamps that jitter spread it widely, but their errors cancel over the window: the speed
//! is suspected only if the ways of the window, summed up, differ as well.
//!
//! Speed and position are reported by one odometer. Where they contradict each other in three pieces in a row, one of them is
//! wrong, and neither tells which ([`Suspect::OdometryLongitudinal`]).
//!
//! While a residual is beyond its tolerance the alarm is [`Alarm::Slow`]. When that has lasted for [`TIMEOUT_S`] of time
//! that shows something (a speed that is too slow to tell anything does not count), or the
//! estimate had to restart from refused measurements, it is [`Alarm::Stop`] and stays: the position is not known then.
//!
//! Assumptions: the noise is at most that of R (less noise delays the detection, more causes false alarms); the speed
//! follows the command no more slowly than the vehicle description says. A wrong steering map shows in the yaw only while the robot turns to one side.
//! With the printed noise of the profile `source` the innovations are not normalised, and only the speed is monitored.

use shared_types::{Alarm, Suspect, plain_state};

/// Pieces of time that a median is taken over.
pub const WINDOW: usize = 20;

/// A piece ends with the scan nearest to this time [s]: the window is 1.5 s long at least, and of one scan each at 10 Hz.
const PIECE_S: f64 = 0.08;

/// Share by which the median of the speed may differ from the one desired. A worn drive is up to 5 % off, which is
/// tolerated; an error of kv by 10 % is to be detected.
const SPEED_TOLERANCE: f64 = 0.07;

/// Share by which the way driven in the window must differ as well. Stamps that jitter by 20 ms change 2 s by 1.4 %.
const WAY_TOLERANCE: f64 = 0.035;

/// ... and so many of the standard deviations by which wheels slip that are described to.
const SLIP_SIGMAS: f64 = 4.0;

/// Largest median of an innovation, in standard deviations: 5.4 standard deviations of the median itself, about 1e-7 by
/// chance.
const INNOVATION_TOLERANCE: f64 = 1.5;

/// Largest median of the yaw's innovation, in standard deviations. An uncalibrated play of 6 mrad, taken up on one side,
/// gives 1.6, which is tolerated; 3 is a steering angle that is 11 mrad off, a fifth of the largest one.
const YAW_TOLERANCE: f64 = 3.0;

/// In an interval that is longer than the second, a steering angle that is off turns the robot by more than in the first, in
/// proportion [s].
const YAW_INTERVALS_S: [f64; 2] = [0.1, 0.15];

/// Share by which a reported speed and the reported way contradict each other, of the larger of both. What accelerates from rest
/// or is off in its calibration differs by less, or once.
const CONTRADICTION: f64 = 0.4;

/// Refused measurements in a row that count as a jump, and contradictions in a row that count. Two may be a coincidence of noise (1e-6), three are not.
pub const JUMP: u64 = 3;

/// How long an alarm may last before the robot must stop [s]; at few scans a second, as long as it takes the residuals that
/// are right again to make half of a window.
pub const TIMEOUT_S: f64 = 2.0;

/// Speeds below this do not determine a factor [m/s].
const SLOWEST_MPS: f64 = 0.15;

/// Index of a residual.
const SPEED: usize = 0;
const AHEAD: usize = 1;
const LEFT: usize = 2;
const YAW: usize = 3;
const RESIDUALS: usize = 4;

plain_state! {
    /// The last residuals, and the alarm.
    pub struct SelfCheckState {
        /// Residuals of speed (share), ahead, left and yaw (standard deviations), each in a ring
        pub residuals: [[f64; WINDOW]; RESIDUALS],
        /// Way that each residual of the speed is a share of [m]
        pub way_m: [f64; WINDOW],
        /// How many residuals were taken since the window was cleared
        pub count: [u64; RESIDUALS],
        /// Measurements refused in a row
        pub refused: u64,
        /// For how long the alarm has lasted while the scans told something of what is suspected [ns]
        pub lasted_ns: u64,
        /// Piece of the speed that has begun: its time [s], its way, and the shortest and the longest right one [m]
        pub piece: [f64; 4],
        /// Piece of the innovations that has begun: its time [s]
        pub innovation_s: f64,
        /// Piece of the reported way that has begun: its time [s], the way by the reported speed, and that by the positions [m]
        pub reported: [f64; 3],
        /// Share by which both differ in the last piece
        pub contradiction: f64,
        /// Pieces in a row in which they contradict each other
        pub contradictions: u64,
        /// What is suspected, `Suspect`
        pub suspect: u32,
        /// What the robot should do, `Alarm`
        pub alarm: u32,
    }
}

/// What one scan shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Time of the scan [ns].
    pub acquired_ns: u64,
    /// Time since the scan before [s].
    pub dt_s: f64,
    /// Speed measured at the wheels; with stamps that jitter, one of a short interval may be more than there is [m/s].
    pub speed_mps: f64,
    /// Lowest and largest mean speed of a piece that shows something [m/s].
    pub plausible_mps: [f64; 2],
    /// Speed desired by the control in force; `None` while wheels are blocked, and where it is not known [m/s].
    pub desired_mps: Option<f64>,
    /// Speed that the controls and the lag of the drive explain, at the scan before and now [m/s].
    pub expected_mps: [f64; 2],
    /// Way ahead by the positions that are reported, and its standard deviation by their noise; `None` where it is not known [m].
    pub way_m: Option<[f64; 2]>,
    /// Standard deviation by which wheels slip in a metre, where that is much [m].
    pub slip_m: f64,
    /// Innovation ahead, to the left and in yaw, in standard deviations; `None` where it is not normalised, and where the
    /// control in force is not known.
    pub innovation: Option<[f64; 3]>,
    /// Whether the gate refused the measurement.
    pub refused: bool,
    /// Whether the estimate restarted because too many were refused.
    pub restarted: bool,
}

impl Evidence {
    /// The speed in the direction of the desired one, and the lowest and the largest right one [m/s]; `None` where they are too
    /// low.
    ///
    /// A drive that is quicker than described is no fault, and encoders report the mean since the scan before, so a speed within
    /// the range of the mean expected since then, the one expected now and the one desired is as it should be.
    fn speeds(&self) -> Option<[f64; 3]> {
        let desired = self.desired_mps?;
        let ahead = 1.0_f64.copysign(desired);
        let [before, expected] = self.expected_mps.map(|mps| mps * ahead);
        let mean = f64::midpoint(before, expected);
        let (desired, speed) = (desired * ahead, self.speed_mps * ahead);
        let low = desired.min(expected);
        (low >= SLOWEST_MPS).then(|| [speed, low.min(mean).max(SLOWEST_MPS), desired.max(expected).max(mean)])
    }
}

/// The right way nearest to one, and the share by which that is beyond it.
fn beyond(way_m: f64, shortest_m: f64, longest_m: f64) -> (f64, f64) {
    let right_m = way_m.clamp(shortest_m, longest_m.max(shortest_m));
    // Without time there is no way.
    (right_m, if right_m > 0.0 { way_m / right_m - 1.0 } else { 0.0 })
}

impl SelfCheckState {
    /// Takes the evidence of one scan and decides about the alarm.
    pub fn observe(&mut self, evidence: &Evidence) {
        let speeds = evidence.speeds();
        if let Some(speeds) = speeds {
            // Only the whole piece is compared: the noise of each speed at a fast rate would be beyond one end of a wide range,
            // and within it at the other.
            let sums = [1.0, speeds[0], speeds[1], speeds[2]].map(|rate| rate * evidence.dt_s);
            (0..4).for_each(|index| self.piece[index] += sums[index]);
            if ends(self.piece[0], evidence.dt_s) {
                let [time_s, way_m, shortest_m, longest_m] = std::mem::take(&mut self.piece);
                let (right_m, residual) = beyond(way_m, shortest_m, longest_m);
                let mean_mps = 1.0_f64.copysign(evidence.desired_mps.unwrap_or_default()) * way_m / time_s;
                let [lowest_mps, largest_mps] = evidence.plausible_mps;
                if (lowest_mps..=largest_mps).contains(&mean_mps) {
                    self.way_m[self.slot(SPEED)] = right_m;
                    self.push(SPEED, residual);
                }
            }
        }
        // At standstill odometry measures no motion, so it is no evidence.
        let innovation = evidence.innovation.filter(|_| evidence.speed_mps != 0.0);
        if let Some([ahead, left, yaw]) = innovation {
            self.innovation_s += evidence.dt_s;
            if ends(self.innovation_s, evidence.dt_s) {
                self.innovation_s = 0.0;
                self.push(AHEAD, ahead);
                self.push(LEFT, left);
                let [usual_s, longest_s] = YAW_INTERVALS_S;
                let is_long = evidence.dt_s > longest_s;
                self.push(YAW, if is_long { yaw * usual_s / evidence.dt_s } else { yaw });
            }
        }
        self.compare(evidence);
        self.refused = if evidence.refused { self.refused + 1 } else { 0 };
        let suspect = if evidence.restarted || self.refused >= JUMP {
            evidence.innovation.map_or(Suspect::Position, jumped)
        } else if self.contradictions >= JUMP {
            Suspect::OdometryLongitudinal
        } else {
            self.drifted(evidence.slip_m)
        };
        let is_told = |suspect| match suspect {
            Suspect::VelocityFactor => speeds.is_some(),
            Suspect::OdometryLateral | Suspect::OdometryLongitudinal | Suspect::Steering => {
                innovation.is_some()
            }
            _ => true,
        };
        self.decide(suspect, evidence, is_told);
    }

    /// Compares the reported speed with the reported way, once they make a piece.
    fn compare(&mut self, evidence: &Evidence) {
        let Some([way_m, deviation_m]) = evidence.way_m else {
            (self.reported, self.contradictions) = ([0.0; 3], 0);
            return;
        };
        let [time_s, by_speed_m, by_place_m] = self.reported;
        let (time_s, by_speed_m) = (time_s + evidence.dt_s, by_speed_m + evidence.speed_mps * evidence.dt_s);
        self.reported = [time_s, by_speed_m, by_place_m + way_m];
        if !ends(time_s, evidence.dt_s) {
            return;
        }
        let [.., by_place_m] = std::mem::take(&mut self.reported);
        let most_m = by_speed_m.abs().max(by_place_m.abs());
        let beyond_m = (by_speed_m - by_place_m).abs() - deviation_m;
        self.contradiction = beyond_m.max(0.0) / most_m.max(SLOWEST_MPS * time_s);
        let is_one = self.contradiction > CONTRADICTION;
        self.contradictions = if is_one { self.contradictions + 1 } else { 0 };
    }

    /// What is suspected.
    pub fn suspect(&self) -> Suspect {
        Suspect::try_from(self.suspect).unwrap_or(Suspect::None)
    }

    /// What the robot should do.
    pub fn alarm(&self) -> Alarm {
        Alarm::try_from(self.alarm).unwrap_or(Alarm::Stop)
    }

    /// What the suspicion rests on: its name with the unit, the number and its limit; `None` without one.
    pub fn number(&self) -> Option<(&'static str, f64, f64)> {
        let (what, residual, limit) = match self.suspect() {
            Suspect::None | Suspect::Vehicle => return None,
            Suspect::VelocityFactor => ("error of the speed, as a share", SPEED, SPEED_TOLERANCE),
            Suspect::OdometryLateral => ("innovation to the left, in deviations", LEFT, INNOVATION_TOLERANCE),
            Suspect::OdometryLongitudinal if self.contradictions >= JUMP => {
                let what = "difference of reported speed and way, as a share";
                return Some((what, self.contradiction, CONTRADICTION));
            }
            Suspect::OdometryLongitudinal => ("innovation ahead, in deviations", AHEAD, INNOVATION_TOLERANCE),
            Suspect::Steering => ("innovation of the yaw, in deviations", YAW, YAW_TOLERANCE),
            Suspect::Heading | Suspect::Position => {
                return Some(("measurements refused in a row", self.refused as f64, (JUMP - 1) as f64));
            }
        };
        Some((what, self.median(residual)?.abs(), limit))
    }

    fn decide(&mut self, suspect: Suspect, evidence: &Evidence, is_told: impl Fn(Suspect) -> bool) {
        if self.alarm() == Alarm::Stop {
            return;
        }
        if suspect == Suspect::None {
            // A jump is over only with a measurement that fits.
            if self.refused == 0 {
                (self.suspect, self.alarm) = (Suspect::None.wire(), Alarm::None.wire());
            }
            return;
        }
        if self.alarm() == Alarm::None {
            self.lasted_ns = 0;
            // The first residual beyond its tolerance shows the cause; others may follow from it.
            self.suspect = suspect.wire();
            self.alarm = Alarm::Slow.wire();
        } else if is_told(self.suspect()) {
            self.lasted_ns = self.lasted_ns.saturating_add((evidence.dt_s * 1e9).round() as u64);
        }
        let lasted_s = self.lasted_ns as f64 * 1e-9;
        // What one measurement takes back does not wait for a window.
        let by_median = self.refused < JUMP && self.contradictions < JUMP;
        let cleared_s = if by_median { (WINDOW / 2 + 1) as f64 * evidence.dt_s } else { 0.0 };
        if evidence.restarted || lasted_s >= TIMEOUT_S.max(cleared_s) {
            self.alarm = Alarm::Stop.wire();
        }
    }

    /// The residual whose median is furthest beyond its tolerance.
    fn drifted(&self, slip_m: f64) -> Suspect {
        [
            (SPEED, SPEED_TOLERANCE, Suspect::VelocityFactor),
            (LEFT, INNOVATION_TOLERANCE, Suspect::OdometryLateral),
            (AHEAD, INNOVATION_TOLERANCE, Suspect::OdometryLongitudinal),
            (YAW, YAW_TOLERANCE, Suspect::Steering),
        ]
        .into_iter()
        .filter_map(|(residual, tolerance, suspect)| {
            Some((self.median(residual)?.abs() / tolerance, suspect)).filter(|(excess, _)| *excess > 1.0)
        })
        .filter(|(_, suspect)| *suspect != Suspect::VelocityFactor || self.way_differs(slip_m))
        .max_by(|one, other| one.0.total_cmp(&other.0))
        .map_or(Suspect::None, |(_, suspect)| suspect)
    }

    /// Median of a full window.
    fn median(&self, residual: usize) -> Option<f64> {
        if self.count[residual] < WINDOW as u64 {
            return None;
        }
        let mut sorted = self.residuals[residual];
        sorted.sort_unstable_by(f64::total_cmp);
        Some((sorted[WINDOW / 2 - 1] + sorted[WINDOW / 2]) / 2.0)
    }

    /// Whether the way driven in the window differs from the right one, to the side to which most speeds do.
    fn way_differs(&self, slip_m: f64) -> bool {
        let shares = self.residuals[SPEED].iter().zip(&self.way_m);
        let excess_m: f64 = shares.map(|(share, way_m)| share * way_m).sum();
        let side = self.median(SPEED).unwrap_or(0.0).signum();
        let all_m = self.way_m.iter().sum::<f64>();
        excess_m * side > WAY_TOLERANCE * all_m + SLIP_SIGMAS * slip_m * all_m.sqrt()
    }

    /// Where the next residual goes.
    fn slot(&self, residual: usize) -> usize {
        (self.count[residual] % WINDOW as u64) as usize
    }

    fn push(&mut self, residual: usize, value: f64) {
        self.residuals[residual][self.slot(residual)] = value;
        self.count[residual] += 1;
    }
}

/// Whether a piece of time that has got so long ends with a scan that came `dt_s` after the one before.
fn ends(piece_s: f64, dt_s: f64) -> bool {
    piece_s + dt_s / 2.0 >= PIECE_S
}

/// Which part of a pose jumped.
fn jumped([ahead, left, yaw]: [f64; 3]) -> Suspect {
    if yaw.abs() >= ahead.hypot(left) { Suspect::Heading } else { Suspect::Position }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Evidence = Evidence {
        acquired_ns: 0,
        dt_s: 0.1,
        speed_mps: 0.9,
        plausible_mps: [-0.1, 2.0],
        desired_mps: Some(0.9),
        expected_mps: [0.9; 2],
        way_m: None,
        innovation: Some([0.1, -0.1, 0.2]),
        slip_m: 0.0,
        refused: false,
        restarted: false,
    };

    /// Share by which the speed of a scan is beyond the right ones, and the right way.
    fn residual(evidence: &Evidence) -> Option<(f64, f64)> {
        let [way_m, shortest_m, longest_m] = evidence.speeds()?.map(|mps| mps * evidence.dt_s);
        let (right_m, share) = beyond(way_m, shortest_m, longest_m);
        Some((share, right_m))
    }

    /// Scans of a tenth of a second, and the alarm after each.
    fn alarms(check: &mut SelfCheckState, from: u64, scans: u64, evidence: Evidence) -> Vec<Alarm> {
        (from..from + scans)
            .map(|scan| {
                check.observe(&Evidence { acquired_ns: scan * 100_000_000, ..evidence });
                check.alarm()
            })
            .collect()
    }

    #[test]
    fn ten_percent_of_speed_is_found_after_half_a_window_slows_and_stops_after_two_seconds() {
        let mut check = SelfCheckState::default();
        assert!(alarms(&mut check, 0, 40, GOOD).iter().all(|alarm| *alarm == Alarm::None));
        let seen = alarms(&mut check, 40, 40, Evidence { speed_mps: 0.81, ..GOOD });
        let slow = seen.iter().position(|alarm| *alarm == Alarm::Slow).unwrap();
        let stop = seen.iter().position(|alarm| *alarm == Alarm::Stop).unwrap();
        // The tenth makes the median the mean of a good and a bad one, exactly at the tolerance; the eleventh decides.
        assert_eq!((slow, stop), (10, 30));
        assert_eq!(check.suspect(), Suspect::VelocityFactor);
        alarms(&mut check, 80, 40, GOOD);
        assert_eq!(check.alarm(), Alarm::Stop, "the place is not known any more");
    }

    #[test]
    fn wheels_that_are_described_to_slip_may_be_off_by_as_much() {
        for (speed_mps, is_suspected) in [(0.81, false), (0.45, true)] {
            let mut check = SelfCheckState::default();
            let slips = Evidence { speed_mps, slip_m: 0.1, ..GOOD };
            alarms(&mut check, 1, 40, slips);
            assert_eq!(check.suspect() == Suspect::VelocityFactor, is_suspected, "{speed_mps}");
        }
    }

    #[test]
    fn while_the_speed_changes_a_quicker_drive_and_the_described_one_are_both_right() {
        let ramp = Evidence { desired_mps: Some(1.0), expected_mps: [0.6; 2], ..GOOD };
        for speed_mps in [0.6, 0.8, 1.0] {
            assert_eq!(residual(&Evidence { speed_mps, ..ramp }), Some((0.0, 0.1 * speed_mps)));
        }
        // 0.54 is a tenth below what the lag explains, 1.1 a tenth above what is desired.
        let off = |speed_mps| residual(&Evidence { speed_mps, ..ramp }).unwrap().0;
        assert!((off(0.54) + 0.1).abs() < 1e-12 && (off(1.1) - 0.1).abs() < 1e-12);
        assert_eq!(residual(&Evidence { expected_mps: [0.1; 2], ..ramp }), None);
        // The mean of an interval in which it slows down from 1.0 to 0.8 m/s.
        let slows = Evidence { desired_mps: Some(0.7), expected_mps: [1.0, 0.8], speed_mps: 0.9, ..GOOD };
        assert_eq!(residual(&slows), Some((0.0, 0.1 * 0.9)));
    }

    #[test]
    fn a_speed_that_contradicts_the_way_of_three_scans_is_suspected_and_stops_the_robot() {
        let way = |speed_mps, way_m| Evidence { speed_mps, way_m: Some([way_m, 0.0]), ..GOOD };
        let suspects = |evidence, count| {
            let mut check = SelfCheckState::default();
            let seen = alarms(&mut check, 0, count, evidence);
            (seen.iter().position(|alarm| *alarm == Alarm::Slow), check)
        };
        // Twice as fast, backwards, and standing while it drives.
        for speed_mps in [1.8, -0.9, 0.0] {
            let (slow, check) = suspects(way(speed_mps, 0.09), 10);
            assert_eq!((slow, check.suspect()), (Some(2), Suspect::OdometryLongitudinal), "{speed_mps}");
            assert_eq!(check.number().map(|(_, share, _)| share > 0.4), Some(true));
        }
        assert_eq!(suspects(way(1.8, 0.09), 40).1.alarm(), Alarm::Stop);
        // A scale that is off by a third, a slow robot whose way is rounded, and noise of the positions.
        for (speed_mps, way_m, deviation_m) in [(0.9, 0.06, 0.0), (0.02, 0.0, 0.0), (0.9, 0.04, 0.03)] {
            let evidence = Evidence { way_m: Some([way_m, deviation_m]), ..way(speed_mps, way_m) };
            assert_eq!(suspects(evidence, 10).0, None, "{speed_mps} {way_m}");
        }
        // From rest with 5 m/s2: the speed at the end is twice the mean once.
        let mut check = SelfCheckState::default();
        for scan in 1..=6 {
            let speed_mps = 0.5 * f64::from(scan);
            check.observe(&way(speed_mps, (speed_mps - 0.25) * 0.1));
        }
        assert_eq!((check.alarm(), check.contradictions), (Alarm::None, 0));
    }

    #[test]
    fn backwards_the_speed_is_compared_in_its_direction() {
        let back =
            |speed_mps| Evidence { speed_mps, desired_mps: Some(-0.3), expected_mps: [-0.3; 2], ..GOOD };
        assert_eq!(residual(&back(-0.3)), Some((0.0, 0.3 * 0.1)));
        assert!((residual(&back(-0.27)).unwrap().0 + 0.1).abs() < 1e-12);
        assert!(residual(&back(0.3)).unwrap().0 < -1.0, "it drives forwards");
        assert_eq!(residual(&Evidence { expected_mps: [0.3; 2], ..back(-0.3) }), None, "it changes");
    }

    #[test]
    fn stamps_that_jitter_are_no_wrong_speed_but_a_wrong_speed_is_found_among_them() {
        // Of three intervals two are 20 % long and one is 40 % short: two of three speeds are a sixth too low.
        let drive = |factor: f64| {
            let mut check = SelfCheckState::default();
            for scan in 0..60_u64 {
                let dt_s = if scan % 3 == 2 { 0.06 } else { 0.12 };
                let speed_mps = factor * 0.9 * 0.1 / dt_s;
                check.observe(&Evidence { acquired_ns: scan * 100_000_000, dt_s, speed_mps, ..GOOD });
            }
            (check.alarm(), check.suspect())
        };
        assert_eq!(drive(1.0), (Alarm::None, Suspect::None));
        assert_eq!(drive(0.9), (Alarm::Stop, Suspect::VelocityFactor));
    }

    #[test]
    fn at_a_fast_rate_half_a_second_of_braking_is_no_wrong_factor() {
        for rate_hz in [35.0, 40.0, 100.0, 1000.0] {
            let mut check = SelfCheckState::default();
            let mut alarms = |seconds: f64, evidence: Evidence| {
                let scans = (seconds * rate_hz) as usize;
                let each = Evidence { dt_s: 1.0 / rate_hz, ..evidence };
                (0..scans).map(|_| (check.observe(&each), check.alarm()).1).max_by_key(|alarm| alarm.wire())
            };
            assert_eq!(alarms(4.0, GOOD), Some(Alarm::None));
            // Faster than it should be while it brakes; then too slow to tell anything, for longer than the alarm may last.
            let braking =
                Evidence { speed_mps: 0.2, desired_mps: Some(0.17), expected_mps: [0.18; 2], ..GOOD };
            let creeping =
                Evidence { speed_mps: 0.1, desired_mps: Some(0.1), expected_mps: [0.1; 2], ..GOOD };
            assert_eq!(alarms(0.5, braking), Some(Alarm::None), "{rate_hz}");
            assert_eq!(alarms(5.0, creeping), Some(Alarm::None), "{rate_hz}");
            // A wrong factor slows, and stops when it has been shown for long enough.
            let wrong = Evidence { speed_mps: 0.81, ..GOOD };
            assert_eq!(alarms(2.0, wrong), Some(Alarm::Slow), "{rate_hz}");
            assert_eq!(alarms(5.0, creeping), Some(Alarm::Slow), "{rate_hz}: no time with evidence");
            assert_eq!(alarms(2.1, wrong), Some(Alarm::Stop), "{rate_hz}");
        }
    }

    #[test]
    fn at_a_fast_rate_encoders_that_are_noisy_from_scan_to_scan_are_no_wrong_factor_of_a_slow_drive() {
        // It speeds up to 1 m/s as slowly as described. Each speed is 0.1 m/s off, to either side in turn.
        let speeds_up = |factor: f64| {
            let mut check = SelfCheckState::default();
            for scan in 0..1000 {
                let noise_mps = if scan % 2 == 0 { 0.1 } else { -0.1 };
                let evidence = Evidence { desired_mps: Some(1.0), expected_mps: [0.6; 2], ..GOOD };
                check.observe(&Evidence { dt_s: 0.004, speed_mps: factor * 0.6 + noise_mps, ..evidence });
            }
            check.alarm()
        };
        assert_eq!(speeds_up(1.0), Alarm::None);
        assert_ne!(speeds_up(0.9), Alarm::None);
    }

    #[test]
    fn at_few_scans_a_second_too_a_slip_may_be_over_before_it_is_final() {
        for rate_hz in [0.5, 1.0, 4.0, 10.0] {
            let mut check = SelfCheckState::default();
            let mut last = |scans, evidence: Evidence| {
                (0..scans).for_each(|_| check.observe(&Evidence { dt_s: 1.0 / rate_hz, ..evidence }));
                check.alarm()
            };
            assert_eq!(last(40, GOOD), Alarm::None);
            let wrong = Evidence { speed_mps: 0.81, ..GOOD };
            assert_eq!(last(11, wrong), Alarm::Slow, "{rate_hz}");
            assert_eq!(last(10, GOOD), Alarm::None, "{rate_hz}");
            assert_eq!(last(40, wrong), Alarm::Stop, "{rate_hz}");
        }
    }

    #[test]
    fn a_slip_of_half_a_second_is_let_pass() {
        let mut check = SelfCheckState::default();
        alarms(&mut check, 0, 40, GOOD);
        let mut seen = alarms(&mut check, 40, 5, Evidence { speed_mps: 0.3, ..GOOD });
        seen.extend(alarms(&mut check, 45, 40, GOOD));
        assert!(seen.iter().all(|alarm| *alarm == Alarm::None));
    }

    #[test]
    fn each_innovation_names_its_suspect() {
        for (innovation, suspect) in [
            ([2.0, 0.0, 0.0], Suspect::OdometryLongitudinal),
            ([0.0, -2.0, 1.6], Suspect::OdometryLateral),
            ([0.0, 0.0, -3.5], Suspect::Steering),
        ] {
            let mut check = SelfCheckState::default();
            alarms(&mut check, 0, 25, Evidence { innovation: Some(innovation), ..GOOD });
            assert_eq!((check.alarm(), check.suspect()), (Alarm::Slow, suspect));
        }
    }

    #[test]
    fn a_jump_slows_at_the_third_refusal_and_stops_when_the_estimate_restarts() {
        let jump = Evidence { innovation: Some([0.2, 1.0, 20.0]), refused: true, ..GOOD };
        let mut check = SelfCheckState::default();
        alarms(&mut check, 0, 10, GOOD);
        assert_eq!(alarms(&mut check, 10, 3, jump), [Alarm::None, Alarm::None, Alarm::Slow]);
        assert_eq!(check.suspect(), Suspect::Heading);
        assert_eq!(alarms(&mut check, 13, 1, GOOD), [Alarm::None], "a burst is over with what fits");
        alarms(&mut check, 14, 2, jump);
        assert_eq!(alarms(&mut check, 16, 1, Evidence { restarted: true, ..jump }), [Alarm::Stop]);
    }

    #[test]
    fn blocked_wheels_and_a_robot_at_rest_prove_nothing() {
        let mut check = SelfCheckState::default();
        let rest = Evidence { speed_mps: 0.0, desired_mps: None, innovation: Some([3.0; 3]), ..GOOD };
        assert!(alarms(&mut check, 0, 100, rest).iter().all(|alarm| *alarm == Alarm::None));
    }
}
