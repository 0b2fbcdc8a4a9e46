//! Whether a plan may be driven. Keep this file: a command may have `verified = 1` only when its plan has passed.
//!
//! The controls of the plan are driven through the model of the robot, (7.27)-(7.31), in steps of 2 cm. A plan passes
//! when
//!
//! * all its controls are within their bounds, (7.41);
//! * the robot's centre stays within the bounds of the track, (7.45) and (7.46), up to 5 cm;
//! * the robot's body keeps its clearance to the box of each obstacle and to walls;
//! * the robot's centre enters no ellipse, (7.34).
//!
//! What is violated at the start already must not get worse. Nothing is checked behind the goal, where the robot lands.
//! Obstacles keep their velocity. The check believes the description of the obstacles and the predicted pose.

use shared_types::{MAX_OBSTACLES, Obstacle, Obstacles, PLAN_NODES, Pose};
use vehicle::geometry::Rectangle;
use vehicle::integrate::rk4;
use vehicle::{Control, State};

use crate::planner::Plan;
use crate::settings::Settings;

/// Length of a step [m]. The fastest motion of the model has 34 1/s at 1 m/s, and more at less speed: steps of equal
/// length resolve it at each velocity.
const STEP_M: f64 = 0.02;
/// Tolerance of the bounds of the controls: rounding.
const CONTROL_TOLERANCE: f64 = 1e-6;
/// How much deeper than at the start an ellipse may be entered, in units of (7.34). The ellipse moves a little from scan to
/// scan, and a robot at its edge must find a way on. The clearance of the body is kept apart from this.
const DEEPER: f64 = 0.03;
/// How far the centre may be outside of the track [m].
const OUTSIDE_M: f64 = 0.05;
/// Tolerance of a length [m]: rounding and the error of integration.
const TOLERANCE_M: f64 = 1e-3;
/// How far behind the goal the plan is still checked [m].
const BEHIND_GOAL_M: f64 = 0.03;
/// A slower obstacle stands still [m/s]: its estimated velocity is noise.
const MOVING_MPS: f64 = 0.1;

/// What the plans of one scan are checked against.
pub(crate) struct Scene<'a> {
    settings: &'a Settings,
    obstacles: &'a [Obstacle],
    /// State when the command acts: the start of all plans.
    pub(crate) start: State,
    /// Time from the scan to the start of the plan [s].
    lead_s: f64,
    /// Behind it nothing is checked [m].
    end_m: f64,
    limits: Limits,
}

/// What each state of a plan has to keep.
#[derive(Debug, Clone, Copy)]
struct Limits {
    /// Smallest value of (7.34) for each ellipse.
    ellipses: [f64; MAX_OBSTACLES],
    /// Smallest distance of the body to each obstacle [m].
    gaps_m: [f64; MAX_OBSTACLES],
    /// Smallest distance of the body to a wall [m].
    wall_m: f64,
    /// Largest distance of the centre from the track [m].
    outside_m: f64,
}

/// The states at the ends of the intervals of a plan that has passed; the first is the start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Verified {
    nodes: [State; PLAN_NODES],
    count: usize,
}

impl Verified {
    /// The states.
    pub(crate) fn nodes(&self) -> &[State] {
        &self.nodes[..self.count]
    }
}

impl<'a> Scene<'a> {
    /// The scene of one scan.
    pub(crate) fn new(settings: &'a Settings, pose: &Pose, obstacles: &'a Obstacles) -> Self {
        let start = State {
            sideslip: pose.predicted_sideslip_rad,
            yaw: pose.predicted_yaw_rad,
            yaw_rate: pose.predicted_yaw_rate_radps,
            x: pose.predicted_x_m,
            y: pose.predicted_y_m,
        };
        let lead_s = pose.predicted_ns.saturating_sub(pose.header.acquired_ns) as f64 * 1e-9;
        let limits = Limits {
            ellipses: [1.0; MAX_OBSTACLES],
            gaps_m: [settings.clearance_m; MAX_OBSTACLES],
            wall_m: settings.clearance_m,
            outside_m: OUTSIDE_M,
        };
        let end_m = settings.goal.x_m + BEHIND_GOAL_M;
        let mut scene = Self { settings, obstacles: obstacles.list(), start, lead_s, end_m, limits };
        scene.allow_what_is_violated_at_the_start();
        scene
    }

