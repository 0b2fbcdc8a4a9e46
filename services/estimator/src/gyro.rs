//! The yaw of a gyro in place of that of the odometry.
//!
//! A sample of the gyro has the mean yaw rate w over the time dt up to a scan. Between its reports of the scans j and k the
//! odometry says that the robot has turned by psi_k - psi_j. The gyro replaces this, and the way is turned with it:
//!
//! ```text
//! g_k      = g_j + sum over the scans j < i <= k of (w_i - b) dt_i - (psi_k - psi_j)
//! yaw_k    = psi_k + g_k
//! (x, y)_k = (x, y)_j + R((g_j + g_k) / 2) (dx, dy)
//! ```
//!
//! It replaces and is not fused by covariances, because the errors are not independent: many an odometry has a gyro in it.
//! A sample that comes after its scan replaces the turn of the odometry later, for up to [`TURNS`] scans.
//!
//! The bias b is the mean rate while the robot stands: blocked wheels, no speed, no turn. It counts after two seconds,
//! because the white noise of a short rest is larger than the bias of a good gyro. A robot that stands does not turn.
//!
//! The turn of the odometry stays when a sample is missing, does not fit its interval, is faster than the robot can turn,
//! or is stuck. Where it fails: a wrong rate that changes and that the robot could turn with is believed. The filter then
//! finds that it does not fit the steering, and the self-check stops the robot.

use shared_types::{Fault, Flag, finite, plain_state};
use vehicle::frame::{to_track, wrap_angle};

use crate::correction::Planar;

/// Scans for which a turn waits for its samples.
pub const TURNS: usize = 4;
/// Samples that wait for their scan: those of all turns that wait, and of as many scans that were lost.
const SAMPLES: usize = 2 * TURNS;
/// The time of the samples may differ from that of the turn by this share: stamps jitter, a lost scan is more.
const DT_SHARE: f64 = 0.3;
/// Largest bias [rad/s]: what a small gyro has without calibration. What the robot can turn may be exceeded by it.
pub const MAX_BIAS_RADPS: f64 = 0.1;
/// Turn in one interval that noise of a standing odometry can have: three standard deviations of 10 mrad [rad].
const REST_TURN_RAD: f64 = 0.03;
/// A robot whose wheels are blocked may slide for this long [s].
const SETTLE_S: f64 = 0.5;
/// Rest after which the bias counts [s].
const MIN_REST_S: f64 = 2.0;
/// Rest over which the bias is averaged, at most: it walks [s].
const MAX_REST_S: f64 = 60.0;
/// A rate that stays the same to the bit is stuck when the odometry has turned otherwise by this: three standard deviations
/// of its noise [rad].
const STUCK_RAD: f64 = 0.03;

/// Why a turn of the odometry was not replaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GyroFault {
    /// No sample came within [`TURNS`] scans.
    Missing,
    /// Not finite, time backwards, or another time than that of the scan.
    Interval,
    /// Faster than the robot can turn.
    TooFast,
    /// The same rate to the bit, while the odometry turns otherwise.
    Stuck,
}

impl GyroFault {
    /// All of them, as they are counted.
    pub const ALL: [Self; 4] = [Self::Missing, Self::Interval, Self::TooFast, Self::Stuck];
}

plain_state! {
    /// A sample that waits for its scan.
    pub struct GyroSample {
        /// The scan
        pub scan_id: u64,
        /// Mean yaw rate [rad/s]
        pub yaw_rate_radps: f64,
        /// Time over which it is the mean, up to the scan [s]
        pub dt_s: f64,
    }
}

plain_state! {
    /// A turn of the odometry that waits for its samples.
    pub struct OdometryTurn {
        /// Scan of the report before
        pub after_scan: u64,
        /// Scan of the report
        pub scan_id: u64,
        /// Time between them [s]
        pub dt_s: f64,
        /// Turn that the odometry reports [rad]
        pub turned_rad: f64,
        /// Largest yaw rate that the robot can have had [rad/s]
        pub limit_radps: f64,
        /// 1 when it stood
        pub stood: u64,
    }
}

