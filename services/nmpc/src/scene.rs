//! The limits of a plan: the obstacles, the walls and the bounds of the position.
//!
//! A limit that is violated at the start already is relaxed to its present value, the [`Baseline`]: a plan must not
//! make it worse.
//!
//! All positions are on the course: x along it, y across, yaw relative to it. Distances of bodies are those in the plane.

use nalgebra::Vector2;
use vehicle::frame::to_robot;
use vehicle::geometry::Rectangle;
use vehicle::{Bounds, Control, State};

use crate::config::ControllerConfig;
use crate::margin::MarginModel;
use crate::predicted_obstacle::PredictedObstacle;
use crate::sampled::Sampled;
use crate::sights::Behind;

/// Curvature of a robot that does not turn [1/m]: others divide by it.
const HARDLY_PER_M: f64 = 1e-6;

/// How far behind the goal a plan is still checked [m].
pub(crate) const BEHIND_GOAL_M: f64 = 0.03;
/// How much deeper than now an ellipse may be entered, in units of (7.34).
const DEEPER: f64 = 0.01;
/// How far a bound of the position may be exceeded [m].
const OUTSIDE_M: f64 = 0.05;
/// Numerical tolerance of all comparisons of lengths [m].
const TOLERANCE_M: f64 = 1e-3;
/// A body nearer than this may be met between two samples of a plan [m].
const TOUCHED_M: f64 = 0.01;

/// A robot at rest does not start when it is nearer to an obstacle than this share of the base clearance: the obstacle may
/// be coming nearer, too slowly for its velocity to be told from noise. A robot stops further away by itself.
const START_SHARE: f64 = 0.8;
/// A robot slower than this rests [m/s]: blocked wheels are measured as exactly zero, rolling ones are not.
pub(crate) const REST_MPS: f64 = 0.02;

/// How much further than the margin a robot is from an obstacle when it need not slow down for it [m].
const SLOW_BEFORE_M: f64 = 0.05;

/// What a plan must respect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene<'a> {
    /// The robot, the track and the goal.
    pub(crate) config: &'a ControllerConfig,
    /// The obstacles.
    pub(crate) predicted: &'a [PredictedObstacle],
    /// State at the start of the plan.
    pub(crate) initial: State,
    /// Bounds across the track, (7.46); of a course where its way is widest [m].
    pub(crate) y_range: [f64; 2],
    /// Clearance to obstacles.
    pub(crate) margin: MarginModel,
    /// Speed at the start of the plan [m/s].
    pub(crate) speed: f64,
    /// Largest velocity from which the robot stops in time [m/s].
    pub(crate) limit_mps: f64,
    /// Whether the robot gets out of the way of a body, or a person drives close to one: then the bodies count, and their
    /// ellipses do not.
    pub(crate) escapes: bool,
    /// What is known of the ground behind a robot that drives backwards: it stays on what is free.
    pub(crate) behind: Option<Behind<'a>>,
}

/// The limit that a plan violates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Violation {
    /// A number is not finite, or there is no plan.
    NotFinite,
    /// A control is outside its hard bounds.
    Control,
    /// The body comes too near to the obstacle with this index.
    Obstacle(usize),
    /// The body comes too near to a wall.
    Wall,
    /// An ellipse is entered, or deeper than now; its index.
    Ellipse(usize),
    /// The position leaves its bounds.
    Outside,
    /// Backwards, the body comes to ground that was not seen, or where a body may have come.
    Unseen,
}

impl<'a> Scene<'a> {
    /// What plans from `initial` must respect.
    pub(crate) fn new(
        config: &'a ControllerConfig,
        predicted: &'a [PredictedObstacle],
        initial: State,
    ) -> Self {
        Self {
            config,
            predicted,
            initial,
            y_range: config.y_range(),
            margin: MarginModel::certain(config),
            speed: 0.0,
            limit_mps: f64::INFINITY,
            escapes: false,
            behind: None,
        }
    }

    /// Bounds across the track at `x` along it [m].
    pub(crate) fn y_range_at(&self, x: f64) -> [f64; 2] {
        let half_m = self.config.course.half_width_m(x);
        [self.y_range[0].max(-half_m), self.y_range[1].min(half_m)]
    }

