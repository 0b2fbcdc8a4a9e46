//! How far the dead reckoning of the odometry has drifted since the start: a covariance that only grows.
//!
//! The odometry is the only measurement, so no filter can see its accumulated error. Encoders that slip give an error
//! along the way, and a gyro with noise and a bias that walks at random gives one in yaw, which turns the way behind it.
//! The errors of (yaw, x, y, bias of the gyro) are propagated through the Jacobian of the motion.
//!
//! Assumptions: calibrated scale errors and lateral errors are exact; slip is independent from metre to metre. A wrong
//! calibration is not contained: its error grows in proportion to the distance.

use nalgebra::{Matrix3, Matrix4, Vector4};
use shared_types::plain_state;

/// What makes dead reckoning drift.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DriftSources {
    /// Standard deviation of the measured distance after one metre [m].
    pub slip_m: f64,
    /// Standard deviation of the integrated yaw after one second [rad].
    pub yaw_rad: f64,
    /// Standard deviation of the gyro's bias after one second [rad/s].
    pub bias_radps: f64,
}

plain_state! {
    /// The accumulated error of dead reckoning.
    pub struct DeadReckoning {
        /// Covariance of (yaw, x, y, bias of the gyro), column by column
        pub covariance: [f64; 16],
    }
}

/// A step of the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryStep {
    /// Duration [s].
    pub seconds: f64,
    /// Distance driven [m].
    pub distance_m: f64,
    /// Standard deviation of the distance that blocked wheels may have slid [m].
    pub slid_m: f64,
    /// Displacement along the track [m].
    pub dx_m: f64,
    /// Lateral displacement [m].
    pub dy_m: f64,
    /// Direction of travel [rad].
    pub yaw_rad: f64,
}

impl DeadReckoning {
    /// Adds the errors of one step.
    pub fn grow(&mut self, sources: &DriftSources, step: &OdometryStep) {
        let OdometryStep { seconds, distance_m, slid_m, dx_m, dy_m, yaw_rad } = *step;
        let mut transition = Matrix4::identity();
        (transition[(1, 0)], transition[(2, 0)]) = (-dy_m, dx_m);
        // The bias turns the way of this step by half of what it turns the robot.
        let by_bias = Vector4::new(seconds, -dy_m * seconds / 2.0, dx_m * seconds / 2.0, 1.0);
        transition.set_column(3, &by_bias);
        let (sin, cos) = yaw_rad.sin_cos();
        let ahead = Vector4::new(0.0, cos, sin, 0.0);
        let (slip, slide) = (ahead * sources.slip_m, ahead * slid_m);
        let turn = Vector4::new(1.0, -dy_m / 2.0, dx_m / 2.0, 0.0) * sources.yaw_rad;
        let mut covariance = transition * self.matrix() * transition.transpose();
        covariance += slip * slip.transpose() * distance_m + turn * turn.transpose() * seconds;
        covariance += slide * slide.transpose();
        covariance[(3, 3)] += sources.bias_radps * sources.bias_radps * seconds;
        // Rounding makes the two halves differ.
        let symmetric = (covariance + covariance.transpose()) / 2.0;
        self.covariance.copy_from_slice(symmetric.as_slice());
    }

    /// Covariance of (yaw, x, y).
    pub fn of_pose(&self) -> Matrix3<f64> {
        self.matrix().fixed_view::<3, 3>(0, 0).into()
    }

    fn matrix(&self) -> Matrix4<f64> {
        Matrix4::from_column_slice(&self.covariance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOURCES: DriftSources = DriftSources { slip_m: 5e-3, yaw_rad: 2e-4, bias_radps: 2e-5 };

    /// Drives straight along `yaw_rad` at 1 m/s.
    fn straight(sources: DriftSources, yaw_rad: f64, seconds: u32) -> DeadReckoning {
        let mut state = DeadReckoning::default();
        let (dy_m, dx_m) = (0.1 * yaw_rad.sin(), 0.1 * yaw_rad.cos());
        for _ in 0..10 * seconds {
            state.grow(
                &sources,
                &OdometryStep { seconds: 0.1, distance_m: 0.1, slid_m: 0.0, dx_m, dy_m, yaw_rad },
            );
        }
        state
    }

    #[test]
    fn slip_grows_with_the_root_of_the_distance_along_the_way() {
        let pose = straight(DriftSources { slip_m: 5e-3, ..DriftSources::default() }, 0.0, 20).of_pose();
        assert!((pose[(1, 1)] - 25e-6 * 20.0).abs() < 1e-12 && pose[(2, 2)] == 0.0 && pose[(0, 0)] == 0.0);
    }

    #[test]
    fn white_noise_of_the_gyro_is_integrated_once_in_yaw_and_twice_across_the_way() {
        let pose = straight(DriftSources { yaw_rad: 2e-4, ..DriftSources::default() }, 0.0, 20).of_pose();
        // s^2 T, s^2 T^3 / 3 and s^2 T^2 / 2 for a speed of 1 m/s.
        assert!((pose[(0, 0)] - 4e-8 * 20.0).abs() < 1e-15);
        assert!(
            (pose[(2, 2)] / (4e-8 * 8000.0 / 3.0) - 1.0).abs() < 1e-4,
            "a sum of steps: dt^2 / 4 T^2 less"
        );
        assert!((pose[(0, 2)] / (4e-8 * 200.0) - 1.0).abs() < 1e-9 && pose[(1, 1)] == 0.0);
    }

    #[test]
    fn the_walk_of_the_bias_is_integrated_twice_in_yaw_and_three_times_across_the_way() {
        let pose = straight(DriftSources { bias_radps: 2e-5, ..DriftSources::default() }, 0.0, 20).of_pose();
        // b^2 T^3 / 3 and b^2 T^5 / 20; the bias of a step acts from the next step on: 3 dt / 2 T and 5 dt / 2 T less.
        assert!((pose[(0, 0)] / (4e-10 * 8000.0 / 3.0) - 1.0).abs() < 0.01);
        assert!((pose[(2, 2)] / (4e-10 * 3.2e6 / 20.0) - 1.0).abs() < 0.015);
    }

    #[test]
    fn the_way_turns_the_covariance() {
        let (ahead, left) = (
            straight(SOURCES, 0.0, 10).of_pose(),
            straight(SOURCES, std::f64::consts::FRAC_PI_2, 10).of_pose(),
        );
        assert!((ahead[(1, 1)] - left[(2, 2)]).abs() < 1e-12 && (ahead[(2, 2)] - left[(1, 1)]).abs() < 1e-12);
    }

    #[test]
    fn a_robot_at_rest_drifts_in_yaw_only() {
        let mut state = DeadReckoning::default();
        state.grow(
            &SOURCES,
            &OdometryStep { seconds: 10.0, distance_m: 0.0, slid_m: 0.0, dx_m: 0.0, dy_m: 0.0, yaw_rad: 0.3 },
        );
        let pose = state.of_pose();
        assert!(pose[(0, 0)] > 0.0 && pose[(1, 1)] == 0.0 && pose[(2, 2)] == 0.0);
    }
}
