//! Whether a command may be driven, judged without the code of the controller: its controls are driven through the
//! integrator of the plant, past the bodies as they are described, and the wheels are blocked on the way.

use nalgebra::Vector2;
use shared_types::{Command, CommandKind, Obstacle, Obstacles, PlanNode, Pose};
use vehicle::geometry::Rectangle;
use vehicle::integrate::integrate;
use vehicle::{Control, Description, Goal, Parameters, State, Track};

/// The time for which a plan keeps clear, unless it ends before [s].
const CLEAR_S: f64 = 2.72;
/// Time between two places that are checked [s].
const STEP_S: f64 = 0.02;
/// Scan periods after which the wheels may be blocked instead of the next command: by the next scan, by the actuator, by
/// the dead man of the robot.
const BLOCKED_AFTER: [f64; 3] = [1.0, 1.5, 2.0];
/// True speed per described speed, and true deceleration per described one, at worst.
const WORST: [f64; 2] = [1.05, 0.8];
/// The judge and the controller check different samples of the same way [m].
const TOLERANCE_M: f64 = 0.005;
/// Velocities below it are noise [m/s].
const STANDING_MPS: f64 = 0.08;
/// How long a robot that stops is thought to rest [s].
const REST_S: f64 = 5.0;
/// Largest velocity above a limit that is rounding [m/s].
const ROUNDING: f64 = 1e-6;

/// What the commands of a controller are judged by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Judge {
    pub(crate) vehicle: Description,
    pub(crate) track: Track,
    pub(crate) goal: Goal,
    /// Bounds of the lateral position [m].
    pub(crate) y_range: [f64; 2],
    /// Distance that the body keeps in any case [m].
    pub(crate) clearance_m: f64,
    /// Time between two scans [s].
    pub(crate) period_s: f64,
    /// Whether ellipses are judged too: their noise is smoothed, so they must be described without.
    pub(crate) ellipses: bool,
}

impl Judge {
    /// Why a command may not be driven; `None` for a stop, and for a drive that is safe.
    pub(crate) fn objection(&self, command: &Command, pose: &Pose, obstacles: &Obstacles) -> Option<String> {
        if command.kind != CommandKind::Drive.wire() {
            return (command.verified != 0).then(|| "a stop that counts as a verified drive".to_owned());
        }
        let nodes = command.plan.get(..command.plan_length as usize).filter(|nodes| nodes.len() >= 2);
        let Some(nodes) = nodes else { return Some(format!("{} nodes", command.plan_length)) };
        let (first, limit_mps) = (control(&nodes[0]), command.speed_limit_mps);
        if (command.velocity_mps, command.steering_rad) != (first.velocity, first.steering) {
            return Some("the command is not that of its plan".to_owned());
        }
        if command.velocity_mps > limit_mps + ROUNDING {
            return Some(format!("faster than {limit_mps} m/s"));
        }
        let controls: Vec<Control> = nodes[..nodes.len() - 1].iter().map(control).collect();
        self.against(&controls, command.plan_interval_s, pose, obstacles)
            .or_else(|| self.defect(nodes, &controls, command.plan_interval_s, pose))
    }

    /// Why controls may not be driven.
    pub(crate) fn against(
        &self,
        controls: &[Control],
        interval_s: f64,
        pose: &Pose,
        obstacles: &Obstacles,
    ) -> Option<String> {
        if let Some(control) =
            controls.iter().find(|control| !self.vehicle.bounds.contains(**control, ROUNDING))
        {
            return Some(format!("{control:?} is outside of the bounds"));
        }
        let surroundings = Surroundings::new(self, pose, obstacles);
        let (parameters, mut state) = (self.vehicle.parameters(), start(pose));
        let parts = (interval_s / STEP_S).ceil();
        let (mut t, step_s) = (0.0, interval_s / parts);
        for control in controls.iter().flat_map(|control| std::iter::repeat_n(control, parts as usize)) {
            if t > CLEAR_S - step_s || state.x > self.goal.x_m {
                break;
            }
            state = integrate(&parameters, &state, control, step_s);
            t += step_s;
            if let Some(objection) = surroundings.at(t, &state, true) {
                return Some(format!("after {t:.2} s: {objection}"));
            }
        }
        self.held(&surroundings, &parameters, pose, &controls[0])
    }

