//! What is wrong with the emulated robot and with what it measures.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

use crate::steering_map::SteeringMap;

/// When the lateral error of the odometry grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Drift {
    /// While the robot moves.
    #[default]
    Moving,
    /// With time, also at standstill: (7.38) as printed.
    Time,
}

/// True imperfections of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Robot {
    /// Length of the body [m], 0.05 to 5.
    pub length_m: f64,
    /// Width of the body [m], 0.05 to 5.
    pub width_m: f64,
    /// Velocity sent divided by true velocity, kv, 0.1 to 10.
    pub velocity_factor: f64,
    /// Half the play between steering shaft and wheels, nu [rad], 0 to 0.1.
    pub steering_backlash_rad: f64,
    /// Angle of the shaft as a function of the angle sent.
    pub steering_map: SteeringMap,
    /// Deceleration with blocked wheels [m/s^2], 0.1 to 50.
    pub blocked_deceleration_mps2: f64,
    /// Share of the way that the odometry misses, df, -0.5 to 0.5.
    pub odometry_longitudinal: f64,
    /// Growth of the lateral share of the way that the odometry misses, dds of (7.38) [1/s], -1 to 1.
    pub odometry_lateral_rate: f64,
    /// When that share grows.
    pub odometry_drift: Drift,
    /// What the reported yaw is off from `odometry_jump_s` on [rad], -pi to pi.
    pub odometry_jump_rad: f64,
    /// When the reported yaw jumps [s], 0 to 1e6.
    pub odometry_jump_s: f64,
}

/// Noise of scanner and odometer; standard deviations unless said otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Noise of a laser range at any distance [m], 0 to 1.
    pub range_m: f64,
    /// Noise of a laser range as a share of the range, 0 to 0.5; the larger of the two acts.
    pub range_share: f64,
    /// Probability that a beam gives no return, 0 to 1.
    pub dropout: f64,
    /// Probability that a beam across an edge mixes both distances, 0 to 1.
    pub mixed_pixels: f64,
    /// Noise of the reported position, on x and y each [m], 0 to 10.
    pub odometry_m: f64,
    /// Noise of the reported yaw [rad], 0 to 1.
    pub odometry_rad: f64,
}

impl Default for Robot {
    fn default() -> Self {
        Self {
            length_m: 0.56,
            width_m: 0.40,
            velocity_factor: 1.4,
            steering_backlash_rad: 0.0,
            steering_map: SteeringMap::Nonlinear,
            blocked_deceleration_mps2: 5.0,
            odometry_longitudinal: 0.01,
            odometry_lateral_rate: 0.0,
            odometry_drift: Drift::Moving,
            odometry_jump_rad: 0.0,
            odometry_jump_s: 0.0,
        }
    }
}

impl Default for Noise {
    fn default() -> Self {
        Self {
            range_m: 0.01,
            range_share: 0.0,
            dropout: 0.0,
            mixed_pixels: 0.0,
            odometry_m: 0.0,
            odometry_rad: 0.0,
        }
    }
}

impl Robot {
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        require("length_m", self.length_m, 0.05..=5.0)?;
        require("width_m", self.width_m, 0.05..=5.0)?;
        require("velocity_factor", self.velocity_factor, 0.1..=10.0)?;
        require("steering_backlash_rad", self.steering_backlash_rad, 0.0..=0.1)?;
        require("blocked_deceleration_mps2", self.blocked_deceleration_mps2, 0.1..=50.0)?;
        require("odometry_longitudinal", self.odometry_longitudinal, -0.5..=0.5)?;
        require("odometry_lateral_rate", self.odometry_lateral_rate, -1.0..=1.0)?;
        require("odometry_jump_rad", self.odometry_jump_rad, -PI..=PI)?;
        require("odometry_jump_s", self.odometry_jump_s, 0.0..=1e6)
    }
}

impl Noise {
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        require("range_m", self.range_m, 0.0..=1.0)?;
        require("range_share", self.range_share, 0.0..=0.5)?;
        require("dropout", self.dropout, 0.0..=1.0)?;
        require("mixed_pixels", self.mixed_pixels, 0.0..=1.0)?;
        require("odometry_m", self.odometry_m, 0.0..=10.0)?;
        require("odometry_rad", self.odometry_rad, 0.0..=1.0)
    }
}
