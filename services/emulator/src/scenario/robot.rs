//! What is wrong with the emulated robot and with what it measures.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use vehicle::settings;

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

settings! {
    /// True imperfections of the robot.
    #[derive(Copy)]
    pub struct Robot {
        /// Length of the body [m], 0.05 to 5.
        pub length_m: f64 = 0.56, 0.05..=5.0;
        /// Width of the body [m], 0.05 to 5.
        pub width_m: f64 = 0.40, 0.05..=5.0;
        /// Velocity sent divided by true velocity, kv, 0.1 to 10.
        pub velocity_factor: f64 = 1.4, 0.1..=10.0;
        /// Half the play between steering shaft and wheels, nu [rad], 0 to 0.1.
        pub steering_backlash_rad: f64 = 0.0, 0.0..=0.1;
        /// Angle of the shaft as a function of the angle sent.
        pub steering_map: SteeringMap = SteeringMap::Nonlinear;
        /// Deceleration with blocked wheels [m/s^2], 0.1 to 50.
        pub blocked_deceleration_mps2: f64 = 5.0, 0.1..=50.0;
        /// Share of the way that the odometry misses, df, -0.5 to 0.5.
        pub odometry_longitudinal: f64 = 0.01, -0.5..=0.5;
        /// Growth of the lateral share of the way that the odometry misses, dds of (7.38) [1/s], -1 to 1.
        pub odometry_lateral_rate: f64 = 0.0, -1.0..=1.0;
        /// When that share grows.
        pub odometry_drift: Drift = Drift::Moving;
        /// What the reported yaw is off from `odometry_jump_s` on [rad], -pi to pi.
        pub odometry_jump_rad: f64 = 0.0, -PI..=PI;
        /// When the reported yaw jumps [s], 0 to 1e6.
        pub odometry_jump_s: f64 = 0.0, 0.0..=1e6;
    }
}

settings! {
    /// Noise of scanner and odometer; standard deviations unless noted.
    #[derive(Copy)]
    pub struct Noise {
        /// Noise of a laser range at any distance [m], 0 to 1.
        pub range_m: f64 = 0.01, 0.0..=1.0;
        /// Noise of a laser range as a share of the range, 0 to 0.5; the larger of the two acts.
        pub range_share: f64 = 0.0, 0.0..=0.5;
        /// Probability that a beam gives no return, 0 to 1.
        pub dropout: f64 = 0.0, 0.0..=1.0;
        /// Probability that a beam across an edge mixes both distances, 0 to 1.
        pub mixed_pixels: f64 = 0.0, 0.0..=1.0;
        /// Noise of the reported position, on x and y each [m], 0 to 10.
        pub odometry_m: f64 = 0.0, 0.0..=10.0;
        /// Noise of the reported yaw [rad], 0 to 1.
        pub odometry_rad: f64 = 0.0, 0.0..=1.0;
    }
}
