//! Settings of the controller, checked once when it is made.

use ocp::SolverSettings;
use serde::{Deserialize, Serialize};
use vehicle::{Bounds, Invalid, Parameters, require};

use crate::reference_path::LatticeSettings;
use crate::weights::WeightSettings;

/// Most intervals a plan may have: a command carries one node more.
pub(crate) const MAX_INTERVALS: usize = shared_types::PLAN_NODES - 1;

/// Where to land.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Goal {
    /// Position along the track [m].
    pub x_m: f64,
    /// Lateral position, which is also the line that the robot follows [m].
    pub y_m: f64,
    /// Distance within which the goal counts as reached [m]; 0.01 to 1.
    pub tolerance_m: f64,
}

impl Default for Goal {
    fn default() -> Self {
        Self { x_m: 10.0, y_m: 0.0, tolerance_m: 0.1 }
    }
}

/// The track, (7.45) and (7.46).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Track {
    /// Bounds along the track [m].
    pub x_m: [f64; 2],
    /// Bounds across the track [m]: of the robot's centre, or with `walls` the surfaces of the walls.
    pub y_m: [f64; 2],
    /// Whether walls stand at the lateral bounds.
    pub walls: bool,
}

impl Default for Track {
    fn default() -> Self {
        Self { x_m: [0.0, 22.0], y_m: [-1.5, 1.5], walls: false }
    }
}

/// Settings of the rule that stops in front of a blocked path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StopSettings {
    /// Slack from which a blocked path stops at any distance; 0 to 1.
    pub slack: f64,
    /// Velocity towards a blocked path until the rule stops [m/s]; 0.1 to 1.
    pub approach_mps: f64,
    /// Scans for which a stop is held at least; 0 to 1000.
    pub hold_scans: u32,
    /// Scans in a row that must show a clear way before the robot drives on; 0 to 1000.
    pub resume_scans: u32,
}

impl Default for StopSettings {
    fn default() -> Self {
        Self { slack: 0.05, approach_mps: 0.6, hold_scans: 5, resume_scans: 5 }
    }
}

/// Settings of the controller.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Where to land.
    pub goal: Goal,
    /// The track.
    pub track: Track,
    /// Length of the body [m]; 0.1 to 3.
    pub body_length_m: f64,
    /// Width of the body [m]; 0.1 to 3.
    pub body_width_m: f64,
    /// Safety distance theta [m]; 0 to 2.
    pub theta_m: f64,
    /// Distance by which the planned ellipses are larger than the described ones [m]; 0 to 0.5.
    pub ellipse_margin_m: f64,
    /// Smallest distance of the body to an obstacle along a verified plan [m]; 0 to 1.
    pub clearance_m: f64,
    /// Horizon tf [s]; 0.5 to 10.
    pub horizon_s: f64,
    /// Intervals N of the horizon; 2 to 24.
    pub intervals: usize,
    /// Period of the scans, until two stamps give the true one [s]; 0.005 to 1.
    pub period_s: f64,
    /// Velocity on a free path [m/s]; within the bounds.
    pub cruise_mps: f64,
    /// Velocity while the estimator suspects its calibration, within the bounds [m/s].
    pub careful_mps: f64,
    /// Time constant of the approach to the goal: velocity is distance over this [s]; 0.2 to 5.
    pub landing_time_s: f64,
    /// Deceleration of blocked wheels [m/s^2]; 0.5 to 20.
    pub deceleration_mps2: f64,
    /// Most ellipses in the optimal control problem; 1 to 16.
    pub max_ellipses: usize,
    /// Longest time for solving, live [ms]; 0.1 to 1000.
    pub budget_ms: f64,
    /// Longest time for solving as a share of the period, live; 0.01 to 1.
    pub budget_share: f64,
    /// SQP iterations per scan in lock-step; 1 to 1000.
    pub budget_iterations: u32,
    /// Physical parameters of the robot.
    pub parameters: Parameters,
    /// Bounds (7.41)-(7.44).
    pub bounds: Bounds,
    /// Weights of the objective.
    pub weights: WeightSettings,
    /// The guide.
    pub guide: LatticeSettings,
    /// The stop rule.
    pub stop: StopSettings,
    /// The solver of the optimal control problem.
    pub solver: SolverSettings,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            goal: Goal::default(),
            track: Track::default(),
            body_length_m: 0.56,
            body_width_m: 0.40,
            theta_m: 0.2,
            ellipse_margin_m: 0.02,
            clearance_m: 0.05,
            horizon_s: 2.72,
            intervals: 6,
            period_s: 0.1,
            cruise_mps: 1.0,
            careful_mps: 0.3,
            landing_time_s: 0.6,
            deceleration_mps2: 5.0,
            max_ellipses: 8,
            budget_ms: 20.0,
            budget_share: 0.2,
            budget_iterations: 60,
            parameters: Parameters::default(),
            bounds: Bounds::default(),
            weights: WeightSettings::default(),
            guide: LatticeSettings::default(),
            stop: StopSettings::default(),
            solver: SolverSettings::default(),
        }
    }
}

