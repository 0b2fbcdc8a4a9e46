//! How the robot steers and drives beside what is described, learned from the motion that odometer and laser agree on.
//!
//! Two errors of the steering show in how the robot turns: an offset of the angle, in proportion to the way, and a share of
//! the turn that the model expects, of axles, tyres and steering map together. A Kalman filter estimates both with the yaw,
//! each a random walk; a straight way shows the offset alone, and bends show the share. The speed beside the desired one shows the factor
//! of the velocity, once it has settled. Noise beyond what is expected is measured by the innovations.
//!
//! Assumptions: the errors are small and change slowly. What is larger than [`OFFSET_MAX_RAD`] or [`SHARE_MAX`] is no
//! wear but a fault, and left for the watch over the calibration to find.

use nalgebra::{Matrix3, Vector3};
use shared_types::{Fault, finite, plain_state};
use vehicle::frame::wrap_angle;

use crate::state::variances;

/// Largest offset that is believed [rad].
pub const OFFSET_MAX_RAD: f64 = 0.012;
/// Largest share of a turn that is believed.
pub const SHARE_MAX: f64 = 0.2;
/// Standard deviation at the start: of the offset [rad], of the share of the turn and of that of the velocity.
const UNKNOWN: [f64; 3] = [0.006, 0.06, 0.05];
/// Standard deviation of the random walks after one metre: of the offset [rad], of the share of the turn and of that of the velocity.
const WALK: [f64; 3] = [1e-4, 1e-3, 5e-4];
/// A turn that is further from the expected one is none [standard deviations].
const SIGMAS: f64 = 4.0;
/// Share of a turn by which the model is wrong in each step alone.
const MODEL: f64 = 0.1;
/// Weight of the newest innovation in their mean square.
const MISFIT_WEIGHT: f64 = 0.05;
/// Standard deviation of the share of one speed [m/s].
const SPEED_MPS: f64 = 0.05;
/// A speed has settled when the expected one is the desired one to this share.
const SETTLED: f64 = 0.03;
/// Speeds below this do not determine a factor [m/s].
const SLOWEST_MPS: f64 = 0.15;

plain_state! {
    /// What is learned of steering and drive.
    pub struct Learned {
        /// Offset of the steering angle [rad], and share of a turn beyond the described one
        pub steering: [f64; 2],
        /// Yaw as the odometer reports it, without its noise [rad]
        pub yaw_rad: f64,
        /// Covariance of yaw, offset and share, column by column
        pub covariance: [f64; 9],
        /// Mean square of the innovations of the yaw [rad^2]
        pub misfit_rad2: f64,
        /// How far the yaw that the filter predicts is from that which it would predict without what is learned [rad]
        pub apart_rad: f64,
        /// Share of the speed beyond the desired one
        pub velocity: f64,
        /// Its variance
        pub velocity_variance: f64,
    }
}

/// A report of the yaw, and what the model expects.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SeenTurn {
    /// The yaw that is reported now [rad].
    pub yaw_rad: f64,
    /// The turn since the report before, by the model with what is learned [rad].
    pub expected_rad: f64,
    /// What an offset of the steering angle turns: curvature for each radian times the way.
    pub by_offset: f64,
    /// Variance of the turn by the model [rad^2].
    pub spread: f64,
    /// Variance of the noise of the report [rad^2].
    pub noise: f64,
}

impl Learned {
    /// What is known before the first drive, of a robot that reports a yaw with noise of this variance.
    pub fn begin(yaw_rad: f64, noise: f64) -> Self {
        let [offset, share, velocity] = UNKNOWN.map(|unknown| unknown * unknown);
        let mut state = Self { yaw_rad, velocity_variance: velocity, ..Self::default() };
        state.keep(&Matrix3::from_diagonal(&Vector3::new(noise, offset, share)));
        state
    }

    /// The report is taken as it is: how the robot has turned since the one before is not known.
    pub fn restart(&mut self, yaw_rad: f64, noise: f64) {
        let mut covariance = self.matrix();
        covariance.fixed_view_mut::<1, 3>(0, 0).fill(0.0);
        covariance.fixed_view_mut::<3, 1>(0, 0).fill(0.0);
        covariance[(0, 0)] = noise;
        self.keep(&covariance);
        self.yaw_rad = yaw_rad;
    }

