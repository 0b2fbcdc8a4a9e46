//! The start, and whether start and goal are on the track.

use std::f64::consts::PI;

use vehicle::{Invalid, Track, settings};

settings! {
    /// Pose at the start. With `[course]` and without the keys it is that of the first waypoint, or the nearest direction of the
    /// course.
    #[derive(Copy)]
    pub struct Start {
        /// Position along the track [m].
        pub x_m: f64 = 0.0, "within `track.x_m`, or on the way of `[course]`";
        /// Lateral position [m].
        pub y_m: f64 = 0.0, "within `track.y_m`; with walls the whole body is between them";
        /// Yaw [rad].
        pub yaw_rad: f64 = 0.0, (-PI..=PI, "from which a turn stays on the track");
    }
}

/// Passes when the point is on the track.
pub(super) fn require_inside(track: &Track, x_m: f64, y_m: f64) -> Result<(), Invalid> {
    inside("x_m", x_m, track.x_m)?;
    inside("y_m", y_m, track.y_m)
}

fn inside(key: &str, value: f64, [low, high]: [f64; 2]) -> Result<(), Invalid> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Invalid::new(key, value, format!("{low} to {high}, the bounds track.{key}")))
}