    /// One that is checked behind the goal too: a person does not land there.
    pub(crate) fn without_goal(settings: &'a Settings, pose: &Pose, obstacles: &'a Obstacles) -> Self {
        Self { end_m: f64::INFINITY, ..Self::new(settings, pose, obstacles) }
    }

    fn allow_what_is_violated_at_the_start(&mut self) {
        let mut limits = self.limits;
        for (index, obstacle) in self.obstacles.iter().enumerate() {
            limits.ellipses[index] = self.depth(obstacle, 0.0, &self.start).min(1.0) - DEEPER;
            limits.gaps_m[index] =
                self.gap_m(obstacle, 0.0, &self.start).min(limits.gaps_m[index]) - TOLERANCE_M;
        }
        limits.wall_m = self.wall_m(&self.start).min(limits.wall_m) - TOLERANCE_M;
        limits.outside_m = limits.outside_m.max(self.outside_m(&self.start) + TOLERANCE_M);
        self.limits = limits;
    }

    /// Drives a plan through the model; `None` when it may not be driven.
    pub(crate) fn verify(&self, plan: &Plan) -> Option<Verified> {
        let bounds = &self.settings.vehicle.bounds;
        if !plan.controls().iter().all(|control| bounds.contains(*control, CONTROL_TOLERANCE)) {
            return None;
        }
        let mut verified = Verified { nodes: [self.start; PLAN_NODES], count: 1 };
        let mut state = self.start;
        for (index, control) in plan.controls().iter().enumerate() {
            state = self.drive(state, control, index as f64 * plan.interval_s, plan.interval_s)?;
            verified.nodes[index + 1] = state;
            verified.count += 1;
        }
        Some(verified)
    }

    /// The state after one interval that begins at `t`; `None` when a step of it is not allowed.
    fn drive(&self, mut state: State, control: &Control, t: f64, interval_s: f64) -> Option<State> {
        let steps = (interval_s * control.velocity / STEP_M).ceil().max(1.0);
        let step_s = interval_s / steps;
        for step in 1..=steps as usize {
            state = rk4(&self.settings.vehicle.parameters(), &state, control, step_s);
            if !self.is_allowed(t + step as f64 * step_s, &state) {
                return None;
            }
        }
        Some(state)
    }

    /// Whether the robot may be at `state`, `t` seconds after the start of the plan. False for NaN.
    fn is_allowed(&self, t: f64, state: &State) -> bool {
        if !state.is_finite() {
            return false;
        }
        if state.x > self.end_m {
            return true;
        }
        let keeps = |(index, obstacle): (usize, &Obstacle)| {
            self.depth(obstacle, t, state) >= self.limits.ellipses[index]
                && self.gap_m(obstacle, t, state) >= self.limits.gaps_m[index]
        };
        self.outside_m(state) <= self.limits.outside_m
            && self.wall_m(state) >= self.limits.wall_m
            && self.obstacles.iter().enumerate().all(keeps)
    }

    /// (7.34): 1 on the ellipse, less inside.
    fn depth(&self, obstacle: &Obstacle, t: f64, state: &State) -> f64 {
        let [dx, dy] = self.travel_m(obstacle, t);
        let along = (state.x - obstacle.x_m - dx) / obstacle.a_m;
        let across = (state.y - obstacle.y_m - dy) / obstacle.b_m;
        along * along + across * across
    }

    /// Distance between the robot's body and the box of an obstacle, negative when they overlap [m].
    fn gap_m(&self, obstacle: &Obstacle, t: f64, state: &State) -> f64 {
        let [dx, dy] = self.travel_m(obstacle, t);
        let its_box = Rectangle {
            centre: [obstacle.box_x_m + dx, obstacle.box_y_m + dy].into(),
            yaw: obstacle.box_yaw_rad,
            length: obstacle.box_length_m,
            width: obstacle.box_width_m,
        };
        self.body(state).distance_to_rectangle(&its_box)
    }

