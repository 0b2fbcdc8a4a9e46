//! Settings of the description.

use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

/// Settings of the description; the defaults are the source's values where it has any.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Whether the track has walls; their returns never become obstacles.
    pub walls: bool,
    /// The track across: surfaces of the right and left wall, or the bound of the robot's centre without walls [m], -10 km to 10 km.
    pub wall_y_m: [f64; 2],
    /// Returns nearer to a wall than this belong to it [m], 0.02 to 0.5.
    pub wall_band_m: f64,
    /// Without walls, returns farther beyond the track than this cannot matter and are ignored [m], 0 to 10.
    pub beside_m: f64,
    /// Safety distance theta of (7.35) [m], 0.05 to 1.
    pub safety_distance_m: f64,
    /// Smallest semi-axis along the track, a of (7.35) [m], 0.5 to 5.
    pub long_axis_m: f64,
    /// Semi-axis along the track per semi-axis across it for wide obstacles, (7.35), 1 to 3.
    pub long_axis_ratio: f64,
    /// Length of the robot's body [m], 0.1 to 3.
    pub body_length_m: f64,
    /// Width of the robot's body [m], 0.1 to 3.
    pub body_width_m: f64,
    /// Distance that the body keeps to big or turned obstacles while its centre is outside of the ellipses [m], 0 to 1.
    pub clearance_m: f64,
    /// Depth of a body of which only the front has been seen [m], 0.01 to 1.
    pub unseen_depth_m: f64,
    /// Standard deviation of a range [m], 0.001 to 0.1.
    pub range_noise_m: f64,
    /// Standard deviation of the estimated position [m], 0.001 to 0.2.
    pub pose_noise_m: f64,
    /// Standard deviation of the estimated yaw [rad], 0.0005 to 0.1.
    pub pose_noise_rad: f64,
    /// Obstacles nearer than this are reported at their first sight, others at the second [m], 0 to 10.
    pub near_m: f64,
    /// Static obstacles are remembered until they are this far behind the robot [m], 0.5 to 10.
    pub keep_behind_m: f64,
    /// Scans that must see an obstacle's place free before it is forgotten, 1 to 20.
    pub free_scans: u32,
    /// How long a moving obstacle is extrapolated without being seen [s], 0 to 5.
    pub moving_memory_s: f64,
    /// Slower obstacles stand still [m/s], 0.02 to 1.
    pub moving_mps: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            walls: false,
            wall_y_m: [-1.5, 1.5],
            wall_band_m: 0.12,
            beside_m: 0.6,
            safety_distance_m: 0.2,
            long_axis_m: 1.2,
            long_axis_ratio: 1.15,
            body_length_m: 0.56,
            body_width_m: 0.40,
            clearance_m: 0.1,
            unseen_depth_m: 0.1,
            range_noise_m: 0.02,
            pose_noise_m: 0.015,
            pose_noise_rad: 0.01,
            near_m: 2.0,
            keep_behind_m: 3.0,
            free_scans: 3,
            moving_memory_s: 1.0,
            moving_mps: 0.1,
        }
    }
}

impl Config {
    /// Passes when every number is finite and in its range.
    ///
    /// # Errors
    /// [`Invalid`] with the first key out of range.
    pub fn validate(&self) -> Result<(), Invalid> {
        let [low, high] = self.wall_y_m;
        require("wall_y_m[0]", low, -1e4..=1e4)?;
        require("wall_y_m[1]", high, -1e4..=1e4)?;
        if high - low < 0.5 {
            return Err(Invalid::new(
                "wall_y_m",
                format!("[{low}, {high}]"),
                "the second at least 0.5 m above the first",
            ));
        }
        require("wall_band_m", self.wall_band_m, 0.02..=0.5)?;
        require("beside_m", self.beside_m, 0.0..=10.0)?;
        require("safety_distance_m", self.safety_distance_m, 0.05..=1.0)?;
        require("long_axis_m", self.long_axis_m, 0.5..=5.0)?;
        require("long_axis_ratio", self.long_axis_ratio, 1.0..=3.0)?;
        require("body_length_m", self.body_length_m, 0.1..=3.0)?;
        require("body_width_m", self.body_width_m, 0.1..=3.0)?;
        require("clearance_m", self.clearance_m, 0.0..=1.0)?;
        require("unseen_depth_m", self.unseen_depth_m, 0.01..=1.0)?;
        require("range_noise_m", self.range_noise_m, 0.001..=0.1)?;
        require("pose_noise_m", self.pose_noise_m, 0.001..=0.2)?;
        require("pose_noise_rad", self.pose_noise_rad, 0.0005..=0.1)?;
        require("near_m", self.near_m, 0.0..=10.0)?;
        require("keep_behind_m", self.keep_behind_m, 0.5..=10.0)?;
        require("free_scans", f64::from(self.free_scans), 1.0..=20.0)?;
        require("moving_memory_s", self.moving_memory_s, 0.0..=5.0)?;
        require("moving_mps", self.moving_mps, 0.02..=1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_swapped_walls_are_refused_by_name() {
        assert_eq!(Config::default().validate(), Ok(()));
        let nan = Config { clearance_m: f64::NAN, ..Config::default() };
        assert_eq!(nan.validate().unwrap_err().key, "clearance_m");
        let swapped = Config { wall_y_m: [1.5, -1.5], ..Config::default() };
        assert_eq!(swapped.validate().unwrap_err().key, "wall_y_m");
    }
}
