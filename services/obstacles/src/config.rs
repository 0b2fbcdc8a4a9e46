//! Settings of the description.

use serde::{Deserialize, Serialize};
use vehicle::{Ascending, Course, Description, Invalid, Setting, Surroundings, Track, settings};

/// How large the ellipses are that cover an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CoverRule {
    /// As small as the body of the robot and `tight_clearance_m` allow; the controller adds its margin.
    #[default]
    Tight,
    /// (7.35) as printed: the semi-axis across the track is the whole width and twice the safety distance.
    Source,
}

impl Setting for CoverRule {}

/// Share of all beams that return something in any surroundings.
pub const SWEEP_SHARE: f64 = 0.04;

settings! {
    /// Settings of the obstacle detector; the defaults are the source's values where it has any.
    pub struct ObstaclesConfig {
        /// The way that the robot follows; `run` takes it from the scenario.
        pub course: Course = Course::default();
        /// Whether the track has walls, whose returns are never obstacles; `run` takes it from the scenario.
        pub walls: bool = false;
        /// Surfaces of the right and left wall, or without walls the lateral bounds of the track; `run` takes them from the
        /// scenario [m].
        pub wall_y_m: [f64; 2] = [-1.5, 1.5], Ascending(-1e4..=1e4, Track::MIN_WIDTH_M);
        /// Ends of the track along it; `run` takes them from the scenario [m].
        pub track_x_m: [f64; 2] = [-1e4, 1e4], Ascending(-1e4..=1e4, 0.0);
        /// Returns within this distance of a wall belong to the wall [m].
        pub wall_band_m: f64 = 0.12, 0.02..=0.5;
        /// Obstacles at rest farther than this outside of the track are not described where it has no walls [m].
        pub beside_m: f64 = 0.6, 0.0..=10.0;
        /// Returns farther than this outside of the track are ignored where it has no walls: up to there, obstacles that
        /// move are described [m].
        pub watch_m: f64 = 1.5, 0.0..=10.0;
        /// Size of the ellipses: `tight` leaves gaps open that the robot fits through, `source` is (7.35) as printed.
        pub cover: CoverRule = CoverRule::Tight;
        /// With `tight`: distance that the body keeps from an obstacle while its centre is outside of the ellipses [m].
        pub tight_clearance_m: f64 = 0.05, 0.0..=1.0;
        /// Safety distance theta of (7.35), for `source` [m].
        pub safety_distance_m: f64 = 0.2, 0.05..=1.0;
        /// Smallest semi-axis of an ellipse along the track, a of (7.35) [m].
        pub long_axis_m: f64 = 1.2, 0.5..=5.0;
        /// Ratio of the semi-axes a and b of wide obstacles, (7.35).
        pub long_axis_ratio: f64 = 1.15, 1.0..=3.0;
        /// The robot as this stage knows it; `run` takes it from the table `[vehicle]`.
        pub vehicle: Description = Description::default();
        /// With `source`: distance that the body keeps from big or turned obstacles while its centre is outside of the
        /// ellipses [m].
        pub clearance_m: f64 = 0.1, 0.0..=1.0;
        /// Assumed depth of a body of which only the front was seen [m].
        pub unseen_depth_m: f64 = 0.1, 0.01..=1.0;
        /// Standard deviation of a range [m].
        pub range_noise_m: f64 = 0.02, 0.001..=0.1;
        /// Standard deviation of the estimated position [m].
        pub pose_noise_m: f64 = 0.015, 0.001..=0.2;
        /// Standard deviation of the estimated yaw [rad].
        pub pose_noise_rad: f64 = 0.01, 0.0005..=0.1;
        /// Obstacles nearer than this are reported when they are first seen, others when they are seen again [m].
        pub near_m: f64 = 2.0, 0.0..=10.0;
        /// Obstacles at rest are remembered until they are this far behind the robot [m].
        pub keep_behind_m: f64 = 3.0, 0.5..=10.0;
        /// An obstacle is forgotten after its place was seen free in this many scans.
        pub free_scans: u32 = 3, 1.0..=20.0;
        /// Longest time for which an obstacle at rest is remembered where its returns do not come and nothing beyond it is seen;
        /// one that was seen in few scans is remembered for half a second each [s].
        pub memory_s: f64 = 60.0, 0.5..=3600.0;
        /// Time for which a moving obstacle is extrapolated without being seen [s].
        pub moving_memory_s: f64 = 1.0, 0.0..=5.0;
        /// Obstacles slower than this count as at rest [m/s].
        pub moving_mps: f64 = 0.1, 0.02..=1.0;
    }
}

impl ObstaclesConfig {
    /// Distance of the robot's centre within which an obstacle is reported when it is first seen [m].
    ///
    /// The speed limit counts on it for what appears at `vehicle.sudden_m` in front of the body.
    pub(crate) fn first_sight_m(&self) -> f64 {
        let sudden_m = self.vehicle.nose_m() + self.vehicle.sudden_m;
        self.near_m.max(sudden_m + 3.0 * self.range_noise_m)
    }

    /// Between these, obstacles at rest are described, across the track [m].
    pub(crate) fn beside_y_m(&self) -> [f64; 2] {
        let beyond = if self.walls { f64::INFINITY } else { self.beside_m };
        let [low, high] = self.wall_y_m;
        [low - beyond, high + beyond]
    }

    /// Where walls end the view across the track when nothing stands on it [m]; `None` in open surroundings.
    pub(crate) fn view_y_m(&self) -> Option<[f64; 2]> {
        let [low, high] = self.wall_y_m;
        match self.vehicle.surroundings {
            _ if self.walls => Some(self.wall_y_m),
            Surroundings::Hall => Some([low - Surroundings::HALL_M, high + Surroundings::HALL_M]),
            Surroundings::Open => None,
        }
    }

    /// The share of the beams that walls beside an empty track return to a robot at `y_m` across it; `None` in open
    /// surroundings.
    ///
    /// With [`SWEEP_SHARE`] or less, an empty track looks as if the scanner saw nothing, and the robot stops.
    pub fn wall_share(&self, y_m: f64) -> Option<f64> {
        let [low, high] = self.view_y_m()?;
        let (beams, reach_m) = (self.vehicle.scanner.geometry(), self.vehicle.scanner.range_m);
        let returned = (0..beams.count).filter(|beam| {
            let sine = (beams.yaw_rad(*beam) + self.vehicle.scanner_yaw_rad).sin();
            let way_m = if sine > 0.0 { high - y_m } else { y_m - low };
            way_m <= reach_m * sine.abs()
        });
        Some(returned.count() as f64 / beams.count as f64)
    }

    /// Passes when every number is finite and in its range.
    ///
    /// # Errors
    /// [`Invalid`] with the first key out of range.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        let view = self.vehicle.scanner.require_view(self.vehicle.scanner_yaw_rad);
        view.map_err(|error| error.within("vehicle.scanner"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_and_swapped_walls_are_refused_by_name() {
        assert_eq!(ObstaclesConfig::default().validate(), Ok(()));
        let nan = ObstaclesConfig { clearance_m: f64::NAN, ..ObstaclesConfig::default() };
        assert_eq!(nan.validate().unwrap_err().key, "clearance_m");
        let swapped = ObstaclesConfig { wall_y_m: [1.5, -1.5], ..ObstaclesConfig::default() };
        assert_eq!(swapped.validate().unwrap_err().key, "wall_y_m");
        let near = ObstaclesConfig { wall_y_m: [0.0, 0.49], ..ObstaclesConfig::default() };
        assert_eq!(near.validate().unwrap_err().key, "wall_y_m");
    }
}
