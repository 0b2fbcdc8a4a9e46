//! What a plan is held against at each of its places: the obstacles, the walls and the bounds of the position.
//!
//! What is violated at the start already is the [`Baseline`]: a plan must not make it worse.

use nalgebra::Vector2;
use vehicle::geometry::Rectangle;
use vehicle::{Bounds, Parameters, State};

use crate::config::Config;
use crate::hazard::Hazard;

/// How much deeper than now an ellipse may be entered, in units of (7.34).
const DEEPER: f64 = 0.01;
/// How far a bound of the position may be exceeded [m].
const OUTSIDE_M: f64 = 0.05;
/// Numerical tolerance of all comparisons of lengths [m].
const TOLERANCE_M: f64 = 1e-3;

/// What a plan is held against.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    /// Parameters of the model.
    pub(crate) parameters: &'a Parameters,
    /// Hard bounds of the controls.
    pub(crate) bounds: &'a Bounds,
    /// State at the start of the plan.
    pub(crate) initial: State,
    /// Length of an interval [s].
    pub(crate) interval_s: f64,
    /// Length and width of the body [m].
    pub(crate) body: [f64; 2],
    /// Smallest distance of the body to an obstacle or a wall [m].
    pub(crate) clearance: f64,
    /// Bounds along the track, (7.45) [m].
    pub(crate) x_range: [f64; 2],
    /// Bounds across the track, (7.46) [m].
    pub(crate) y_range: [f64; 2],
    /// Surfaces of the walls, where there are walls [m].
    pub(crate) walls: Option<[f64; 2]>,
    /// Position of the goal along the track [m].
    pub(crate) goal_x: f64,
    /// The obstacles.
    pub(crate) hazards: &'a [Hazard],
}

/// What is wrong at a place of the plan.
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
    /// What plans from `initial` are held against.
    pub(crate) fn new(config: &'a Config, hazards: &'a [Hazard], initial: State) -> Self {
        Self {
            parameters: &config.parameters,
            bounds: &config.bounds,
            initial,
            interval_s: config.interval_s(),
            body: [config.body_length_m, config.body_width_m],
            clearance: config.clearance_m,
            x_range: config.track.x_m,
            y_range: config.y_range(),
            walls: config.track.walls.then_some(config.track.y_m),
            goal_x: config.goal.x_m,
            hazards,
        }
    }

    /// Limits as they are at the start of the plan.
    pub(crate) fn baseline(&self) -> Baseline {
        let mut baseline = Baseline {
            values: [1.0; shared_types::MAX_OBSTACLES],
            gaps: [self.clearance; shared_types::MAX_OBSTACLES],
            wall_gap: self.clearance,
            outside: [OUTSIDE_M; 2],
        };
        let State { x, y, .. } = self.initial;
        for (index, hazard) in self.hazards.iter().enumerate().take(shared_types::MAX_OBSTACLES) {
            baseline.values[index] = hazard.value(0.0, x, y).min(1.0) - DEEPER;
            let gap = self.body_at(&self.initial).distance_to_rectangle(&hazard.body);
            baseline.gaps[index] = gap.min(self.clearance) - TOLERANCE_M;
        }
        baseline.wall_gap = self.wall_gap(&self.initial).min(self.clearance) - TOLERANCE_M;
        baseline.outside =
            [excess(x, self.x_range), excess(y, self.y_range)].map(|now| OUTSIDE_M.max(now + TOLERANCE_M));
        baseline
    }

    /// The first thing wrong with the robot at `state`, `t` seconds after the start of the plan.
    pub(crate) fn check(&self, baseline: &Baseline, t: f64, state: &State) -> Option<Violation> {
        if !state.is_finite() {
            return Some(Violation::NotFinite);
        }
        if excess(state.x, self.x_range) > baseline.outside[0]
            || excess(state.y, self.y_range) > baseline.outside[1]
        {
            return Some(Violation::Outside);
        }
        if self.walls.is_some() && self.wall_gap(state) < baseline.wall_gap {
            return Some(Violation::Clearance);
        }
        let reach = self.body[0].hypot(self.body[1]) / 2.0 + self.clearance;
        for (index, hazard) in self.hazards.iter().enumerate().take(shared_types::MAX_OBSTACLES) {
            if hazard.value(t, state.x, state.y) < baseline.values[index] {
                return Some(Violation::Ellipse(index));
            }
            let body = hazard.body_at(t);
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
        Rectangle { centre, yaw: state.yaw, length: self.body[0], width: self.body[1] }
    }

    fn wall_gap(&self, state: &State) -> f64 {
        let middle = (self.y_range[0] + self.y_range[1]) / 2.0;
        self.walls.map_or(f64::INFINITY, |walls| {
            let body = self.body_at(state);
            body.distance_to_wall(walls[0], middle).min(body.distance_to_wall(walls[1], middle))
        })
    }
}

/// What is already the case at the start of the plan, and so allowed along it.
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
