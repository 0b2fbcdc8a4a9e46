//! One scan in, one command out: the order of the decisions.
//!
//! 1. Inputs that mean nothing, or contradict each other, stop the robot.
//! 2. Landing is decided by position alone.
//! 3. The guide chooses the sides, and shows whether there is a way.
//! 4. The optimal control problem is solved from the best start, then from others.
//! 5. Only a verified plan is driven: converged, best iterate, or the rest of the last plan; else stop.
//! 6. The stop rule looks behind the end of the plan.
//!
//! Pure: the time comes with the samples, the clock of the budget is handed in. After [`Controller::resume`] a
//! controller gives the same commands as the one whose [`Controller::state`] it got.

use shared_types::{
    Command, CommandKind, Level, Obstacles, PLAN_NODES, PlanNode, Pose, SolveStatus, StopReason,
};
use vehicle::{Control, Invalid, State};

use crate::config::Config;
use crate::guide::{Guide, Query, Search};
use crate::landing::{Approach, approach};
use crate::problem::{Budget, EllipsePath, Problem, Solution, Trajectory};
use crate::reference::{self, Pace};
use crate::scene::{self, Hazard};
use crate::side::Sides;
use crate::sqp::Solver;
use crate::state::ControllerState;
use crate::stop_rule::is_blocked;
use crate::verify::{Driven, Scene, Verdict, verify};
use crate::warm;

/// Velocities at which a way past moving bodies is looked for, as shares of the cruising velocity.
const SLOWER: [f64; 4] = [1.0, 0.6, 0.35, 0.15];
/// Longest time from the scan to the start of the plan [s]: an older pose is contradictory.
const LONGEST_LEAD_S: f64 = 1.0;
/// How far outside of its bounds a robot may start [m]. Further means the track and the pose contradict.
const FAR_OUTSIDE_M: f64 = 1.0;
/// How deep the body may overlap a described box [m]: more is a contradiction, as the robot is not inside.
const OVERLAP_M: f64 = 0.03;
/// Longest time that the rest of an old plan may be driven [s].
const LONGEST_REST_S: f64 = 1.0;
/// Largest distance between the solver's positions and those driven of a converged plan [m].
const LARGEST_DEFECT_M: f64 = 0.01;

/// The controller of the robot.
#[derive(Debug, Clone)]
pub struct Controller {
    config: Config,
    solver: Solver,
    search: Search,
    state: ControllerState,
    sides: Sides,
    hazards: Vec<Hazard>,
    guide: Guide,
    problem: Problem,
    guess: Trajectory,
    driven: Driven,
    controls: Vec<Control>,
}

/// A plan that may be driven.
#[derive(Debug, Clone, Copy)]
struct Choice {
    level: Level,
    verdict: Verdict,
}

impl Controller {
    /// A controller that has not seen a scan.
    ///
    /// # Errors
    /// [`Invalid`] with the first setting that is not allowed.
    pub fn new(config: Config) -> Result<Self, Invalid> {
        config.validate()?;
        let problem = Problem {
            parameters: config.parameters,
            bounds: config.bounds,
            x_range: config.track.x_m,
            y_range: config.y_range(),
            intervals: vec![config.interval_s(); config.intervals],
            initial: State::default(),
            previous: None,
            references: Vec::with_capacity(config.intervals),
            control_reference: Control::default(),
            weights: config.problem_weights(),
            ellipses: Vec::with_capacity(config.max_ellipses),
        };
        Ok(Self {
            solver: Solver::new(config.solver),
            search: Search::new(config.guide),
            state: ControllerState::default(),
            sides: Sides::default(),
            hazards: Vec::with_capacity(shared_types::MAX_OBSTACLES),
            guide: Guide::default(),
            problem,
            guess: Trajectory::default(),
            driven: Driven::default(),
            controls: Vec::with_capacity(config.intervals),
            config,
        })
    }

    /// The settings.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The path that the last plan followed.
    pub fn guide(&self) -> &Guide {
        &self.guide
    }

    /// What a restarted controller goes on from.
    pub fn state(&self) -> ControllerState {
        ControllerState { sides: *self.sides.entries(), ..self.state }
    }

