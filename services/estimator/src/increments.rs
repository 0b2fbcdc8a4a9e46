//! The odometer as it is: increments, and white noise on what it reports if there is any.
//!
//! An odometer of encoders and a gyro reports the sum of its increments; its noise is in the increments, and a filter that
//! takes each report for a measurement of the place only makes it worse. Other odometers have noise on each report. Which
//! of the two it is shows in the motion between reports: compared with that of the model, white noise of the report makes
//! each difference and the next one opposite, so that minus the mean of their product is its variance (innovation
//! correlation, DOI 10.1109/TAC.1970.1099422). Each component of the report is weighed by that: without noise it is taken
//! as it is.

use nalgebra::Matrix3;
use shared_types::plain_state;
use vehicle::frame::{to_robot, to_track, wrap_angle};

use crate::correction::Planar;

/// Reports over which the mean is taken at most.
const WINDOW: f64 = 64.0;
/// Weight of what is believed before the first report.
const BELIEVED: f64 = 4.0;
/// Reports after which the noise is known.
const KNOWN: f64 = 10.0;

/// An odometer has noise whose variance is more than this share of what is believed at first.
const NOISY: f64 = 0.25;

/// A slip to the side in a step below this tells nothing [m].
const SLIP_M: f64 = 1e-3;
/// So much of it in one step shows whether the odometer sees it [m].
const SEEN_M: f64 = 0.02;

plain_state! {
    /// The pose that the odometer reports, without its white noise.
    pub struct Increments {
        /// Yaw, x and y, without noise [rad, m, m]
        pub pose: [f64; 3],
        /// Variance of what is left of the noise in yaw, ahead and left [rad^2, m^2, m^2]
        pub variance: [f64; 3],
        /// Yaw, x and y as reported last [rad, m, m]
        pub reported: [f64; 3],
        /// Motion reported last beyond that of the model: turn, ahead and left [rad, m, m]
        pub excess: [f64; 3],
        /// Mean product of one such excess and the next, negative in white noise
        pub product: [f64; 3],
        /// Mean square of this excess
        pub square: [f64; 3],
        /// Variance of the noise that is believed at first [rad^2, m^2, m^2]
        pub believed: [f64; 3],
        /// Weight of this mean
        pub weight: f64,
        /// Turn rate over the last motion [rad/s]
        pub turn_radps: f64,
        /// Sums over the ways on which tyres slipped to the side: of slip times what of it was not reported, and of its square [m^2]
        pub slipped: [f64; 2],
        /// 1 when the last report repeats the one before to the bit: such an odometer integrates no bias at rest
        pub repeats: u64,
    }
}

/// A motion in the frame of the robot before it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Increment {
    /// Turn to the left [rad].
    pub turn_rad: f64,
    /// Ahead [m].
    pub ahead_m: f64,
    /// To the left [m].
    pub left_m: f64,
}

impl Increment {
    /// From one pose to another.
    pub fn between(from: Planar, to: Planar) -> Self {
        let place = to_robot(from.yaw, to.x - from.x, to.y - from.y);
        Self { turn_rad: wrap_angle(to.yaw - from.yaw), ahead_m: place.x, left_m: place.y }
    }

    fn all(&self) -> [f64; 3] {
        [self.turn_rad, self.ahead_m, self.left_m]
    }

    fn from(&self, pose: Planar) -> Planar {
        let step = to_track(pose.yaw, self.ahead_m, self.left_m);
        Planar { yaw: wrap_angle(pose.yaw + self.turn_rad), x: pose.x + step.x, y: pose.y + step.y }
    }
}

impl Increments {
    /// Begins with a first report; `noise` are the variances that it is believed to have.
    pub fn begin(reported: Planar, noise: [f64; 3]) -> Self {
        let Planar { yaw, x, y } = reported;
        let pose = [yaw, x, y];
        let product = noise.map(|variance| -variance);
        Self {
            pose,
            reported: pose,
            product,
            believed: noise,
            variance: noise,
            weight: BELIEVED,
            ..Self::default()
        }
    }