    /// The same with another margin, for a robot with this speed at the start.
    #[must_use]
    pub(crate) fn keeping(self, margin: MarginModel, speed: f64) -> Self {
        Self { margin, speed, ..self }
    }

    /// The hard bounds of the controls, with the limit of the velocity.
    pub(crate) fn bounds(&self) -> Bounds {
        let bounds = self.config.vehicle.bounds;
        Bounds { velocity_max_mps: bounds.velocity_max_mps.min(self.limit_mps), ..bounds }
    }

    /// Whether a body is and stays behind the robot's place at the goal: the robot rests there before it gets to the body.
    pub(crate) fn is_beyond_goal(&self, obstacle: &PredictedObstacle) -> bool {
        let rest_x = self.config.goal.x_m + BEHIND_GOAL_M + self.config.vehicle.nose_m() + self.margin.base();
        [0.0, self.config.horizon_s].into_iter().all(|t| {
            let corners = obstacle.body_at(t).corners();
            corners.into_iter().all(|corner| corner.x > rest_x)
        })
    }

    /// Limits as they are at the start of the plan.
    pub(crate) fn baseline(&self) -> Baseline {
        let mut baseline = Baseline {
            values: [1.0; shared_types::MAX_OBSTACLES],
            gaps: [f64::INFINITY; shared_types::MAX_OBSTACLES],
            wall_gap: self.config.clearance_m,
            outside: [OUTSIDE_M; 2],
            turned_outside: OUTSIDE_M,
            curvature: self.config.curvature_share()
                * self.full_lock_curvature(self.config.vehicle.bounds.velocity_max_mps),
        };
        let State { x, y, .. } = self.initial;
        for (index, obstacle) in self.predicted.iter().enumerate().take(shared_types::MAX_OBSTACLES) {
            baseline.values[index] = if self.is_beyond_goal(obstacle) {
                f64::NEG_INFINITY
            } else {
                obstacle.value(0.0, x, y).min(1.0) - DEEPER
            };
            baseline.gaps[index] =
                self.body_at(&self.initial).distance_to_rectangle(&self.in_plane(obstacle, 0.0));
        }
        baseline.wall_gap = self.wall_gap(&self.initial).min(self.config.clearance_m) - TOLERANCE_M;
        baseline.outside = [excess(x, self.config.track.x_m), excess(y, self.y_range_at(x))]
            .map(|now| OUTSIDE_M.max(now + TOLERANCE_M));
        let turned = self.excess_of_turn(&self.initial, baseline.curvature);
        baseline.turned_outside = OUTSIDE_M.max(turned + TOLERANCE_M);
        baseline
    }

    /// The obstacle that a robot at rest is too near to for a start.
    pub(crate) fn too_near_to_start(&self, baseline: &Baseline) -> Option<usize> {
        let near = |index: &usize| baseline.gaps[*index] < START_SHARE * self.config.clearance_m;
        (0..self.predicted.len().min(shared_types::MAX_OBSTACLES))
            .find(near)
            .filter(|_| self.speed < REST_MPS && !self.escapes)
    }

    /// Whether a body is so near that a plan may drive deeper into it between two samples.
    pub(crate) fn is_touched(&self, baseline: &Baseline) -> bool {
        baseline.gaps.iter().any(|gap| *gap < TOUCHED_M)
    }

    /// The first limit that the robot violates at a sample of the plan.
    pub(crate) fn check(&self, baseline: &Baseline, sample: &Sampled) -> Option<Violation> {
        let Sampled { t, speed, ref state } = *sample;
        if !state.is_finite() {
            return Some(Violation::NotFinite);
        }
        if excess(state.x, self.config.track.x_m) > baseline.outside[0]
            || excess(state.y, self.y_range_at(state.x)) > baseline.outside[1]
        {
            return Some(Violation::Outside);
        }
        let entered =
            |index: &usize| self.predicted[*index].value(t, state.x, state.y) < baseline.values[*index];
        (0..self.predicted.len().min(shared_types::MAX_OBSTACLES))
            .filter(|_| !self.escapes)
            .find(entered)
            .map(Violation::Ellipse)
            .or_else(|| self.touched(baseline, self.margin.sum(t, speed), t, state))
    }