    /// Goes on from the state of another controller; a plan without meaning is left out.
    pub fn resume(&mut self, state: &ControllerState) {
        self.state = *state;
        self.sides = Sides::from_entries(&state.sides);
        let length = state.plan_length as usize;
        let finite = |node: &PlanNode| node.velocity_mps.is_finite() && node.steering_rad.is_finite();
        let sound = (2..=PLAN_NODES).contains(&length)
            && state.plan[..length].iter().all(finite)
            && (1e-3..=10.0).contains(&state.plan_interval_s);
        if !sound {
            self.state.plan_length = 0;
        }
        let last = Control { velocity: state.velocity_mps, steering: state.steering_rad };
        if !last.is_finite() {
            (self.state.velocity_mps, self.state.steering_rad) = (0.0, 0.0);
        }
    }

    /// The command for one scan. `solve_ns` and the stamps of the header are left to the caller.
    pub fn step(&mut self, pose: &Pose, obstacles: &Obstacles, budget: &Budget) -> Command {
        let mut command = Command {
            header: obstacles.header.answer_both(&pose.header),
            plan_start_ns: pose.predicted_ns,
            plan_interval_s: self.config.interval_s(),
            ..Command::default()
        };
        let period_s = self.period(pose);
        self.state.acquired_ns = pose.header.acquired_ns;
        match self.decide(pose, obstacles, period_s, budget, &mut command) {
            Ok(choice) => self.drive(choice, &mut command),
            Err(reason) => self.stop(reason, &mut command),
        }
        command
    }

    /// The decisions in their order; an error is the reason to block the wheels.
    fn decide(
        &mut self,
        pose: &Pose,
        obstacles: &Obstacles,
        period_s: f64,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        if self.state.landed == 1 {
            return Err(StopReason::Landed);
        }
        let initial = self.read(pose, obstacles)?;
        let goal = &self.config.goal;
        match approach(goal, &initial, pose.predicted_speed_mps, period_s, self.config.deceleration_mps2) {
            Approach::Land => return Err(StopReason::Landed),
            Approach::Passed => return Err(StopReason::GoalPassed),
            Approach::Ahead => {}
        }
        self.look_ahead(&initial);
        command.side = self.nearest_side(&initial);
        self.wait_for_a_way()?;

        self.pose_problem(&initial);
        let choice = self.plan(&initial, pose.predicted_ns, budget, command);
        let scene = scene_of(&self.config, &self.hazards, initial);
        let Ok(choice) = choice else {
            // Without a plan there is nothing to wait for; the reason is the path, or else the plan.
            let blocked = !self.guide.clear && is_blocked(&scene, &[], f64::INFINITY, 0.0);
            return Err(if blocked { StopReason::Blocked } else { StopReason::Unverified });
        };
        let guided = self.guide.clear && warm::agrees(&scene, &self.guide, &self.driven.way);
        if !guided && is_blocked(&scene, &self.driven.way, command.slack, self.config.stop.slack) {
            return Err(StopReason::Blocked);
        }
        Ok(choice)
    }

    /// Time between the last two scans [s].
    fn period(&self, pose: &Pose) -> f64 {
        let since = pose.header.acquired_ns.saturating_sub(self.state.acquired_ns) as f64 * 1e-9;
        if self.state.acquired_ns != 0 && (0.005..=1.0).contains(&since) { since } else { self.config.period_s }
    }