    /// What a robot touches that gets no other command: it holds the first control until its wheels are blocked.
    fn held(
        &self,
        surroundings: &Surroundings,
        parameters: &Parameters,
        pose: &Pose,
        control: &Control,
    ) -> Option<String> {
        let (mut t, mut state, mut speed) = (0.0, start(pose), pose.predicted_speed_mps.abs());
        for after_s in BLOCKED_AFTER.map(|periods| periods * self.period_s) {
            while t < after_s {
                speed = control.velocity.max(speed - self.vehicle.deceleration_max_mps2 * STEP_S);
                (t, state) = (t + STEP_S, integrate(parameters, &state, control, STEP_S));
                if state.x > self.goal.x_m {
                    return None;
                }
                if let Some(objection) = surroundings.at(t, &state, false) {
                    return Some(format!("without another command: {objection}"));
                }
            }
            if let Some(objection) = self.slide(surroundings, parameters, t, &state, control, speed) {
                return Some(format!("blocked after {t:.2} s: {objection}"));
            }
        }
        None
    }

    /// What a robot touches that blocks its wheels here, and slides along the arc of its control.
    fn slide(
        &self,
        surroundings: &Surroundings,
        parameters: &Parameters,
        t: f64,
        from: &State,
        control: &Control,
        speed: f64,
    ) -> Option<String> {
        let curvature = vehicle::model::steady_turn(parameters, control).1 / control.velocity;
        let deceleration = WORST[1] * self.vehicle.blocked_deceleration_mps2;
        let (mut state, mut left, mut elapsed) = (*from, WORST[0] * speed, 0.0);
        while left > 0.0 {
            let way = left * STEP_S / 2.0;
            state.yaw += curvature * way;
            (state.x, state.y) = {
                let course = state.yaw + state.sideslip;
                (state.x + way * course.cos(), state.y + way * course.sin())
            };
            (left, elapsed) = (left - deceleration * STEP_S / 2.0, elapsed + STEP_S / 2.0);
            if let Some(objection) = surroundings.at(t + elapsed, &state, false) {
                return Some(format!("blocked wheels: {objection}"));
            }
        }
        None
    }

    /// The node that controls do not lead to.
    fn defect(
        &self,
        nodes: &[PlanNode],
        controls: &[Control],
        interval_s: f64,
        pose: &Pose,
    ) -> Option<String> {
        let (parameters, mut state) = (self.vehicle.parameters(), start(pose));
        for (node, control) in nodes[1..].iter().zip(controls).take((CLEAR_S / interval_s).ceil() as usize) {
            state = integrate(&parameters, &state, control, interval_s);
            let defect = (node.x_m - state.x).hypot(node.y_m - state.y);
            if defect.is_nan() || defect >= TOLERANCE_M {
                return Some(format!("a node is {defect} m from where its controls lead"));
            }
        }
        None
    }
}

/// The bodies, and how near the robot is to them at the start of the plan.
struct Surroundings<'a> {
    judge: &'a Judge,
    items: Vec<Obstacle>,
    lead_s: f64,
    gaps: Vec<f64>,
    values: Vec<f64>,
    wall_m: f64,
    outside_m: f64,
}

impl<'a> Surroundings<'a> {
    fn new(judge: &'a Judge, pose: &Pose, obstacles: &Obstacles) -> Self {
        let items = obstacles.list().to_vec();
        let lead_s = (pose.predicted_ns - pose.header.acquired_ns) as f64 * 1e-9;
        let mut surroundings =
            Self { judge, items, lead_s, gaps: Vec::new(), values: Vec::new(), wall_m: 0.0, outside_m: 0.0 };
        let state = start(pose);
        let gap = |item: &Obstacle| surroundings.gap(item, 0.0, &state).min(judge.clearance_m);
        let value = |item: &Obstacle| surroundings.value(item, 0.0, &state).min(1.0);
        (surroundings.gaps, surroundings.values) =
            (surroundings.items.iter().map(gap).collect(), surroundings.items.iter().map(value).collect());
        if surroundings.strikes_at_rest(&state, pose.predicted_speed_mps) {
            // The robot gets out of the way of a body that would touch it at rest: no contact is all it must keep.
            surroundings.gaps.iter_mut().for_each(|gap| *gap = gap.min(0.0));
            surroundings.values.fill(f64::NEG_INFINITY);
        }
        surroundings.wall_m = surroundings.wall_gap(&state).min(judge.clearance_m);
        surroundings.outside_m = surroundings.outside(&state).max(0.05);
        surroundings
    }

