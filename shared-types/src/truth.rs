//! What the emulated robot really does.

use crate::fault::finite;
use crate::sample::sample;
use crate::{Fault, Header};

sample! {
    /// True state at the time of the front beam, and what the referee needs to judge the drive.
    pub struct Truth(456, Truth, 0xf003_defc, "scanloop.Truth.v2", check) {
        /// Identity of the scan published with it
        pub header: Header,
        /// Time since the start of the run at the front beam [s]
        pub time_s: f64,
        /// True position along the track [m]
        pub x_m: f64,
        /// True lateral position [m]
        pub y_m: f64,
        /// True yaw [rad]
        pub yaw_rad: f64,
        /// True sideslip [rad]
        pub sideslip_rad: f64,
        /// True yaw rate [rad/s]
        pub yaw_rate_radps: f64,
        /// True speed over ground, negative backwards [m/s]
        pub speed_mps: f64,
        /// True steering angle at the wheels [rad]
        pub steering_rad: f64,
        /// Distance of the body to the nearest obstacle or wall now; 1e9 when there is none [m]
        pub clearance_m: f64,
        /// Smallest such distance since the start, checked at each plant step [m]
        pub min_clearance_m: f64,
        /// Distance driven since the start [m]
        pub path_length_m: f64,
        /// Largest lateral offset from the line y = start since the start [m]
        pub max_abs_lateral_m: f64,
        /// Distance of the robot's centre to the goal [m]
        pub goal_distance_m: f64,
        /// Longest time that the wheels turned without a new actuation, checked at each plant step [s]
        pub longest_blind_s: f64,
        /// Time since the last actuation arrived [s]
        pub actuation_age_s: f64,
        /// 1 while the wheels are blocked
        pub blocked: u32,
        /// 1 when the body has touched an obstacle or a wall while the wheels turned
        pub collided: u32,
        /// 1 when a moving obstacle has touched the body while it stood still
        pub struck: u32,
        /// 1 when the dead man of the robot has blocked the wheels
        pub dead_man: u32,
        /// Scan that the last actuation answered
        pub actuation_scan: u64,
        /// Actuations refused by the robot since the start: not finite or beyond its limits
        pub refused: u64,
        /// Plant steps since the start
        pub steps: u64,
        /// Unused, zero
        pub reserved: u64,
    }
}

fn check(truth: &Truth) -> Result<(), Fault> {
    truth.header.check::<Truth>()?;
    finite(
        "truth",
        &[truth.x_m, truth.y_m, truth.yaw_rad, truth.speed_mps, truth.steering_rad, truth.clearance_m],
    )
}