    /// The state at the start of the plan, with the obstacles read into `hazards`.
    fn read(&mut self, pose: &Pose, obstacles: &Obstacles) -> Result<State, StopReason> {
        let initial = State {
            sideslip: pose.predicted_sideslip_rad,
            yaw: pose.predicted_yaw_rad,
            yaw_rate: pose.predicted_yaw_rate_radps,
            x: pose.predicted_x_m,
            y: pose.predicted_y_m,
        };
        let lead_s = (pose.predicted_ns as f64 - pose.header.acquired_ns as f64) * 1e-9;
        let track = &self.config.track;
        let [low, high] = self.config.y_range();
        let inside = initial.x > track.x_m[0] - FAR_OUTSIDE_M
            && initial.x < track.x_m[1] + FAR_OUTSIDE_M
            && initial.y > low - FAR_OUTSIDE_M
            && initial.y < high + FAR_OUTSIDE_M;
        let sound = initial.is_finite()
            && inside
            && initial.sideslip.abs() < 1.0
            && initial.yaw.abs() < 10.0
            && initial.yaw_rate.abs() < 10.0
            && (0.0..10.0).contains(&pose.predicted_speed_mps.abs())
            && (0.0..=LONGEST_LEAD_S).contains(&lead_s)
            && pose.header.scan_id == obstacles.header.scan_id;
        if !sound || !scene::read(obstacles, lead_s, &mut self.hazards) {
            return Err(StopReason::BadInput);
        }
        let scene = scene_of(&self.config, &self.hazards, initial);
        let body = scene.body_at(&initial);
        let reach = body.length + body.width;
        let overlaps = |hazard: &Hazard| {
            let distance = (hazard.body.centre - body.centre).norm();
            distance < reach + hazard.body.length + hazard.body.width
                && body.distance_to_rectangle(&hazard.body) < -OVERLAP_M
        };
        if self.hazards.iter().any(overlaps) { Err(StopReason::BadInput) } else { Ok(initial) }
    }

    /// Finds the guide, and with it the sides.
    fn look_ahead(&mut self, initial: &State) {
        let config = &self.config;
        let goal = &config.goal;
        let reach = initial.x + config.guide.range_m;
        let (low, high) = (initial.y.min(goal.y_m) - 0.1, initial.y.max(goal.y_m) + 0.1);
        let margin = config.ellipse_margin_m + config.guide.comfort_m;
        let in_the_way = |hazard: &Hazard| {
            let [x, y] = hazard.centre;
            hazard.moves()
                || (x - hazard.a < reach
                    && x + hazard.a + margin > initial.x
                    && y - hazard.b - margin < high
                    && y + hazard.b + margin > low)
        };
        if self.hazards.iter().any(in_the_way) {
            let full = Control { velocity: config.cruise_mps, steering: config.bounds.steering_max_rad };
            let moving = self.hazards.iter().any(Hazard::moves);
            for share in SLOWER {
                let query = Query {
                    start: *initial,
                    line: goal.y_m,
                    goal_x: goal.x_m,
                    y_range: config.y_range(),
                    curvature: vehicle::model::steady_turn(&config.parameters, &full).1 / full.velocity,
                    margin: config.ellipse_margin_m,
                    speed: (config.cruise_mps * share).max(config.bounds.velocity_min_mps),
                    hazards: &self.hazards,
                    sides: &self.sides,
                };
                self.search.find(&query, &mut self.guide);
                if std::env::var_os("DBG").is_some() && !self.guide.clear { eprintln!("unclear {query:?}\n {:?}", self.guide); }
                if self.guide.clear || !moving {
                    break;
                }
            }
        } else {
            self.guide.set_line(initial.x, goal.y_m, config.cruise_mps);
        }
        let guide = &self.guide;
        self.sides.renew(&self.hazards, |hazard| guide.side_of(hazard));
    }

    /// Side on which the nearest obstacle that the line leads through is passed.
    fn nearest_side(&self, initial: &State) -> i32 {
        let line = self.config.goal.y_m;
        let in_the_way = |hazard: &&Hazard| {
            hazard.centre[0] > initial.x && (hazard.centre[1] - line).abs() < hazard.b && self.sides.held(hazard) != 0
        };
        let nearest = self.hazards.iter().filter(in_the_way).min_by(|a, b| a.centre[0].total_cmp(&b.centre[0]));
        nearest.map_or(0, |hazard| i32::from(self.sides.held(hazard)))
    }

    /// After a stop in front of a blocked path: waits until a way was clear for a while.
    fn wait_for_a_way(&mut self) -> Result<(), StopReason> {
        if self.state.blocked_scans == 0 {
            return Ok(());
        }
        self.state.clear_scans = if self.guide.clear { self.state.clear_scans.saturating_add(1) } else { 0 };
        let stop = &self.config.stop;
        if self.state.blocked_scans < stop.hold_scans || self.state.clear_scans < stop.resume_scans {
            return Err(StopReason::Blocked);
        }
        Ok(())
    }

