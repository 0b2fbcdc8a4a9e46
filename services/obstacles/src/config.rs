//! Settings of the description.

use vehicle::{Invalid, require, settings};

settings! {
    /// Settings of the description; the defaults are the source's values where it has any.
    #[derive(Copy)]
    pub struct Config {
        /// Whether the track has walls; their returns never become obstacles.
        pub walls: bool = false;
        /// The track across: surfaces of the right and left wall, or the bound of the robot's centre without walls [m], -10 km to 10 km.
        pub wall_y_m: [f64; 2] = [-1.5, 1.5];
        /// Returns nearer to a wall than this belong to it [m], 0.02 to 0.5.
        pub wall_band_m: f64 = 0.12, 0.02..=0.5;
        /// Without walls, returns farther beyond the track than this cannot matter and are ignored [m], 0 to 10.
        pub beside_m: f64 = 0.6, 0.0..=10.0;
        /// Safety distance theta of (7.35) [m], 0.05 to 1.
        pub safety_distance_m: f64 = 0.2, 0.05..=1.0;
        /// Smallest semi-axis along the track, a of (7.35) [m], 0.5 to 5.
        pub long_axis_m: f64 = 1.2, 0.5..=5.0;
        /// Semi-axis along the track per semi-axis across it for wide obstacles, (7.35), 1 to 3.
        pub long_axis_ratio: f64 = 1.15, 1.0..=3.0;
        /// Length of the robot's body [m], 0.1 to 3.
        pub body_length_m: f64 = 0.56, 0.1..=3.0;
        /// Width of the robot's body [m], 0.1 to 3.
        pub body_width_m: f64 = 0.40, 0.1..=3.0;
        /// Distance that the body keeps to big or turned obstacles while its centre is outside of the ellipses [m], 0 to 1.
        pub clearance_m: f64 = 0.1, 0.0..=1.0;
        /// Depth of a body of which only the front has been seen [m], 0.01 to 1.
        pub unseen_depth_m: f64 = 0.1, 0.01..=1.0;
        /// Standard deviation of a range [m], 0.001 to 0.1.
        pub range_noise_m: f64 = 0.02, 0.001..=0.1;
        /// Standard deviation of the estimated position [m], 0.001 to 0.2.
        pub pose_noise_m: f64 = 0.015, 0.001..=0.2;
        /// Standard deviation of the estimated yaw [rad], 0.0005 to 0.1.
        pub pose_noise_rad: f64 = 0.01, 0.0005..=0.1;
        /// Obstacles nearer than this are reported at their first sight, others at the second [m], 0 to 10.
        pub near_m: f64 = 2.0, 0.0..=10.0;
        /// Static obstacles are remembered until they are this far behind the robot [m], 0.5 to 10.
        pub keep_behind_m: f64 = 3.0, 0.5..=10.0;
        /// Scans that must see an obstacle's place free before it is forgotten, 1 to 20.
        pub free_scans: u32 = 3, 1.0..=20.0;
        /// How long a moving obstacle is extrapolated without being seen [s], 0 to 5.
        pub moving_memory_s: f64 = 1.0, 0.0..=5.0;
        /// Slower obstacles stand still [m/s], 0.02 to 1.
        pub moving_mps: f64 = 0.1, 0.02..=1.0;
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
        self.require_ranges()
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