    /// How far an obstacle has moved since the scan, `t` seconds after the start of the plan [m].
    fn travel_m(&self, obstacle: &Obstacle, t: f64) -> [f64; 2] {
        let velocity = [obstacle.velocity_x_mps, obstacle.velocity_y_mps];
        let moves = velocity[0].hypot(velocity[1]) > MOVING_MPS;
        velocity.map(|velocity| if moves { velocity * (self.lead_s + t) } else { 0.0 })
    }

    fn body(&self, state: &State) -> Rectangle {
        let (length, width) = (self.settings.vehicle.length_m, self.settings.vehicle.width_m);
        Rectangle { centre: [state.x, state.y].into(), yaw: state.yaw, length, width }
    }

    fn wall_m(&self, state: &State) -> f64 {
        let track = &self.settings.track;
        if !track.walls {
            return f64::INFINITY;
        }
        let (body, middle) = (self.body(state), (track.y_m[0] + track.y_m[1]) / 2.0);
        body.distance_to_wall(track.y_m[0], middle).min(body.distance_to_wall(track.y_m[1], middle))
    }

    /// Distance of the robot's centre from the track, 0 on it [m].
    pub(crate) fn outside_m(&self, state: &State) -> f64 {
        let beyond = |value: f64, range: [f64; 2]| (range[0] - value).max(value - range[1]).max(0.0);
        beyond(state.x, self.settings.track.x_m).max(beyond(state.y, self.settings.y_range()))
    }

