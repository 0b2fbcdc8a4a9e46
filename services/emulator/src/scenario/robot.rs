//! What is wrong with the emulated robot and with what it measures.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use vehicle::{Setting, settings};

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

impl Setting for Drift {}

settings! {
    /// Body and imperfections of the emulated robot.
    #[derive(Copy)]
    pub struct Robot {
        /// Length of the body [m].
        pub length_m: f64 = 0.56, 0.05..=5.0;
        /// Width of the body [m].
        pub width_m: f64 = 0.40, 0.05..=5.0;
        /// Velocity sent divided by the true velocity, kv.
        pub velocity_factor: f64 = 1.4, 0.1..=10.0;
        /// Half the play between steering shaft and wheels, nu [rad].
        pub steering_backlash_rad: f64 = 0.0, 0.0..=0.1;
        /// True steering angle of the shaft as a function of the angle sent: a fixed curve, or the same angle.
        pub steering_map: SteeringMap = SteeringMap::Nonlinear;
        /// Deceleration while the wheels are blocked [m/s^2].
        pub blocked_deceleration_mps2: f64 = 5.0, 0.1..=50.0;
        /// Odometry scale error: fraction of the travelled distance that is not reported, df.
        pub odometry_longitudinal: f64 = 0.01, -0.5..=0.5;
        /// Growth of the lateral odometry error, dds of (7.38) [1/s].
        pub odometry_lateral_rate: f64 = 0.0, -1.0..=1.0;
        /// When the lateral odometry error grows: while the robot moves, or with time, also at standstill.
        pub odometry_drift: Drift = Drift::Moving;
        /// Error of the reported yaw from `odometry_jump_s` on [rad].
        pub odometry_jump_rad: f64 = 0.0, -PI..=PI;
        /// Time at which the reported yaw jumps [s].
        pub odometry_jump_s: f64 = 0.0, 0.0..=1e6;
    }
}

settings! {
    /// Noise of scanner and odometer; standard deviations unless stated otherwise.
    #[derive(Copy)]
    pub struct Noise {
        /// Noise of a range at any distance [m].
        pub range_m: f64 = 0.01, 0.0..=1.0;
        /// Noise of a range as a fraction of the range; the larger of `range_m` and this acts.
        pub range_share: f64 = 0.0, 0.0..=0.5;
        /// Probability that a beam gives no return.
        pub dropout: f64 = 0.0, 0.0..=1.0;
        /// Probability that a beam across an edge mixes both distances.
        pub mixed_pixels: f64 = 0.0, 0.0..=1.0;
        /// White noise of the reported x and y; it does not accumulate [m].
        pub odometry_m: f64 = 0.0, 0.0..=10.0;
        /// White noise of the reported yaw; it does not accumulate [rad].
        pub odometry_rad: f64 = 0.0, 0.0..=1.0;
    }
}
