//! Settings of the controller, checked once when it is made.

use ocp::SolverSettings;
use serde::{Deserialize, Serialize};
use vehicle::bounds::ANY_VELOCITY_MAX_MPS;
use vehicle::{Course, Description, Goal, Invalid, Setting, Track, require, settings};

use crate::reference_path::LatticeSettings;
use crate::weights::WeightSettings;

/// Most intervals a plan may have: a command carries one node more.
pub(crate) const MAX_INTERVALS: usize = shared_types::PLAN_NODES - 1;

/// A set of default values that go together.
///
/// The reader of the system file puts the values of a profile where the file has none. The controller does not use it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControllerProfile {
    /// The controller of this project.
    #[default]
    Scanloop,
    /// The controller of the source.
    Source,
}

impl Setting for ControllerProfile {}

settings! {
    /// The parts of the margin that the plan's samples do not contain.
    #[derive(Copy)]
    pub struct MarginSettings {
        /// How many standard deviations of the pose are kept, k.
        pub pose_sigmas: f64 = 2.0, 0.0..=10.0;
        /// Growth of the pose's standard deviation along the plan, after one second [m].
        pub pose_growth_m: f64 = 0.006, 0.0..=1.0;
        /// Fraction that is kept of the distance until the command acts. The pose is predicted for it; the error of that is 0.17
        /// of it at most. 1 keeps all of it.
        pub latency_share: f64 = 0.25, 0.0..=1.0;
        /// Difference between the path of the robot and that of the model [m].
        pub model_m: f64 = 0.015, 0.0..=1.0;
        /// Uncertainty of the outline of a described obstacle [m].
        pub perception_m: f64 = 0.015, 0.0..=1.0;
    }
}

/// What chooses the passing sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SideRule {
    /// The lattice search for the cheapest path.
    #[default]
    Search,
    /// Obstacles on the line are passed on their left.
    Left,
    /// Obstacles on the line are passed on their right.
    Right,
    /// Each obstacle is passed on the side with the shorter detour inside the track; with equal ones on its left.
    Nearest,
}

impl Setting for SideRule {}

/// What a robot that a person drives keeps from obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PersonMargin {
    /// The whole margin, and the ellipses, as the controller's own plans.
    #[default]
    Whole,
    /// `clearance_m` and the way of the robot while the data age, from the bodies as they are described.
    Close,
}

impl Setting for PersonMargin {}

settings! {
    /// Settings of the rule that stops in front of a blocked path.
    #[derive(Copy)]
    pub struct StopSettings {
        /// If the slack of a blocked path is at least this, the robot stops at any distance from it.
        pub slack: f64 = 0.05, 0.0..=1.0;
        /// How much faster than desired the robot may be, as a fraction.
        pub speed_error: f64 = 0.05, 0.0..=1.0;
        /// How much less than described blocked wheels may decelerate, as a fraction.
        pub deceleration_error: f64 = 0.2, 0.0..=0.9;
        /// Velocity towards a blocked path until the rule stops the robot [m/s].
        pub approach_mps: f64 = 0.6, 0.1..=ANY_VELOCITY_MAX_MPS;
        /// Smallest number of scans for which a stop is held.
        pub hold_scans: u32 = 5, 0.0..=1e3;
        /// Scans in a row that must show a free path before the robot drives again.
        pub resume_scans: u32 = 5, 0.0..=1e3;
    }
}