    /// How deep the robot's body overlaps an obstacle at the start, 0 when it does not [m].
    pub(crate) fn overlap_m(&self) -> f64 {
        let gaps = self.obstacles.iter().map(|obstacle| self.gap_m(obstacle, 0.0, &self.start));
        gaps.fold(0.0, |deepest, gap| deepest.max(-gap))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::plans;
    use crate::settings::example;

    fn pose(x: f64, y: f64, yaw: f64) -> Pose {
        Pose { predicted_x_m: x, predicted_y_m: y, predicted_yaw_rad: yaw, ..Pose::default() }
    }

    /// A box 0.1 m long and 0.4 m wide, with an ellipse of these semi-axes.
    fn obstacle(x: f64, y: f64, a: f64, b: f64) -> Obstacles {
        let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
        obstacles.items[0] = Obstacle {
            x_m: x,
            y_m: y,
            a_m: a,
            b_m: b,
            box_x_m: x,
            box_y_m: y,
            box_length_m: 0.1,
            box_width_m: 0.4,
            ..Obstacle::default()
        };
        obstacles
    }

    /// Whether the plan straight along the line of the goal passes.
    fn passes(settings: &Settings, pose: &Pose, obstacles: &Obstacles) -> bool {
        let scene = Scene::new(settings, pose, obstacles);
        let (_, plan) = plans(settings, scene.start, 1.0, 0.0).next().unwrap();
        scene.verify(&plan).is_some()
    }

    #[test]
    fn a_plan_on_a_free_road_passes_with_a_node_more_than_controls() {
        let (settings, free) = (example(), Obstacles::default());
        let scene = Scene::new(&settings, &pose(0.0, 0.0, 0.0), &free);
        let (_, plan) = plans(&settings, scene.start, 1.0, 0.0).next().unwrap();
        let verified = scene.verify(&plan).unwrap();
        assert_eq!(verified.nodes().len(), plan.controls().len() + 1);
        let last = verified.nodes()[plan.controls().len()];
        assert!((last.x - 4.08).abs() < 1e-9 && last.y == 0.0, "24 intervals of 0.17 m: {last:?}");
    }

    #[test]
    fn a_control_beyond_its_bound_does_not_pass() {
        let (mut settings, free) = (example(), Obstacles::default());
        let pose = pose(0.0, 0.0, 0.0);
        assert!(passes(&settings, &pose, &free));
        settings.vehicle.bounds.velocity_max_mps = 0.9;
        let scene = Scene::new(&settings, &pose, &free);
        let (_, plan) = plans(&example(), scene.start, 1.0, 0.0).next().unwrap();
        assert!(scene.verify(&plan).is_none());
    }

    #[test]
    fn an_ellipse_is_not_entered_but_may_be_left() {
        let settings = example();
        assert!(!passes(&settings, &pose(0.0, 0.0, 0.0), &obstacle(3.0, 0.9, 1.2, 1.0)));
        assert!(passes(&settings, &pose(0.0, 0.0, 0.0), &obstacle(3.0, 0.9, 1.2, 0.8)));
        // Behind the middle of the ellipse, in it, and on the way out.
        assert!(passes(&settings, &pose(3.5, 0.0, 0.0), &obstacle(3.0, 0.9, 1.2, 1.0)));
    }

    #[test]
    fn the_body_keeps_its_clearance_where_the_ellipse_is_too_small() {
        let settings = example();
        // Half the body and half the box are 0.4 m: at 0.44 m beside each other 0.04 m are left, at 0.46 m 0.06 m.
        assert!(!passes(&settings, &pose(0.0, 0.0, 0.0), &obstacle(2.0, 0.44, 0.05, 0.05)));
        assert!(passes(&settings, &pose(0.0, 0.0, 0.0), &obstacle(2.0, 0.46, 0.05, 0.05)));
    }

    #[test]
    fn a_moving_obstacle_is_where_it_will_be() {
        let settings = example();
        let mut crossing = obstacle(2.0, -2.0, 0.5, 0.4);
        assert!(passes(&settings, &pose(0.0, 0.0, 0.0), &crossing));
        crossing.items[0].velocity_y_mps = 1.0;
        assert!(!passes(&settings, &pose(0.0, 0.0, 0.0), &crossing));
    }

    #[test]
    fn the_track_is_not_left_and_a_robot_outside_may_come_back() {
        let (settings, free) = (example(), Obstacles::default());
        let straight = |y: f64, yaw: f64| {
            let scene = Scene::new(&settings, &pose(0.0, y, yaw), &free);
            // The line is where the robot is, so the plan only turns it back to the direction of the track.
            let goal = crate::settings::Goal { y_m: y, ..settings.goal };
            let plan = plans(&Settings { goal, ..settings.clone() }, scene.start, 1.0, y).next().unwrap().1;
            scene.verify(&plan).is_some()
        };
        assert!(straight(1.4, 0.0));
        assert!(!straight(1.4, 0.4), "it swings further out than 1.55 m");
        assert!(straight(1.7, 0.0) && straight(1.7, -0.1));
        assert!(!straight(1.7, 0.2));
    }

    #[test]
    fn walls_are_kept_clear_by_the_corners_of_the_body() {
        let (mut settings, free) = (example(), Obstacles::default());
        (settings.track.walls, settings.theta_m) = (true, 0.0);
        settings.goal.y_m = 1.2;
        assert!(passes(&settings, &pose(0.0, 1.2, 0.1), &free));
        // The centre gets to 1.31 m, which its bound of 1.3 m allows; a corner gets beyond the wall at 1.5 m.
        assert!(!passes(&settings, &pose(0.0, 1.2, 0.26), &free));
        settings.goal.y_m = 1.27;
        assert!(passes(&settings, &pose(0.0, 1.27, 0.0), &free), "0.03 m from the wall, as at the start");
    }

    #[test]
    fn nothing_passes_from_a_state_that_is_no_number() {
        let settings = example();
        let broken = Pose { predicted_sideslip_rad: f64::NAN, ..pose(0.0, 0.0, 0.0) };
        for pose in [pose(0.0, f64::NAN, 0.0), broken] {
            assert!(!passes(&settings, &pose, &Obstacles::default()));
        }
    }

    #[test]
    fn nothing_is_checked_behind_the_goal() {
        // The plan ends 0.12 m behind the goal at 10 m; the ellipse begins 0.05 m behind it, then at it.
        let (settings, start) = (example(), pose(9.1, 0.0, 0.0));
        assert!(passes(&settings, &start, &obstacle(11.25, 0.0, 1.2, 0.8)));
        assert!(!passes(&settings, &start, &obstacle(11.2, 0.0, 1.2, 0.8)));
        // A person does not land there.
        let near = obstacle(11.25, 0.0, 1.2, 0.8);
        let scene = Scene::without_goal(&settings, &start, &near);
        assert!(scene.verify(&plans(&settings, scene.start, 1.0, 0.0).next().unwrap().1).is_none());
    }
}
