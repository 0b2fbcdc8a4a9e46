//! Track, start and goal.

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require, settings};

/// Bounds of the track.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Track {
    /// Bound along the track, (7.45) [m], within -10 km to 10 km.
    pub x_m: [f64; 2],
    /// Bound across the track, (7.46) [m], within -1 km to 1 km; the surfaces of the walls where there are any.
    pub y_m: [f64; 2],
    /// Whether walls that the scanner sees stand at `y_m`.
    pub walls: bool,
}

/// Pose at the start.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// Position along the track [m], inside it.
    pub x_m: f64,
    /// Lateral position [m], inside the track.
    pub y_m: f64,
    /// Yaw [rad], -pi to pi.
    pub yaw_rad: f64,
}

settings! {
    /// Where to land.
    #[derive(Copy)]
    pub struct Goal {
        /// Position along the track [m], inside it.
        pub x_m: f64 = 10.0;
        /// Lateral position [m], inside the track.
        pub y_m: f64 = 0.0;
        /// Largest distance of the robot's centre that counts as reached [m], 0.001 to 10.
        pub tolerance_m: f64 = 0.1, 0.001..=10.0;
    }
}

impl Default for Track {
    fn default() -> Self {
        Self { x_m: [0.0, 22.0], y_m: [-1.5, 1.5], walls: false }
    }
}

impl Track {
    pub(super) fn validate(&self) -> Result<(), Invalid> {
        bounds("x_m", self.x_m, 10_000.0)?;
        bounds("y_m", self.y_m, 1_000.0)
    }

    /// Passes when the point is on the track.
    fn require_inside(&self, x: f64, y: f64) -> Result<(), Invalid> {
        inside("x_m", x, self.x_m)?;
        inside("y_m", y, self.y_m)
    }
}

impl Start {
    pub(super) fn validate(&self, track: &Track) -> Result<(), Invalid> {
        track.require_inside(self.x_m, self.y_m)?;
        require("yaw_rad", self.yaw_rad, -std::f64::consts::PI..=std::f64::consts::PI)
    }
}

impl Goal {
    pub(super) fn validate(&self, track: &Track) -> Result<(), Invalid> {
        track.require_inside(self.x_m, self.y_m)?;
        self.require_ranges()
    }
}

fn bounds(key: &str, [low, high]: [f64; 2], limit: f64) -> Result<(), Invalid> {
    let allowed = -limit..=limit;
    if allowed.contains(&low) && allowed.contains(&high) && low < high {
        return Ok(());
    }
    let words = format!("two numbers from {} to {limit}, the smaller one first", -limit);
    Err(Invalid::new(key, format!("[{low}, {high}]"), words))
}

fn inside(key: &str, value: f64, [low, high]: [f64; 2]) -> Result<(), Invalid> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Invalid::new(key, value, format!("{low} to {high}, the bounds track.{key}")))
}