    /// The steering angle that acts where `steering_rad` is believed [rad].
    pub fn acting(&self, steering_rad: f64) -> f64 {
        let [offset_rad, share] = self.steering;
        (steering_rad + offset_rad) * (1.0 + share)
    }

    /// Standard deviations of offset [rad], share and velocity.
    pub fn deviations(&self) -> [f64; 3] {
        [self.covariance[4], self.covariance[8], self.velocity_variance]
            .map(|variance| variance.max(0.0).sqrt())
    }

    /// The robot has moved on by a way: all may have changed a little.
    pub fn walk(&mut self, way_m: f64) {
        let [offset, share, velocity] = WALK.map(|walk| walk * walk * way_m.abs());
        self.covariance[4] += offset;
        self.covariance[8] += share;
        self.velocity_variance += velocity;
    }

    /// Takes a turn into account.
    pub fn turned(&mut self, turn: &SeenTurn) {
        let [offset_rad, share] = self.steering;
        let (by_offset, by_share) = (turn.by_offset * (1.0 + share), turn.expected_rad / (1.0 + share));
        let transition = Matrix3::new(1.0, by_offset, by_share, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        let mut covariance = transition * self.matrix() * transition.transpose();
        covariance[(0, 0)] += turn.spread + (MODEL * by_share).powi(2);
        let predicted_rad = self.yaw_rad + turn.expected_rad;
        let off_rad = wrap_angle(turn.yaw_rad - predicted_rad);
        let square = off_rad * off_rad;
        let spread = covariance[(0, 0)] + turn.noise.max(self.misfit_rad2 - covariance[(0, 0)]);
        let fits = square <= SIGMAS * SIGMAS * spread;
        if !fits {
            if turn.yaw_rad.is_finite() {
                self.restart(turn.yaw_rad, turn.noise);
            }
            return;
        }
        self.misfit_rad2 += MISFIT_WEIGHT * (square - self.misfit_rad2);
        let gain = covariance.column(0) / spread;
        let left = covariance - gain * covariance.row(0);
        let [yaw_rad, offset_rad, share] =
            (Vector3::new(predicted_rad, offset_rad, share) + gain * off_rad).into();
        self.yaw_rad = wrap_angle(yaw_rad);
        self.steering =
            [offset_rad.clamp(-OFFSET_MAX_RAD, OFFSET_MAX_RAD), share.clamp(-SHARE_MAX, SHARE_MAX)];
        self.keep(&left);
    }

    /// Takes a speed into account, where it has settled.
    pub fn driven(&mut self, seen_mps: f64, desired_mps: f64, expected_mps: f64) {
        let is_settled = (expected_mps - desired_mps).abs() <= SETTLED * desired_mps.abs();
        if !is_settled || desired_mps.abs() < SLOWEST_MPS {
            return;
        }
        let off = seen_mps / desired_mps - 1.0 - self.velocity;
        let variance = (SPEED_MPS / desired_mps).powi(2);
        let gain = self.velocity_variance / (self.velocity_variance + variance);
        self.velocity += gain * off.clamp(-SHARE_MAX, SHARE_MAX);
        self.velocity_variance *= 1.0 - gain;
    }

    /// Takes a prediction of the filter into account, which makes of this turn [rad] what is learned of it.
    pub fn predict(&mut self, expected_rad: f64, by_offset: f64) {
        let [offset_rad, share] = self.steering;
        let described_rad = expected_rad / (1.0 + share) - by_offset * offset_rad;
        self.apart_rad += expected_rad - described_rad;
    }

    /// Takes an update of the filter by this gain into account.
    pub fn correct(&mut self, gain: f64) {
        self.apart_rad *= 1.0 - gain;
    }

    /// Passes when all numbers are finite and within their bounds.
    ///
    /// # Errors
    /// [`Fault`] of the first that is not.
    pub fn check(&self) -> Result<(), Fault> {
        let Self { steering: [offset_rad, share], covariance, .. } = *self;
        finite("learned", &covariance)?;
        let Self { yaw_rad, misfit_rad2, apart_rad, velocity, velocity_variance, .. } = *self;
        finite("learned", &[yaw_rad, misfit_rad2, apart_rad, velocity, velocity_variance])?;
        variances("learned", &covariance)?;
        variances("learned", &[velocity_variance])?;
        for (value, most) in [(offset_rad, OFFSET_MAX_RAD), (share, SHARE_MAX)] {
            // NaN is within no bounds.
            if !(-most..=most).contains(&value) {
                return Err(Fault::OutOfRange { field: "learned", value });
            }
        }
        Ok(())
    }

    fn matrix(&self) -> Matrix3<f64> {
        Matrix3::from_column_slice(&self.covariance)
    }

    fn keep(&mut self, covariance: &Matrix3<f64>) {
        // Rounding makes the two halves differ.
        let symmetric = (covariance + covariance.transpose()) / 2.0;
        self.covariance.copy_from_slice(symmetric.as_slice());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns of a robot with these errors, 0.1 m each, whose steering angle follows `steer`; curvature 2 1/m for each radian.
    fn drive(offset_rad: f64, share: f64, steer: impl Fn(u32) -> f64) -> Learned {
        let mut learned = Learned::begin(0.0, 1e-6);
        let mut yaw_rad = 0.0;
        for step in 0..200 {
            let steering_rad = steer(step);
            yaw_rad += 0.2 * (steering_rad + offset_rad) * (1.0 + share);
            let expected_rad = 0.2 * learned.acting(steering_rad);
            learned.walk(0.1);
            learned.turned(&SeenTurn { yaw_rad, expected_rad, by_offset: 0.2, spread: 1e-6, noise: 1e-6 });
        }
        learned
    }

    #[test]
    fn a_straight_way_shows_the_offset_and_bends_show_the_share() {
        let straight = drive(0.008, 0.15, |_| 0.0);
        let [offset_rad, share] = straight.steering;
        assert!((offset_rad * (1.0 + share) - 0.0092).abs() < 2e-4 && share < 0.03, "{straight:?}");
        let [offset_rad, share, _] = straight.deviations();
        assert!(offset_rad < 1e-3 && share > 0.05, "{offset_rad} {share}");
        let bends = drive(0.008, 0.15, |step| 0.08 * (f64::from(step) / 8.0).sin());
        assert!(
            (bends.steering[0] - 0.008).abs() < 5e-4 && (bends.steering[1] - 0.15).abs() < 0.02,
            "{bends:?}"
        );
    }

    #[test]
    fn what_is_larger_than_wear_is_not_learned_and_a_jump_neither() {
        let broken = drive(0.05, 0.0, |_| 0.0);
        assert!(broken.steering[0] <= OFFSET_MAX_RAD, "{broken:?}");
        let mut jumped = Learned::begin(0.0, 1e-6);
        jumped.turned(&SeenTurn { yaw_rad: 0.5, by_offset: 0.2, noise: 1e-6, ..SeenTurn::default() });
        assert_eq!((jumped.yaw_rad, jumped.steering), (0.5, [0.0; 2]));
        let forged = Learned { velocity_variance: -1.0, ..jumped };
        assert_eq!(forged.deviations()[2], 0.0, "a checkpoint of any bytes gives a pose of numbers");
        jumped.turned(&SeenTurn { yaw_rad: f64::NAN, ..SeenTurn::default() });
        assert_eq!((jumped.yaw_rad, jumped.steering), (0.5, [0.0; 2]));
    }

    #[test]
    fn the_factor_of_the_velocity_is_learned_where_the_speed_has_settled() {
        let mut learned = Learned::begin(0.0, 1e-6);
        (0..100).for_each(|_| learned.driven(0.5, 1.0, 0.6));
        assert_eq!(learned, Learned::begin(0.0, 1e-6));
        (0..200).for_each(|_| learned.driven(1.03, 1.0, 1.0));
        assert!((learned.velocity - 0.03).abs() < 1e-3 && learned.deviations()[2] < 0.005, "{learned:?}");
    }
}