impl Config {
    /// Passes when every setting is within its range.
    ///
    /// # Errors
    /// [`Invalid`] with the first key that is not.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("goal.x_m", self.goal.x_m, -1e5..=1e5)?;
        require("goal.y_m", self.goal.y_m, -1e3..=1e3)?;
        require("goal.tolerance_m", self.goal.tolerance_m, 0.01..=1.0)?;
        increasing("track.x_m", self.track.x_m, 1e5)?;
        increasing("track.y_m", self.track.y_m, 1e3)?;
        require("body_length_m", self.body_length_m, 0.1..=3.0)?;
        require("body_width_m", self.body_width_m, 0.1..=3.0)?;
        require("theta_m", self.theta_m, 0.0..=2.0)?;
        let [low, high] = self.y_range();
        if low >= high {
            return Err(Invalid::new(
                "track.y_m",
                high - low,
                "walls further apart than body width plus 2 theta",
            ));
        }
        require("ellipse_margin_m", self.ellipse_margin_m, 0.0..=0.5)?;
        require("clearance_m", self.clearance_m, 0.0..=1.0)?;
        require("horizon_s", self.horizon_s, 0.5..=10.0)?;
        require("intervals", self.intervals as f64, 2.0..=MAX_INTERVALS as f64)?;
        require("period_s", self.period_s, 0.005..=1.0)?;
        self.validate_bounds()?;
        let velocities = self.bounds.velocity_min_mps..=self.bounds.velocity_max_mps;
        require("cruise_mps", self.cruise_mps, velocities.clone())?;
        require("careful_mps", self.careful_mps, velocities)?;
        require("landing_time_s", self.landing_time_s, 0.2..=5.0)?;
        require("deceleration_mps2", self.deceleration_mps2, 0.5..=20.0)?;
        require("max_ellipses", self.max_ellipses as f64, 1.0..=16.0)?;
        require("budget_ms", self.budget_ms, 0.1..=1e3)?;
        require("budget_share", self.budget_share, 0.01..=1.0)?;
        require("budget_iterations", f64::from(self.budget_iterations), 1.0..=1e3)?;
        self.weights.validate().map_err(|error| error.within("weights"))?;
        self.guide.validate().map_err(|error| error.within("guide"))?;
        self.solver.validate().map_err(|error| error.within("solver"))?;
        let stop = &self.stop;
        require("stop.slack", stop.slack, 0.0..=1.0)?;
        require("stop.approach_mps", stop.approach_mps, 0.1..=1.0)?;
        require("stop.hold_scans", f64::from(stop.hold_scans), 0.0..=1e3)?;
        require("stop.resume_scans", f64::from(stop.resume_scans), 0.0..=1e3)
    }

    /// Bounds of the lateral position of the robot's centre, (7.46) [m].
    ///
    /// Source note: the source's track has no walls; with walls the bound is their surface, shrunk by half the
    /// body width and theta.
    pub fn y_range(&self) -> [f64; 2] {
        let shrink = if self.track.walls { self.body_width_m / 2.0 + self.theta_m } else { 0.0 };
        [self.track.y_m[0] + shrink, self.track.y_m[1] - shrink]
    }

    /// Length of one interval [s].
    pub fn interval_s(&self) -> f64 {
        self.horizon_s / self.intervals as f64
    }

    fn validate_bounds(&self) -> Result<(), Invalid> {
        let bounds = &self.bounds;
        require("bounds.velocity_min_mps", bounds.velocity_min_mps, 0.02..=10.0)?;
        require("bounds.velocity_max_mps", bounds.velocity_max_mps, bounds.velocity_min_mps..=10.0)?;
        require("bounds.steering_max_rad", bounds.steering_max_rad, 0.001..=0.5)?;
        require("bounds.sideslip_max_rad", bounds.sideslip_max_rad, 0.001..=1.5)?;
        require("bounds.yaw_max_rad", bounds.yaw_max_rad, 0.1..=10.0)?;
        require("bounds.yaw_rate_max_radps", bounds.yaw_rate_max_radps, 0.01..=100.0)?;
        let parameters = &self.parameters;
        for (key, value) in [
            ("parameters.mass_kg", parameters.mass_kg),
            ("parameters.rear_m", parameters.rear_m),
            ("parameters.front_m", parameters.front_m),
            ("parameters.stiffness_n_per_rad", parameters.stiffness_n_per_rad),
            ("parameters.inertia_kgm2", parameters.inertia_kgm2),
        ] {
            require(key, value, 1e-3..=1e6)?;
        }
        Ok(())
    }
}

fn increasing(key: &str, range: [f64; 2], largest: f64) -> Result<(), Invalid> {
    require(key, range[0], -largest..=largest)?;
    require(key, range[1], -largest..=largest)?;
    if range[0] < range[1] {
        Ok(())
    } else {
        Err(Invalid::new(key, format!("[{}, {}]", range[0], range[1]), "the lower bound first"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert_eq!(Config::default().validate(), Ok(()));
    }

    #[test]
    fn walls_shrink_the_bound_by_half_the_body_and_theta() {
        let track = Track { walls: true, y_m: [-1.9, 1.9], ..Track::default() };
        let config = Config { track, ..Config::default() };
        assert!((config.y_range()[1] - 1.5).abs() < 1e-12);
        let narrow = Config { track: Track { y_m: [-0.4, 0.4], ..track }, ..config };
        assert_eq!(narrow.validate().unwrap_err().key, "track.y_m");
    }

    #[test]
    fn nan_and_wrong_order_are_refused_by_name() {
        let nan = Config { horizon_s: f64::NAN, ..Config::default() };
        assert_eq!(nan.validate().unwrap_err().key, "horizon_s");
        let track = Track { x_m: [5.0, 1.0], ..Track::default() };
        assert_eq!(Config { track, ..Config::default() }.validate().unwrap_err().key, "track.x_m");
        let weights = WeightSettings { change: [f64::NAN, 0.0], ..WeightSettings::default() };
        assert_eq!(Config { weights, ..Config::default() }.validate().unwrap_err().key, "weights.change");
    }
}