    fn pace(&self) -> Pace {
        let speed = if self.guide.clear { self.guide.speed } else { self.config.stop.approach_mps };
        Pace {
            cruise: speed.min(self.config.cruise_mps),
            slowest: self.config.bounds.velocity_min_mps,
            goal_x: self.config.goal.x_m,
            landing_time: self.config.landing_time_s,
        }
    }

    /// Fills the optimal control problem of this scan.
    fn pose_problem(&mut self, initial: &State) {
        let (config, pace) = (&self.config, self.pace());
        let problem = &mut self.problem;
        problem.initial = *initial;
        let last = Control { velocity: self.state.velocity_mps, steering: self.state.steering_rad };
        problem.previous = (last.velocity > 0.0).then_some(last);
        problem.control_reference = reference::fill(
            &self.guide,
            &pace,
            initial.x,
            config.interval_s(),
            config.intervals,
            &mut problem.references,
        );
        fill_ellipses(config, &self.hazards, initial, &mut problem.ellipses);
    }

    /// The best plan that may be driven; its way is in `driven`, its controls are in `controls`.
    fn plan(
        &mut self,
        initial: &State,
        start_ns: u64,
        budget: &Budget,
        command: &mut Command,
    ) -> Result<Choice, StopReason> {
        let interval_s = self.config.interval_s();
        let elapsed_s = start_ns.saturating_sub(self.state.plan_start_ns) as f64 * 1e-9;
        let fresh = self.state.plan_length >= 2
            && self.state.plan_start_ns <= start_ns
            && elapsed_s < LONGEST_REST_S
            && (self.state.plan_interval_s - interval_s).abs() < 1e-9;
        let mut used = 0;
        for start in [Start::LastPlan, Start::Guide] {
            if start == Start::LastPlan && !(fresh && self.start_from_plan(initial, elapsed_s)) {
                continue;
            }
            if start == Start::Guide {
                self.start_from_guide(initial);
            }
            if let Some(choice) = self.solve(initial, budget, &mut used, command) {
                return Ok(choice);
            }
        }
        // The guide as it is: an iterate too, the one before the first.
        self.start_from_guide(initial);
        let scene = scene_of(&self.config, &self.hazards, *initial);
        let verdict = verify(&scene, &self.guess.controls, &mut self.driven);
        if std::env::var_os("DBG").is_some() { eprintln!("guide plan {verdict:?} clear {}", self.guide.clear); }
        if verdict.holds() && self.guide.clear {
            self.controls.clone_from(&self.guess.controls);
            return Ok(Choice { level: Level::BestIterate, verdict });
        }
        if fresh {
            self.read_plan();
            warm::shift(&self.controls, interval_s, elapsed_s, &mut self.guess.controls);
            let left = self.guess.controls.len().saturating_sub((elapsed_s / interval_s).ceil() as usize);
            self.guess.controls.truncate(left);
            let scene = scene_of(&self.config, &self.hazards, *initial);
            let verdict = verify(&scene, &self.guess.controls, &mut self.driven);
            if verdict.holds() {
                self.controls.clone_from(&self.guess.controls);
                return Ok(Choice { level: Level::LastPlan, verdict });
            }
        }
        Err(StopReason::Unverified)
    }

    /// The last plan, moved on, as the start; false when it passes something on another side than the guide.
    fn start_from_plan(&mut self, initial: &State, elapsed_s: f64) -> bool {
        self.read_plan();
        if self.controls.len() != self.config.intervals {
            return false;
        }
        warm::shift(&self.controls, self.config.interval_s(), elapsed_s, &mut self.guess.controls);
        self.simulate_guess(initial);
        let scene = scene_of(&self.config, &self.hazards, *initial);
        warm::agrees(&scene, &self.guide, &self.driven.way)
    }

