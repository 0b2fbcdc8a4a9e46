//! All that the estimator remembers, as plain bytes: the working state is the checkpoint.

use nalgebra::Matrix3;
use shared_types::{Fault, Flag, finite, plain_state};

use crate::correction::CorrectionState;
use crate::dead_reckoning::DeadReckoning;
use crate::gyro::GyroState;
use crate::increments::Increments;
use crate::laser::LaserState;
use crate::learned::Learned;
use crate::motion::{HISTORY, MotionState};
use crate::self_check::{SelfCheckState, WINDOW};

plain_state! {
    /// All that the estimator remembers from sample to sample.
    pub struct EstimatorState {
        /// 1 once there is an estimate
        pub initialised: Flag,
        /// Incarnation that the last odometry came from
        pub incarnation: u32,
        /// Sequence number of the last odometry
        pub sequence: u64,
        /// Time of the estimate: acquisition of the last odometry [ns]
        pub acquired_ns: u64,
        /// When the newest actuation was published that is known [ns]
        pub actuated_ns: u64,
        /// When the newest block that the actuator decided by itself takes effect, if the robot receives it [ns]
        pub own_block_ns: u64,
        /// Time from the acquisition of a sample to its use that is usual [ns]
        pub usual_age_ns: u64,
        /// Estimated (yaw, x, y) [rad, m, m]
        pub estimate: [f64; 3],
        /// Covariance of (yaw, x, y), column by column, which is row by row as it is symmetric
        pub covariance: [f64; 9],
        /// Mean NIS per measured state: 1 when innovations are as large as Q and R make expect
        pub misfit: f64,
        /// The odometer as increments
        pub increments: Increments,
        /// The pose that follows from them, and the accumulated error of the odometry, which the filter cannot see
        pub reckoning: DeadReckoning,
        /// How the robot steers and drives beside what is described
        pub learned: Learned,
        /// The gyro that replaces the yaw of the odometry
        pub gyro: GyroState,
        /// Correction of measured data
        pub correction: CorrectionState,
        /// Speed, sideslip, yaw rate, and the controls in force
        pub motion: MotionState,
        /// Measurements refused by the gate since the start
        pub rejected: u64,
        /// Measurements refused by the gate in a row
        pub rejected_in_a_row: u64,
        /// Restarts of the estimate from a measurement
        pub restarts: u64,
        /// Odometry samples that were not newer than the estimate
        pub skipped: u64,
        /// Odometry samples that could not be used because of their content, or with which the model made an impossible pose
        pub invalid: u64,
        /// The watch over the calibration
        pub self_check: SelfCheckState,
        /// What became of the scans
        pub laser: LaserState,
    }
}

/// No variance is larger, whatever its unit: a position that is unknown by a thousand kilometres.
const MAX_VARIANCE: f64 = 1e12;

/// Passes when the diagonal of a covariance, column by column, is one that an estimator can write.
///
/// # Errors
/// [`Fault::OutOfRange`] of the first variance that is not.
pub(crate) fn variances<const N: usize>(field: &'static str, covariance: &[f64; N]) -> Result<(), Fault> {
    let states = N.isqrt();
    let wrong =
        (0..states).map(|i| covariance[i * (states + 1)]).find(|value| !(0.0..=MAX_VARIANCE).contains(value));
    wrong.map_or(Ok(()), |value| Err(Fault::OutOfRange { field, value }))
}

impl EstimatorState {
    /// Passes when an estimator can continue from this state.
    ///
    /// # Errors
    /// [`Fault`] when a number is not finite, a covariance is not one, or a count is too large.
    pub fn check(&self) -> Result<(), Fault> {
        finite("estimate", &self.estimate)?;
        finite("covariance", &self.covariance)?;
        variances("covariance", &self.covariance)?;
        finite("misfit", &[self.misfit])?;
        self.gyro.check()?;
        let reckoning: &[f64; 51] = bytemuck::cast_ref(&self.reckoning);
        finite("reckoning", reckoning)?;
        let increments: &[f64; 26] = bytemuck::cast_ref(&self.increments);
        finite("increments", increments)?;
        self.learned.check()?;
        self.laser.map.check()?;
        self.laser.key.check()?;
        let LaserState { search, offset, .. } = &self.laser;
        finite("search", &[search.score])?;
        finite("search", &search.best)?;
        finite("offset", &[offset.offset_m, offset.more_m])?;
        finite("correction", bytemuck::cast_ref::<_, [f64; 9]>(&self.correction))?;
        let residuals: &[f64; 4 * WINDOW] = bytemuck::cast_ref(&self.self_check.residuals);
        finite("self_check", residuals)?;
        finite("self_check", &self.self_check.piece)?;
        finite("self_check", &[self.self_check.innovation_s])?;
        let motion = &self.motion;
        let MotionState { speed_mps, expected_mps, steering_rad, sideslip_rad, yaw_rate_radps, .. } = *motion;
        finite("motion", &[speed_mps, expected_mps, steering_rad, sideslip_rad, yaw_rate_radps])?;
        for control in &motion.controls {
            finite("controls", &[control.velocity_mps, control.steering_rad])?;
        }
        if motion.count > HISTORY as u64 {
            return Err(Fault::OutOfRange { field: "count", value: motion.count as f64 });
        }
        if self.initialised.is_set() && Matrix3::from_column_slice(&self.covariance).cholesky().is_none() {
            return Err(Fault::OutOfRange { field: "covariance", value: self.covariance[0] });
        }
        Ok(())
    }
}