    /// Follows a report, or without a usable one the model; `expected` is the motion by the model, and `spread` the
    /// variance of its error. Returns the motion.
    pub fn follow(&mut self, reported: Option<Planar>, expected: &Increment, spread: [f64; 3]) -> Increment {
        let before = planar(self.pose);
        let predicted = expected.from(before);
        let Some(report) = reported else {
            self.keep(predicted);
            (self.reported, self.excess, self.repeats) = (self.pose, [0.0; 3], 0);
            self.variance = std::array::from_fn(|axis| self.variance[axis] + spread[axis]);
            return *expected;
        };
        let moved = Increment::between(planar(self.reported), report);
        let excess: [f64; 3] = std::array::from_fn(|axis| moved.all()[axis] - expected.all()[axis]);
        let last = std::mem::replace(&mut self.excess, excess);
        let is_known = self.is_known();
        self.weight = (self.weight + 1.0).min(WINDOW);
        for axis in 0..3 {
            self.product[axis] += (excess[axis] * last[axis] - self.product[axis]) / self.weight;
            self.square[axis] += (excess[axis] * excess[axis] - self.square[axis]) / self.weight;
        }
        if self.is_known() && !is_known {
            // What was believed is not needed any more.
            let believed = BELIEVED / (BELIEVED + KNOWN);
            for axis in 0..3 {
                self.product[axis] = (self.product[axis] + believed * self.believed[axis]) / (1.0 - believed);
            }
        }
        let off = Increment::between(predicted, report).all();
        let mut step = [0.0; 3];
        for axis in 0..3 {
            let noise = (-self.product[axis]).max(0.0);
            let variance = self.variance[axis] + spread[axis];
            let gain = variance / (variance + noise);
            step[axis] = gain * off[axis];
            self.variance[axis] = (1.0 - gain) * variance;
        }
        let [turn_rad, ahead_m, left_m] = step;
        self.keep(Increment { turn_rad, ahead_m, left_m }.from(predicted));
        let last = std::mem::replace(&mut self.reported, [report.yaw, report.x, report.y]);
        self.repeats = u64::from(self.reported == last);
        Increment::between(before, planar(self.pose))
    }

    /// What the odometer did not see of a slip to the left, by the model: the share of it that was missing in all reports. Encoders
    /// see none, others all of it.
    pub fn unseen_m(&mut self, slip_m: f64) -> f64 {
        if slip_m.abs() < SLIP_M {
            return 0.0;
        }
        let [missed, square] = self.slipped;
        self.slipped = [missed - slip_m * self.excess[2], square + slip_m * slip_m];
        let [missed, square] = self.slipped;
        slip_m * (missed / (square + SEEN_M * SEEN_M)).clamp(0.0, 1.0)
    }

    /// Takes a report as it is, and returns the motion to it.
    pub fn restart(&mut self, report: Planar) -> Increment {
        let before = planar(self.pose);
        self.keep(report);
        (self.reported, self.excess, self.repeats) = ([report.yaw, report.x, report.y], [0.0; 3], 0);
        self.variance = self.product.map(|product| (-product).max(0.0));
        Increment::between(before, report)
    }

    /// The motion that was reported since `before`.
    pub fn since(&self, before: [f64; 3]) -> Increment {
        Increment::between(planar(before), planar(self.reported))
    }

    /// Whether the reports have no noise like that which is believed at first, in yaw and to the left: stamps that are off look
    /// like noise ahead. The square of each excess would be twice its variance, and the product is as rough as there are few.
    pub fn is_clean(&self) -> bool {
        [0, 2].iter().all(|&axis| {
            let believed = self.believed[axis];
            -self.product[axis] < NOISY * believed && self.square[axis] < believed
        })
    }

    /// For how much of a time the bias of a gyro was integrated [s].
    pub fn turning_s(&self, seconds: f64) -> f64 {
        if self.repeats == 1 { 0.0 } else { seconds }
    }

    /// Whether so many reports came that their noise is known.
    pub fn is_known(&self) -> bool {
        self.weight >= BELIEVED + KNOWN
    }