plain_state! {
    /// What is known of the gyro.
    pub struct GyroState {
        /// 1 once a sample came: before, nothing is missing
        pub is_there: Flag,
        /// 1 while the rate is stuck
        pub is_stuck: Flag,
        /// How many of `samples` are used
        pub sample_count: u64,
        /// Samples that wait, the oldest first
        pub samples: [GyroSample; SAMPLES],
        /// How many of `turns` are used
        pub turn_count: u64,
        /// Turns that wait, the oldest first
        pub turns: [OdometryTurn; TURNS],
        /// Scan of the last report
        pub scan_id: u64,
        /// Yaw, x and y of the last report [rad, m, m]
        pub reported: [f64; 3],
        /// What is added to its yaw, x and y [rad, m, m]
        pub added: [f64; 3],
        /// Bias of the gyro [rad/s]
        pub bias_radps: f64,
        /// Rest that the bias is the mean of [s]
        pub rest_s: f64,
        /// Time that the robot has stood for [s]
        pub stood_s: f64,
        /// The last rate [rad/s]
        pub rate_radps: f64,
        /// How much further than the odometry the robot has turned by repetitions of it [rad]
        pub excess_rad: f64,
        /// Turns that were replaced
        pub replaced: u64,
        /// Turns that were not, by [`GyroFault::ALL`]
        pub kept: [u64; 4],
    }
}

/// What the estimator knows of the time since the report before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Interval {
    /// Scan of this report.
    pub(crate) scan_id: u64,
    /// Its length [s].
    pub(crate) dt_s: f64,
    /// Largest yaw rate that the robot can have had [rad/s].
    pub(crate) limit_radps: f64,
    /// Its wheels are blocked and have no speed.
    pub(crate) is_blocked: bool,
}

impl GyroState {
    /// Remembers a sample until its scan comes. The first one of a sensor has no time and says nothing.
    pub fn note(&mut self, sample: GyroSample) {
        self.is_there = true.into();
        if sample.dt_s == 0.0 {
            return;
        }
        if self.sample_count as usize == SAMPLES {
            self.samples.rotate_left(1);
            self.sample_count -= 1;
        }
        self.samples[self.sample_count as usize] = sample;
        self.sample_count += 1;
    }

    /// The first report, or one after which everything before is forgotten: nothing is added to it.
    pub(crate) fn begin(&mut self, scan_id: u64, reported: Planar) {
        (self.scan_id, self.reported) = (scan_id, [reported.yaw, reported.x, reported.y]);
    }

    /// The next report, with the yaw of the gyro as far as its samples are there.
    pub(crate) fn replace(&mut self, reported: Planar, interval: &Interval) -> Planar {
        let [yaw, x, y] = self.reported;
        let (after_scan, before_rad) = (self.scan_id, self.added[0]);
        self.begin(interval.scan_id, reported);
        if !self.is_there.is_set() {
            return reported;
        }
        let turned_rad = wrap_angle(reported.yaw - yaw);
        let stands = interval.is_blocked && turned_rad.abs() <= REST_TURN_RAD;
        self.stood_s = if stands { self.stood_s + interval.dt_s } else { 0.0 };
        self.wait_for(OdometryTurn {
            after_scan,
            scan_id: interval.scan_id,
            dt_s: interval.dt_s,
            turned_rad,
            limit_radps: interval.limit_radps,
            stood: u64::from(self.stood_s >= SETTLE_S),
        });
        self.settle();
        let (dx, dy) = (reported.x - x, reported.y - y);
        let turned = to_track(f64::midpoint(before_rad, self.added[0]), dx, dy);
        self.added[1] += turned.x - dx;
        self.added[2] += turned.y - dy;
        let [yaw, x, y] = self.added;
        Planar { yaw: wrap_angle(reported.yaw + yaw), x: reported.x + x, y: reported.y + y }
    }

    /// The oldest turn that waits gives its place: its samples were lost or come too late.
    fn wait_for(&mut self, turn: OdometryTurn) {
        if self.turn_count as usize == TURNS {
            self.keep(GyroFault::Missing);
            self.remove(0);
        }
        self.turns[self.turn_count as usize] = turn;
        self.turn_count += 1;
    }

