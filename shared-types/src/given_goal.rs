//! A goal that changes while the system drives.

use crate::describe::layout;
use crate::numbering::require;
use crate::{Fault, MAX_NUMBER, finite};

layout! {
    /// A goal that takes the place of another from a scan on. All zero where none was given.
    pub struct GivenGoal(64) {
        /// The first scan for which it counts; later goals count from later scans
        pub from_scan: u64,
        /// Which goal of the drive it replaces, from 0
        pub index: u32,
        /// 1 when the robot has to stand there in the direction `yaw_rad`
        pub has_yaw: u32,
        /// Position along the course; on a line that of the track [m]
        pub x_m: f64,
        /// Position to the left of the course [m]
        pub y_m: f64,
        /// Distance within which it is reached [m]
        pub tolerance_m: f64,
        /// Direction of the robot there, in the plane [rad]
        pub yaw_rad: f64,
        /// Largest difference from that direction [rad]
        pub yaw_tolerance_rad: f64,
        /// How long the robot stands there before it drives to the next goal [s]
        pub stay_s: f64,
    }
}

impl GivenGoal {
    /// Whether it was given later than another.
    pub fn is_newer(&self, other: &Self) -> bool {
        self.from_scan > other.from_scan
    }

    pub(crate) fn check(&self) -> Result<(), Fault> {
        require("goal.from_scan", self.from_scan, MAX_NUMBER)?;
        let Self { x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s, .. } = *self;
        finite("goal", &[x_m, y_m, tolerance_m, yaw_rad, yaw_tolerance_rad, stay_s])
    }
}