    /// Covariance of (yaw, x, y) by what is left of the noise, of a robot that looks along `yaw`.
    pub fn covariance(&self, yaw: f64) -> Matrix3<f64> {
        turned(self.variance, yaw)
    }

    /// The same of a single report, as the first one is.
    pub fn first(&self, yaw: f64) -> Matrix3<f64> {
        turned(self.product.map(|product| (-product).max(0.0)), yaw)
    }

    fn keep(&mut self, pose: Planar) {
        self.pose = [pose.yaw, pose.x, pose.y];
    }
}

/// Covariance of (yaw, x, y) of variances in yaw, ahead and to the left of a robot that looks along `yaw`.
fn turned([turn, ahead, left]: [f64; 3], yaw: f64) -> Matrix3<f64> {
    let (sin, cos) = yaw.sin_cos();
    let xy = sin * cos * (ahead - left);
    let (xx, yy) = (cos * cos * ahead + sin * sin * left, sin * sin * ahead + cos * cos * left);
    Matrix3::new(turn, 0.0, 0.0, 0.0, xx, xy, 0.0, xy, yy)
}

fn planar([yaw, x, y]: [f64; 3]) -> Planar {
    Planar { yaw, x, y }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    const SPREAD: [f64; 3] = [4e-6, 1.6e-5, 4e-6];
    const BELIEVED_NOISE: [f64; 3] = [1e-4, 4e-4, 4e-4];

    /// A drive straight ahead at 1 m/s with noise on each report; the state, and the rms of its error and of the report's.
    fn drive(noise_m: f64) -> (Increments, f64, f64) {
        let mut generator = Pcg64::seed_from_u64(7);
        let mut normal = || (0..12).map(|_| generator.random::<f64>()).sum::<f64>() - 6.0;
        let mut report = |scan: u32| Planar {
            yaw: 0.0,
            x: 0.1 * f64::from(scan) + noise_m * normal(),
            y: noise_m * normal(),
        };
        let expected = Increment { ahead_m: 0.1, ..Increment::default() };
        let mut state = Increments::begin(report(0), BELIEVED_NOISE);
        let (mut squares, mut reported) = (0.0, 0.0);
        for scan in 1..=400 {
            let report = report(scan);
            state.follow(Some(report), &expected, SPREAD);
            if scan > 100 {
                squares += (state.pose[1] - 0.1 * f64::from(scan)).powi(2);
                reported += (report.x - 0.1 * f64::from(scan)).powi(2);
            }
        }
        (state, (squares / 300.0).sqrt(), (reported / 300.0).sqrt())
    }

    #[test]
    fn a_report_without_noise_is_taken_as_it_is() {
        let (state, rms_m, _) = drive(0.0);
        assert!(rms_m < 1e-6 && state.variance[1] < 1e-9, "{rms_m} {:?}", state.variance);
    }

    #[test]
    fn the_noise_of_the_reports_is_measured_and_filtered() {
        let (state, rms_m, reported_m) = drive(0.02);
        let found_m = (-state.product[1]).sqrt();
        assert!((0.013..0.027).contains(&found_m), "{found_m}");
        assert!(rms_m < 0.6 * reported_m, "{rms_m} of {reported_m}");
    }

    #[test]
    fn without_a_report_the_model_is_followed_and_the_next_one_brings_it_back() {
        let (mut state, ..) = drive(0.0);
        let expected = Increment { ahead_m: 0.12, ..Increment::default() };
        assert_eq!(state.follow(None, &expected, SPREAD), expected);
        let back = state.follow(Some(Planar { yaw: 0.0, x: 40.2, y: 0.0 }), &expected, SPREAD);
        assert!((state.pose[1] - 40.2).abs() < 1e-3 && (back.ahead_m - 0.08).abs() < 1e-3, "{back:?}");
        let moved = state.restart(Planar { yaw: 0.1, x: 41.0, y: 0.5 });
        assert!((moved.ahead_m - 0.8).abs() < 1e-3 && (moved.turn_rad - 0.1).abs() < 1e-9);
    }
}