settings! {
    /// Settings of the controller.
    pub struct ControllerConfig {
        /// Set of default values for this table, the tables below it and `obstacles.cover`: `source` has the methods of
        /// the source. A key that is set holds with each profile.
        pub profile: ControllerProfile = ControllerProfile::Scanloop;
        /// What chooses the passing sides: `search` is the path search. The others do without a search and pass obstacles
        /// on the line on their left, on their right, or on the side with the shorter detour.
        pub side: SideRule = SideRule::Search;
        /// Where to land; `run` takes it from the scenario.
        pub goal: Goal = Goal::default();
        /// Where to land after it, in this order; `run` takes them from the scenario.
        pub next_goals: Vec<Goal> = Vec::new();
        /// The track; `run` takes it from the scenario.
        pub track: Track = Track::default();
        /// The way that the robot follows; `run` takes it from the scenario. Goal and track are along and across it.
        pub course: Course = Course::default();
        /// The robot as this stage knows it; `run` takes it from the table `[vehicle]`.
        pub vehicle: Description = Description::default();
        /// Safety distance to walls, theta [m].
        pub theta_m: f64 = 0.2, 0.0..=2.0;
        /// Distance by which the semi-axes of the ellipses are enlarged for planning [m].
        pub ellipse_margin_m: f64 = 0.02, 0.0..=0.5;
        /// Time constant with which the ellipses follow their description [s].
        pub smoothing_s: f64 = 0.28, 0.001..=10.0;
        /// Distance of the body to an obstacle that a verified plan keeps in any case [m].
        pub clearance_m: f64 = 0.05, 0.0..=1.0;
        /// What is kept in addition to `clearance_m`.
        pub margin: MarginSettings = MarginSettings::default();
        /// What a robot that a person drives keeps from obstacles: `whole` is what the controller keeps, `close` lets it
        /// pass closer, for a person who sees them.
        pub person_margin: PersonMargin = PersonMargin::Whole;
        /// Length of the horizon, tf [s].
        pub horizon_s: f64 = 5.44, (0.5..=10.0, "at least `controller.intervals` / `rate_hz`");
        /// Number of intervals of the horizon, N.
        pub intervals: usize = 12, 2.0..=MAX_INTERVALS as f64;
        /// Scan period that is assumed until the stamps of two scans give the true one; `run` takes it from `rate_hz` [s].
        pub period_s: f64 = 0.1, 0.001..=2.0;
        /// Velocity on a free path; without the key the nearest one that `vehicle.bounds` allows [m/s].
        pub cruise_mps: f64 = 1.0,
            "within the velocities of `vehicle.bounds`; by the factor of `actuator.calibration` at most `vehicle.bounds.sent_velocity_max_mps`";
        /// Velocity while the estimator suspects that its calibration is wrong; without the key the nearest one that
        /// `vehicle.bounds` allows [m/s].
        pub careful_mps: f64 = 0.3, "within the velocities of `vehicle.bounds`";
        /// Near the goal the velocity is the distance divided by this time [s].
        pub landing_time_s: f64 = 0.6, 0.2..=5.0;
        /// Largest number of ellipses in the optimal control problem.
        pub max_ellipses: usize = 8, 1.0..=16.0;
        /// Time limit of one solve in real time; the smaller of this and `budget_share` holds [ms].
        pub budget_ms: f64 = 20.0, 0.1..=1e3;
        /// Time limit of one solve in real time, as a fraction of the scan period.
        pub budget_share: f64 = 0.2, 0.01..=1.0;
        /// Limit of SQP iterations for one scan in lock-step.
        pub budget_iterations: u32 = 60, 1.0..=1e3;
        /// Weights of the optimal control problem.
        pub weights: WeightSettings = WeightSettings::default();
        /// The lattice search for the reference path, which chooses the passing sides.
        pub guide: LatticeSettings = LatticeSettings::default();
        /// How far the robot drives back over the way that it came: out of a dead end, where a path begins there, out of
        /// the way of a body that comes, and, from 3 m on, to a goal that it passed; 0 for never. It does so with the
        /// search, and with a vehicle that drives backwards [m].
        pub back_out_m: f64 = 6.0, 0.0..=10.0;
        /// How long ground that the robot looked at counts as free when it drives backwards, which it can't see [s].
        pub seen_for_s: f64 = 60.0, 1.0..=3600.0;
        /// The rule that stops the robot in front of a blocked path.
        pub stop: StopSettings = StopSettings::default();
        /// The solver of the optimal control problem.
        pub solver: SolverSettings = SolverSettings::default();
    }
}