    fn start_from_guide(&mut self, initial: &State) {
        let scene = scene_of(&self.config, &self.hazards, *initial);
        warm::follow(&scene, &self.guide, &self.pace(), self.config.intervals, &mut self.guess.controls);
        self.simulate_guess(initial);
    }

    /// Puts the states that the controls of the guess lead to into it.
    fn simulate_guess(&mut self, initial: &State) {
        warm::clamp(&self.config.bounds, &mut self.guess.controls);
        let scene = scene_of(&self.config, &self.hazards, *initial);
        verify(&scene, &self.guess.controls, &mut self.driven);
        self.guess.states.clone_from(&self.driven.nodes);
    }

    /// Solves from `guess`, and takes the result when it may be driven.
    fn solve(
        &mut self,
        initial: &State,
        budget: &Budget,
        used: &mut u32,
        command: &mut Command,
    ) -> Option<Choice> {
        if !budget.allows(*used) {
            return None;
        }
        let rest = match budget {
            Budget::Iterations(limit) => Budget::Iterations(limit - *used),
            Budget::Deadline { deadline_ns, now_ns } => {
                Budget::Deadline { deadline_ns: *deadline_ns, now_ns: *now_ns }
            }
        };
        let solution = self.solver.solve(&self.problem, &self.guess, &rest);
        *used = used.saturating_add(solution.iterations.max(1));
        report(&solution, *used, command);
        if matches!(solution.status, SolveStatus::Failed | SolveStatus::NotSolved) {
            return None;
        }
        self.controls.clone_from(&solution.trajectory.controls);
        if self.controls.len() != self.config.intervals || !self.controls.iter().all(Control::is_finite) {
            return None;
        }
        warm::clamp(&self.config.bounds, &mut self.controls);
        let scene = scene_of(&self.config, &self.hazards, *initial);
        let verdict = verify(&scene, &self.controls, &mut self.driven);
        if std::env::var_os("DBG").is_some() && !verdict.holds() { eprintln!("solve {:?} {verdict:?} values {:?}", solution.status, self.hazards.iter().map(|h| h.value(0.0, initial.x, initial.y)).collect::<Vec<_>>());
          for n in &self.driven.nodes { eprint!("({:.3} {:.3} {:.3}) ", n.x, n.y, self.hazards.iter().map(|h| h.value(0.0, n.x, n.y)).fold(9.0, f64::min)); } eprintln!(); }
        let agrees = !self.guide.clear || warm::agrees(&scene, &self.guide, &self.driven.way);
        if !verdict.holds() || !agrees {
            return None;
        }
        let defect = largest_distance(&solution.trajectory.states, &self.driven.nodes);
        command.largest_violation = command.largest_violation.max(defect);
        let exact = solution.status == SolveStatus::Converged && defect < LARGEST_DEFECT_M;
        Some(Choice { level: if exact { Level::Converged } else { Level::BestIterate }, verdict })
    }

    /// Puts the controls of the last plan into `controls`.
    fn read_plan(&mut self) {
        self.controls.clear();
        let length = self.state.plan_length as usize;
        let control = |node: &PlanNode| Control { velocity: node.velocity_mps, steering: node.steering_rad };
        self.controls.extend(self.state.plan[..length.saturating_sub(1)].iter().map(control));
    }

    fn drive(&mut self, choice: Choice, command: &mut Command) {
        let intervals = choice.verdict.intervals.min(self.controls.len());
        for (index, state) in self.driven.nodes.iter().enumerate().take(intervals + 1) {
            // The last node repeats the control before it: nothing is planned behind it.
            let control = self.controls[index.min(intervals.max(1) - 1)];
            command.plan[index] = PlanNode {
                x_m: state.x,
                y_m: state.y,
                yaw_rad: state.yaw,
                sideslip_rad: state.sideslip,
                yaw_rate_radps: state.yaw_rate,
                velocity_mps: control.velocity,
                steering_rad: control.steering,
            };
        }
        command.plan_length = intervals as u32 + 1;
        command.kind = CommandKind::Drive.wire();
        command.level = choice.level.wire();
        command.reason = StopReason::None.wire();
        command.verified = 1;
        (command.velocity_mps, command.steering_rad) = (self.controls[0].velocity, self.controls[0].steering);

        let state = &mut self.state;
        (state.blocked_scans, state.clear_scans) = (0, 0);
        (state.velocity_mps, state.steering_rad) = (command.velocity_mps, command.steering_rad);
        state.plan = command.plan;
        state.plan_length = command.plan_length;
        state.plan_start_ns = command.plan_start_ns;
        state.plan_interval_s = command.plan_interval_s;
    }