    /// Whether a body comes nearer than the clearance to a robot that blocks its wheels here.
    fn strikes_at_rest(&self, from: &State, speed: f64) -> bool {
        let (sin, cos) = (from.yaw + from.sideslip).sin_cos();
        let deceleration = WORST[1] * self.judge.vehicle.blocked_deceleration_mps2;
        let way = (WORST[0] * speed).powi(2) / (2.0 * deceleration);
        let rest = State { x: from.x + way * cos, y: from.y + way * sin, ..*from };
        let near = |item: &Obstacle, t: f64| self.gap(item, t, &rest) < self.judge.clearance_m + TOLERANCE_M;
        let comes = |item: &&Obstacle| item.velocity_x_mps.hypot(item.velocity_y_mps) >= STANDING_MPS / 2.0;
        let steps = (REST_S / STEP_S) as usize;
        let mut moving = self.items.iter().filter(comes);
        moving.any(|item| (0..=steps).any(|step| near(item, step as f64 * STEP_S)))
    }

    /// What the robot touches, or leaves, at `t` after the start of the plan.
    fn at(&self, t: f64, state: &State, drives: bool) -> Option<String> {
        if !state.is_finite() {
            return Some("not finite".to_owned());
        }
        if self.judge.track.walls && self.wall_gap(state) < self.wall_m - TOLERANCE_M {
            return Some(format!("{} m from a wall", self.wall_gap(state)));
        }
        if drives && self.outside(state) > self.outside_m + TOLERANCE_M {
            return Some(format!("outside of the track by {} m", self.outside(state)));
        }
        for ((item, gap), value) in self.items.iter().zip(&self.gaps).zip(&self.values) {
            if self.gap(item, t, state) < gap - TOLERANCE_M {
                return Some(format!("{} m from body {}", self.gap(item, t, state), item.id));
            }
            if drives && self.judge.ellipses && self.value(item, t, state) < value - 0.015 {
                return Some(format!("inside of ellipse {}", item.id));
            }
        }
        None
    }

    fn gap(&self, item: &Obstacle, t: f64, state: &State) -> f64 {
        let [dx, dy] = self.travel(item, t);
        let body = Rectangle {
            centre: Vector2::new(item.box_x_m + dx, item.box_y_m + dy),
            yaw: item.box_yaw_rad,
            length: item.box_length_m,
            width: item.box_width_m,
        };
        self.robot(state).distance_to_rectangle(&body)
    }

    fn value(&self, item: &Obstacle, t: f64, state: &State) -> f64 {
        let [dx, dy] = self.travel(item, t);
        ((state.x - item.x_m - dx) / item.a_m).powi(2) + ((state.y - item.y_m - dy) / item.b_m).powi(2)
    }

    fn travel(&self, item: &Obstacle, t: f64) -> [f64; 2] {
        let velocity = [item.velocity_x_mps, item.velocity_y_mps];
        let moves = velocity[0].hypot(velocity[1]) >= STANDING_MPS;
        velocity.map(|velocity| if moves { velocity * (self.lead_s + t) } else { 0.0 })
    }

    fn robot(&self, state: &State) -> Rectangle {
        self.judge.vehicle.body([state.x, state.y, state.yaw])
    }

    fn wall_gap(&self, state: &State) -> f64 {
        let body = self.robot(state);
        self.judge
            .track
            .y_m
            .map(|wall| body.distance_to_wall(wall, 0.0))
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }

    fn outside(&self, state: &State) -> f64 {
        let excess = |value: f64, [low, high]: [f64; 2]| (low - value).max(value - high);
        excess(state.y, self.judge.y_range).max(excess(state.x, self.judge.track.x_m))
    }
}

/// The state when the command acts.
fn start(pose: &Pose) -> State {
    State {
        sideslip: pose.predicted_sideslip_rad,
        yaw: pose.predicted_yaw_rad,
        yaw_rate: pose.predicted_yaw_rate_radps,
        x: pose.predicted_x_m,
        y: pose.predicted_y_m,
    }
}

fn control(node: &PlanNode) -> Control {
    Control { velocity: node.velocity_mps, steering: node.steering_rad }
}
