//! The limits of a plan: the obstacles, the walls and the bounds of the position.
//!
//! A limit that is violated at the start already is relaxed to its present value, the [`Baseline`]: a plan must not
//! make it worse.

use nalgebra::Vector2;
use vehicle::geometry::Rectangle;
use vehicle::{Control, State};

use crate::config::Config;
use crate::predicted_obstacle::PredictedObstacle;

/// How much deeper than now an ellipse may be entered, in units of (7.34).
const DEEPER: f64 = 0.01;
/// How far a bound of the position may be exceeded [m].
const OUTSIDE_M: f64 = 0.05;
/// Numerical tolerance of all comparisons of lengths [m].
const TOLERANCE_M: f64 = 1e-3;

/// What a plan must respect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    /// The robot, the track and the goal.
    pub(crate) config: &'a Config,
    /// The obstacles.
    pub(crate) predicted: &'a [PredictedObstacle],
    /// State at the start of the plan.
    pub(crate) initial: State,
    /// Bounds across the track, (7.46) [m].
    pub(crate) y_range: [f64; 2],
}

/// The limit that a plan violates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Violation {
    /// A number is not finite, or there is no plan.
    NotFinite,
    /// A control is outside its hard bounds.
    Control,
    /// The body comes too near to an obstacle or a wall.
    Clearance,
    /// An ellipse is entered, or deeper than now; its index.
    Ellipse(usize),
    /// The position leaves its bounds.
    Outside,
}

impl<'a> Scene<'a> {
    /// What plans from `initial` must respect.
    pub(crate) fn new(config: &'a Config, predicted: &'a [PredictedObstacle], initial: State) -> Self {
        Self { config, predicted, initial, y_range: config.y_range() }
    }

    /// Limits as they are at the start of the plan.
    pub(crate) fn baseline(&self) -> Baseline {
        let mut baseline = Baseline {
            values: [1.0; shared_types::MAX_OBSTACLES],
            gaps: [self.config.clearance_m; shared_types::MAX_OBSTACLES],
            wall_gap: self.config.clearance_m,
            outside: [OUTSIDE_M; 2],
        };
        let State { x, y, .. } = self.initial;
        for (index, obstacle) in self.predicted.iter().enumerate().take(shared_types::MAX_OBSTACLES) {
            baseline.values[index] = obstacle.value(0.0, x, y).min(1.0) - DEEPER;
            let gap = self.body_at(&self.initial).distance_to_rectangle(&obstacle.body);
            baseline.gaps[index] = gap.min(self.config.clearance_m) - TOLERANCE_M;
        }
        baseline.wall_gap = self.wall_gap(&self.initial).min(self.config.clearance_m) - TOLERANCE_M;
        baseline.outside = [excess(x, self.config.track.x_m), excess(y, self.y_range)]
            .map(|now| OUTSIDE_M.max(now + TOLERANCE_M));
        baseline
    }

    /// The first limit that the robot violates at `state`, `t` seconds after the start of the plan.
    pub(crate) fn check(&self, baseline: &Baseline, t: f64, state: &State) -> Option<Violation> {
        if !state.is_finite() {
            return Some(Violation::NotFinite);
        }
        if excess(state.x, self.config.track.x_m) > baseline.outside[0]
            || excess(state.y, self.y_range) > baseline.outside[1]
        {
            return Some(Violation::Outside);
        }
        if self.config.track.walls && self.wall_gap(state) < baseline.wall_gap {
            return Some(Violation::Clearance);
        }
        let reach =
            self.config.vehicle.length_m.hypot(self.config.vehicle.width_m) / 2.0 + self.config.clearance_m;
        for (index, obstacle) in self.predicted.iter().enumerate().take(shared_types::MAX_OBSTACLES) {
            if obstacle.value(t, state.x, state.y) < baseline.values[index] {
                return Some(Violation::Ellipse(index));
            }
            let body = obstacle.body_at(t);
            let distance = (body.centre - Vector2::new(state.x, state.y)).norm();
            if distance < reach + body.length.hypot(body.width) / 2.0
                && self.body_at(state).distance_to_rectangle(&body) < baseline.gaps[index]
            {
                return Some(Violation::Clearance);
            }
        }
        None
    }

    /// The body at a state.
    pub(crate) fn body_at(&self, state: &State) -> Rectangle {
        let centre = Vector2::new(state.x, state.y);
        Rectangle {
            centre,
            yaw: state.yaw,
            length: self.config.vehicle.length_m,
            width: self.config.vehicle.width_m,
        }
    }

    /// Curvature of a steady turn at full lock [1/m].
    pub(crate) fn full_lock_curvature(&self, velocity: f64) -> f64 {
        let control = Control { velocity, steering: self.config.vehicle.bounds.steering_max_rad };
        vehicle::model::steady_turn(&self.config.vehicle.parameters(), &control).1 / velocity
    }

    fn wall_gap(&self, state: &State) -> f64 {
        if !self.config.track.walls {
            return f64::INFINITY;
        }
        let middle = (self.y_range[0] + self.y_range[1]) / 2.0;
        let [right, left] = self.config.track.y_m;
        let body = self.body_at(state);
        body.distance_to_wall(right, middle).min(body.distance_to_wall(left, middle))
    }
}

/// The limits along a plan, relaxed where the start already violates them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Baseline {
    values: [f64; shared_types::MAX_OBSTACLES],
    gaps: [f64; shared_types::MAX_OBSTACLES],
    wall_gap: f64,
    outside: [f64; 2],
}

/// How far `value` is outside of `range` [m].
pub(crate) fn excess(value: f64, range: [f64; 2]) -> f64 {
    (range[0] - value).max(value - range[1]).max(0.0)
}