    fn stop(&mut self, reason: StopReason, command: &mut Command) {
        command.kind = if reason == StopReason::Landed { CommandKind::Land } else { CommandKind::Stop }.wire();
        command.level = Level::Stop.wire();
        command.reason = reason.wire();
        let state = &mut self.state;
        match reason {
            StopReason::Landed => state.landed = 1,
            StopReason::Blocked => state.blocked_scans = state.blocked_scans.saturating_add(1),
            _ => {}
        }
        // A robot that stands has no control before the next one, and an old plan does not start from standstill.
        (state.velocity_mps, state.steering_rad) = (0.0, 0.0);
        state.plan_length = 0;
    }
}

/// Where a solve starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Start {
    LastPlan,
    Guide,
}

fn scene_of<'a>(config: &'a Config, hazards: &'a [Hazard], initial: State) -> Scene<'a> {
    Scene {
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

/// Fills the ellipses that the horizon can reach, nearest first.
fn fill_ellipses(config: &Config, hazards: &[Hazard], initial: &State, ellipses: &mut Vec<EllipsePath>) {
    let reach = config.bounds.velocity_max_mps * config.horizon_s;
    let in_reach = |hazard: &&Hazard| {
        let [x, y] = hazard.centre;
        let travel = hazard.velocity[0].hypot(hazard.velocity[1]) * config.horizon_s;
        (x - initial.x).abs() < reach + hazard.a + travel
            && (y - initial.y).abs() < reach + hazard.b + travel
            && x + hazard.a + travel > initial.x
    };
    let mut count = 0;
    let mut least = (f64::NEG_INFINITY, 0);
    // Selection in place of a sort: at most sixteen, and nothing is allocated.
    while count < config.max_ellipses {
        let distance = |hazard: &Hazard| (hazard.centre[0] - initial.x).hypot(hazard.centre[1] - initial.y);
        let next = hazards
            .iter()
            .enumerate()
            .filter(|(_, hazard)| in_reach(hazard))
            .map(|(index, hazard)| (distance(hazard), index))
            .filter(|&candidate| count == 0 || candidate > least)
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some(next) = next else { break };
        least = next;
        let hazard = &hazards[next.1];
        if ellipses.len() <= count {
            ellipses.push(EllipsePath { a: 0.0, b: 0.0, centres: Vec::with_capacity(config.intervals + 1) });
        }
        let ellipse = &mut ellipses[count];
        (ellipse.a, ellipse.b) = (hazard.a + config.ellipse_margin_m, hazard.b + config.ellipse_margin_m);
        ellipse.centres.clear();
        let interval_s = config.interval_s();
        ellipse.centres.extend((0..=config.intervals).map(|node| hazard.centre_at(node as f64 * interval_s)));
        count += 1;
    }
    ellipses.truncate(count);
}

fn report(solution: &Solution, iterations: u32, command: &mut Command) {
    command.status = solution.status.wire();
    command.iterations = iterations;
    command.active_constraints = solution.active_constraints;
    // A failed solve reports infinities, which have no place in a sample.
    let finite = |value: f64| if value.is_finite() { value } else { f64::MAX };
    command.kkt_residual = finite(solution.kkt_residual);
    command.largest_violation = finite(solution.largest_violation);
    command.slack = finite(solution.slack);
    command.objective = finite(solution.objective);
}

fn largest_distance(planned: &[State], driven: &[State]) -> f64 {
    if planned.len() != driven.len() {
        return f64::MAX;
    }
    planned.iter().zip(driven).map(|(a, b)| (a.x - b.x).hypot(a.y - b.y)).fold(0.0, f64::max)
}