    /// Replaces all turns whose samples are there, and forgets samples of scans that no turn waits for.
    fn settle(&mut self) {
        let mut index = 0;
        while index < self.turn_count as usize {
            let turn = self.turns[index];
            let is_of =
                |sample: &&GyroSample| sample.scan_id > turn.after_scan && sample.scan_id <= turn.scan_id;
            let samples = self.samples;
            let samples = samples[..self.sample_count as usize].iter().filter(is_of);
            let dt_s: f64 = samples.clone().map(|sample| sample.dt_s).sum();
            let is_backwards = samples.clone().any(|sample| sample.dt_s < 0.0);
            if !is_backwards && dt_s < turn.dt_s * (1.0 - DT_SHARE) {
                index += 1;
                continue;
            }
            self.remove(index);
            // Not the opposite comparisons: a number that is not finite fails these.
            let fits = !is_backwards && dt_s <= turn.dt_s * (1.0 + DT_SHARE);
            let is_possible = samples.clone().all(|sample| sample.yaw_rate_radps.abs() <= turn.limit_radps);
            match (fits, is_possible) {
                (false, _) => self.keep(GyroFault::Interval),
                (true, false) => self.keep(GyroFault::TooFast),
                (true, true) => self.use_samples(&turn, samples, dt_s),
            }
        }
        let from = self.turns[..self.turn_count as usize].iter().map(|turn| turn.after_scan).min();
        let from = from.unwrap_or(self.scan_id);
        let mut left = 0;
        for index in 0..self.sample_count as usize {
            if self.samples[index].scan_id > from {
                self.samples[left] = self.samples[index];
                left += 1;
            }
        }
        self.sample_count = left as u64;
    }

    fn use_samples<'s>(
        &mut self,
        turn: &OdometryTurn,
        samples: impl Iterator<Item = &'s GyroSample>,
        dt_s: f64,
    ) {
        let mut by_gyro_rad = 0.0;
        let mut is_repeated = true;
        for sample in samples {
            by_gyro_rad += sample.yaw_rate_radps * sample.dt_s;
            is_repeated &= sample.yaw_rate_radps.to_bits() == self.rate_radps.to_bits();
            self.rate_radps = sample.yaw_rate_radps;
        }
        if !is_repeated {
            (self.is_stuck, self.excess_rad) = (false.into(), 0.0);
        }
        if turn.stood == 1 {
            self.rest_s = (self.rest_s + dt_s).min(MAX_REST_S);
            self.bias_radps += (by_gyro_rad / dt_s - self.bias_radps) * (dt_s / self.rest_s).min(1.0);
        }
        let bias_radps = if self.rest_s >= MIN_REST_S { self.bias_radps } else { 0.0 };
        let by_gyro_rad = if turn.stood == 1 { 0.0 } else { by_gyro_rad - bias_radps * dt_s };
        let excess_rad = self.excess_rad + by_gyro_rad - turn.turned_rad;
        if is_repeated && (self.is_stuck.is_set() || excess_rad.abs() > STUCK_RAD) {
            // What was believed since it stuck is taken back.
            self.added[0] -= self.excess_rad;
            (self.is_stuck, self.excess_rad) = (true.into(), 0.0);
            return self.keep(GyroFault::Stuck);
        }
        self.added[0] += by_gyro_rad - turn.turned_rad;
        // The rate that repeats may have been right when it came first.
        self.excess_rad = if is_repeated { excess_rad } else { 0.0 };
        self.replaced += 1;
    }

    fn keep(&mut self, fault: GyroFault) {
        self.kept[fault as usize] += 1;
    }

    fn remove(&mut self, index: usize) {
        self.turns[index..self.turn_count as usize].rotate_left(1);
        self.turn_count -= 1;
    }

    /// Passes when an estimator can continue from this state.
    ///
    /// # Errors
    /// [`Fault`] when a number is not finite or a count is too large.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        finite("gyro", &self.reported)?;
        finite("gyro", &self.added)?;
        finite("gyro", &[self.bias_radps, self.rest_s, self.stood_s, self.rate_radps, self.excess_rad])?;
        for (count, most) in [(self.sample_count, SAMPLES), (self.turn_count, TURNS)] {
            if count > most as u64 {
                return Err(Fault::OutOfRange { field: "gyro", value: count as f64 });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