impl ControllerConfig {
    /// Passes when every setting is within its range.
    ///
    /// # Errors
    /// [`Invalid`] with the first key that is not.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.require_ranges()?;
        let [low, high] = self.y_range();
        if low >= high {
            let [right, left] = self.track.y_m;
            let allowed = format!(
                "walls further apart than vehicle.width_m = {} and twice controller.theta_m = {}",
                self.vehicle.width_m, self.theta_m
            );
            return Err(Invalid::new("track.y_m", format!("[{right}, {left}]"), allowed));
        }
        let (slowest, fastest) = (self.vehicle.bounds.velocity_min_mps, self.vehicle.bounds.velocity_max_mps);
        require("vehicle.bounds.velocity_max_mps", fastest, slowest..=ANY_VELOCITY_MAX_MPS)?;
        require("cruise_mps", self.cruise_mps, slowest..=fastest)?;
        require("careful_mps", self.careful_mps, slowest..=fastest)
    }

    /// Bounds of the lateral position of the robot's centre, (7.46) [m].
    ///
    /// Source note: the source's track has no walls; with walls the bound is their surface, shrunk by half the
    /// body width and theta.
    pub fn y_range(&self) -> [f64; 2] {
        let shrink = if self.track.walls { self.vehicle.width_m / 2.0 + self.theta_m } else { 0.0 };
        [self.track.y_m[0] + shrink, self.track.y_m[1] - shrink]
    }

    /// Share of the largest curvature that a path may use.
    pub fn curvature_share(&self) -> f64 {
        self.guide.curvature_share
    }

    /// How long ground that was seen counts [ns].
    pub(crate) fn seen_for_ns(&self) -> u64 {
        (self.seen_for_s * 1e9) as u64
    }

    /// Length of one interval [s].
    pub fn interval_s(&self) -> f64 {
        self.horizon_s / self.intervals as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_allowed() {
        assert_eq!(ControllerConfig::default().validate(), Ok(()));
    }

    #[test]
    fn walls_shrink_the_bound_by_half_the_body_and_theta() {
        let track = Track { walls: true, y_m: [-1.9, 1.9], ..Track::default() };
        let config = ControllerConfig { track, ..ControllerConfig::default() };
        assert!((config.y_range()[1] - 1.5).abs() < 1e-12);
        let narrow = ControllerConfig { track: Track { y_m: [-0.4, 0.4], ..track }, ..config };
        assert_eq!(
            narrow.validate().unwrap_err().to_string(),
            "track.y_m = [-0.4, 0.4] is not allowed: walls further apart than vehicle.width_m = 0.4 and twice \
             controller.theta_m = 0.2"
        );
    }

    #[test]
    fn the_range_of_the_largest_velocity_is_one_that_its_own_rule_allows() {
        let mut config = ControllerConfig::default();
        config.vehicle.bounds.velocity_max_mps = 0.05;
        let refused = config.validate().unwrap_err().to_string();
        assert_eq!(refused, "vehicle.bounds.velocity_max_mps = 0.05 is not allowed: 0.1 to 10");
    }

    #[test]
    fn nan_and_wrong_order_are_refused_by_name() {
        let nan = ControllerConfig { horizon_s: f64::NAN, ..ControllerConfig::default() };
        assert_eq!(nan.validate().unwrap_err().key, "horizon_s");
        let track = Track { x_m: [5.0, 1.0], ..Track::default() };
        assert_eq!(
            ControllerConfig { track, ..ControllerConfig::default() }.validate().unwrap_err().key,
            "track.x_m"
        );
        let weights = WeightSettings { change: [f64::NAN, 0.0], ..WeightSettings::default() };
        assert_eq!(
            ControllerConfig { weights, ..ControllerConfig::default() }.validate().unwrap_err().key,
            "weights.change"
        );
    }
}
