//! The settings that this controller reads: part of the table `[controller]` of the system file.
//!
//! The orchestrator checks the whole table and writes it for the process, every key with its value. Keys that are not
//! named here are ignored. `docs/system-file.md` has all keys with their defaults and ranges.

use serde::Deserialize;
use serde::de::IgnoredAny;
use vehicle::Description;

/// What the controller knows of the course, of the robot and of its task.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Settings {
    /// Where to land, until another goal is set.
    pub(crate) goal: Goal,
    /// Where the robot may drive.
    pub(crate) track: Track,
    /// The way that the robot follows, where it is no line along x.
    pub(crate) course: Course,
    /// The robot: body, model, bounds, delays.
    pub(crate) vehicle: Description,
    /// Free distance to walls [m].
    pub(crate) theta_m: f64,
    /// Smallest distance of the body to an obstacle along a verified plan [m].
    pub(crate) clearance_m: f64,
    /// Velocity on a free path [m/s].
    pub(crate) cruise_mps: f64,
    /// Velocity while the estimator suspects its calibration, or the scanner is degraded [m/s].
    pub(crate) careful_mps: f64,
    /// Near the goal the velocity is the distance divided by this time [s].
    pub(crate) landing_time_s: f64,
}

/// Where to land.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct Goal {
    /// Position along the track [m].
    pub(crate) x_m: f64,
    /// Lateral position [m].
    pub(crate) y_m: f64,
    /// Distance within which the goal counts as reached [m].
    pub(crate) tolerance_m: f64,
}

/// The way that the robot follows, where it is no line along x: this controller follows none.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Course {
    /// The points that it leads through; none on the line along x.
    pub(crate) waypoints: Vec<IgnoredAny>,
}

/// Where the robot may drive.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Track {
    /// Bounds along the track [m].
    pub(crate) x_m: [f64; 2],
    /// Bounds of the robot's centre across the track, or with `walls` the surfaces of the walls [m].
    pub(crate) y_m: [f64; 2],
    /// Whether walls stand at the lateral bounds.
    pub(crate) walls: bool,
}

impl Settings {
    /// Bounds of the robot's centre across the track [m].
    pub(crate) fn y_range(&self) -> [f64; 2] {
        let room = if self.track.walls { self.vehicle.width_m / 2.0 + self.theta_m } else { 0.0 };
        [self.track.y_m[0] + room, self.track.y_m[1] - room]
    }
}

#[cfg(test)]
pub(crate) fn example() -> Settings {
    Settings {
        goal: Goal { x_m: 10.0, y_m: 0.0, tolerance_m: 0.1 },
        track: Track { x_m: [0.0, 22.0], y_m: [-1.5, 1.5], walls: false },
        course: Course { waypoints: Vec::new() },
        vehicle: Description::default(),
        theta_m: 0.2,
        clearance_m: 0.05,
        cruise_mps: 1.0,
        careful_mps: 0.3,
        landing_time_s: 0.6,
    }
}