    /// The bodies of the obstacles in the plane, and how many there are.
    pub(crate) fn bodies(&self) -> ([Rectangle; shared_types::MAX_OBSTACLES], usize) {
        let nothing = Rectangle { centre: Vector2::zeros(), yaw: 0.0, length: 0.0, width: 0.0 };
        let mut bodies = [nothing; shared_types::MAX_OBSTACLES];
        let pairs = bodies.iter_mut().zip(self.predicted);
        let count = pairs.map(|(body, obstacle)| *body = self.in_plane(obstacle, 0.0)).count();
        (bodies, count)
    }

    /// The first obstacle or wall that the body comes nearer to than `margin` or than it is now.
    pub(crate) fn touched(
        &self,
        baseline: &Baseline,
        margin: f64,
        t: f64,
        state: &State,
    ) -> Option<Violation> {
        if self.config.track.walls && self.wall_gap(state) < baseline.wall_gap {
            return Some(Violation::Wall);
        }
        let body = self.body_at(state);
        let near = |index: usize| {
            let (other, limit) =
                (self.in_plane(&self.predicted[index], t), baseline.gaps[index].min(margin) - TOLERANCE_M);
            let reach = (body.length.hypot(body.width) + other.length.hypot(other.width)) / 2.0 + margin;
            (other.centre - body.centre).norm() < reach && body.distance_to_rectangle(&other) < limit
        };
        (0..self.predicted.len().min(shared_types::MAX_OBSTACLES))
            .find(|&index| near(index))
            .map(Violation::Obstacle)
    }

    /// How much nearer than the margin with a reserve a sample comes to an obstacle [m]; zero or less when it keeps its
    /// distance.
    pub(crate) fn shortfall(
        &self,
        baseline: &Baseline,
        sample: &Sampled,
        index: usize,
        reserve_m: f64,
    ) -> f64 {
        let Sampled { t, speed, ref state } = *sample;
        let obstacle = &self.predicted[index];
        let body = self.body_at(state);
        let limit = baseline.gaps[index].min(self.margin.sum(t, speed) + reserve_m) - TOLERANCE_M;
        let other = self.in_plane(obstacle, t);
        let reach = (body.length.hypot(body.width) + other.length.hypot(other.width)) / 2.0 + limit;
        let near = (other.centre - body.centre).norm() < reach;
        let short = if near { limit - body.distance_to_rectangle(&other) } else { 0.0 };
        let missing = baseline.values[index] - obstacle.value(t, state.x, state.y);
        short.max(if missing > 0.0 { obstacle.b * missing / 2.0 } else { 0.0 })
    }

    /// Distance from the body to the nearest obstacle that is not behind it [m]; infinite when there is none.
    pub(crate) fn free_ahead(&self) -> f64 {
        let body = self.body_at(&self.initial);
        let is_ahead = |obstacle: &&PredictedObstacle| {
            let forward = |corner: Vector2<f64>| {
                let offset = corner - body.centre;
                to_robot(body.yaw, offset.x, offset.y).x
            };
            self.in_plane(obstacle, 0.0).corners().map(forward).into_iter().any(|x| x > 0.0)
        };
        let distances = self.predicted.iter().filter(is_ahead);
        distances
            .map(|obstacle| body.distance_to_rectangle(&self.in_plane(obstacle, 0.0)))
            .fold(f64::INFINITY, f64::min)
    }

    /// Largest of the speeds between two at which the body keeps its clearance at (`x`, `y`), and a little more.
    pub(crate) fn fastest_at(&self, x: f64, y: f64, course: f64, [slowest, fastest]: [f64; 2]) -> f64 {
        let body = self.body_at(&State { x, y, yaw: course, ..State::default() });
        let outside = |speed: f64| {
            let near = |obstacle: &PredictedObstacle| {
                body.distance_to_rectangle(&self.in_plane(obstacle, 0.0))
                    < self.margin.sum(0.0, speed) + SLOW_BEFORE_M
            };
            !self.predicted.iter().any(near)
        };
        let (mut slow, mut fast) = (slowest, fastest);
        if outside(fast) {
            return fast;
        }
        for _ in 0..5 {
            let middle = f64::midpoint(slow, fast);
            if outside(middle) { slow = middle } else { fast = middle }
        }
        slow
    }

    /// The body at a state, in the plane, where distances are those of bodies.
    pub(crate) fn body_at(&self, state: &State) -> Rectangle {
        let state = self.config.course.in_plane(state);
        self.config.vehicle.body([state.x, state.y, state.yaw])
    }

    /// The box of an obstacle in the plane, `t` seconds after the start of the plan.
    pub(crate) fn in_plane(&self, obstacle: &PredictedObstacle, t: f64) -> Rectangle {
        let body = obstacle.body_at(t);
        if self.config.course.is_line() {
            return body;
        }
        obstacle.in_plane.unwrap_or_else(|| {
            let state = State { x: body.centre.x, y: body.centre.y, yaw: body.yaw, ..State::default() };
            let State { x, y, yaw, .. } = self.config.course.in_plane(&state);
            Rectangle { centre: Vector2::new(x, y), yaw, ..body }
        })
    }

    /// Curvature of a steady turn at full lock [1/m]; of a robot that turns round by itself at this velocity, which has no
    /// steady turn to the side of its wheels, hardly any.
    pub(crate) fn full_lock_curvature(&self, velocity: f64) -> f64 {
        let vehicle = &self.config.vehicle;
        let control = Control { velocity, steering: vehicle.bounds.steering_max_rad };
        let curvature = vehicle::model::steady_turn(&vehicle.parameters(), &control).1 / velocity;
        if curvature > HARDLY_PER_M { curvature } else { HARDLY_PER_M }
    }

    /// Whether a robot that turns back to along the track from here would leave the bounds: then a plan that ends before it
    /// has turned leads to where nothing is possible any more.
    pub(crate) fn leads_out(&self, baseline: &Baseline, state: &State) -> Option<Violation> {
        let excess = self.excess_of_turn(state, baseline.curvature);
        (excess > baseline.turned_outside).then_some(Violation::Outside)
    }

    /// How far the sharpest turn of a path back to along the track leaves the bounds [m].
    fn excess_of_turn(&self, state: &State, curvature: f64) -> f64 {
        let course = state.yaw + state.sideslip;
        // Against a bend of the way it takes longer until the robot is along it.
        let bend = self.config.course.curvature(state.x) * course.signum();
        let way = (1.0 - course.cos()).min(1.0) / (curvature + bend).max(HARDLY_PER_M);
        excess(state.y + way.copysign(course.sin()), self.y_range_at(state.x))
    }

    fn wall_gap(&self, state: &State) -> f64 {
        if !self.config.track.walls {
            return f64::INFINITY;
        }
        let middle = (self.y_range[0] + self.y_range[1]) / 2.0;
        let [right, left] = self.config.track.y_m;
        // Walls are along a line: across it they are where they are in the plane.
        let body = self.config.vehicle.body([state.x, state.y, state.yaw]);
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
    /// Across the track, after the turn back.
    turned_outside: f64,
    /// Of the sharpest turn of a path [1/m].
    curvature: f64,
}

/// How far `value` is outside of `range` [m].
pub(crate) fn excess(value: f64, range: [f64; 2]) -> f64 {
    (range[0] - value).max(value - range[1]).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::Goal;

    #[test]
    fn a_body_is_beyond_the_goal_where_the_robot_rests_before_it_and_it_stays_there() {
        let config =
            ControllerConfig { goal: Goal { x_m: 6.0, ..Goal::default() }, ..ControllerConfig::default() };
        let is_beyond = |front_m: f64, yaw: f64, velocity: [f64; 2]| {
            let body = Rectangle { centre: Vector2::new(front_m + 0.1, 0.0), yaw, length: 0.2, width: 0.6 };
            let obstacle = PredictedObstacle {
                id: 1,
                centre: [front_m + 0.1, 0.0],
                velocity,
                a: 1.2,
                b: 0.8,
                body,
                in_plane: None,
            };
            Scene::new(&config, &[], State::default()).is_beyond_goal(&obstacle)
        };
        // 0.03 m behind the goal, 0.28 m of the robot and 0.05 m.
        assert_eq!([6.35, 6.37].map(|front_m| is_beyond(front_m, 0.0, [0.0; 2])), [false, true]);
        assert!(!is_beyond(6.37, 0.5, [0.0; 2]), "a corner is nearer");
        assert!(is_beyond(6.37, 0.0, [0.2, -0.5]) && !is_beyond(7.0, 0.0, [-0.2, 0.0]));
    }
}
