//! From the proposed path to a plan that may be driven. These are tried in turn:
//!
//! 1. the optimal control problem, solved from the last plan where that passes obstacles on the same sides, with a
//!    reserve of steering, then without;
//! 2. the optimal control problem, solved from the path;
//! 3. the optimal control problem from the last plan, with the part of the margin used up that is for noise;
//! 4. the path itself, followed by simple steering;
//! 5. the rest of the last plan.
//!
//! The reference of the problem is the line to the goal; the path gives the sides and the first guess. Only where a narrow
//! place has to be passed slowly, or nothing is clear, the path itself is the reference.
//!
//! A plan counts only when it is verified against the obstacles of this scan. An ellipse does not contain everything that
//! the body must keep clear of. Where a plan is refused for that, its ellipse is enlarged by what is missing, the problem
//! is solved again, and the next scans begin with most of the enlargement.

use std::sync::Arc;

use ocp::{ActiveLimit, Budget, Limit, Problem, Solution, Solver, Status, Trajectory};
use shared_types::{Command, Level, PlanNode, Pose, SolveStatus};
use vehicle::{Control, Parameters, State};

use crate::config::ControllerConfig;
use crate::ellipses::fill_ellipses;
use crate::escape::turn_away;
use crate::frames::Frames;
#[cfg(test)]
use crate::injection::{Injection, Place};
use crate::predicted_obstacle::PredictedObstacle;
use crate::reference::{self, Pace};
use crate::reference_path::ReferencePath;
use crate::rollout::Rollout;
use crate::scene::Scene;
use crate::smoothing::{MAX_GROWN_M, grown};
use crate::start::Start;
use crate::state::ControllerState;
use crate::verify::{VERIFIED_S, Verified, verify};
use crate::warm;

/// Longest time that the rest of an old plan may be driven [s].
const MAX_REST_S: f64 = 1.0;
/// The same at slow scan rates, in scan periods: the last plan is the guess for the next scan.
const MAX_REST_PERIODS: f64 = 1.5;
/// Shortest time constant of the approach to the goal, in scan periods: within one the robot gets half of the way.
const LANDING_PERIODS: f64 = 1.5;
/// How often a problem is solved again with ellipses that are enlarged by what the body misses.
const TIGHTENINGS: usize = 3;
/// By how much more an ellipse is enlarged [m].
const SPARE_M: f64 = 0.003;
/// A plan that covers this fraction of the distance of its reference does not slow down for anything.
const FAST_SHARE: f64 = 0.95;
/// Share of the largest steering angle that plans use at first: the rest is for corrections.
const STEERING_SHARE: f64 = 0.95;
/// Distance in addition to the margin that plans should keep [m].
const RESERVE_M: f64 = 0.02;
/// Weights of x along a path that is followed: in the integral and at the end.
const FOLLOWING: [f64; 2] = [1.0, 5.0];
/// Weights of x while a body moves: in the integral and at the end.
const HASTE: [f64; 2] = [20.0, 100.0];
/// Cruise below which the weights of x grow no further [m/s]; they hold for 1 m/s.
const SLOW_MPS: f64 = 0.4;
/// Share of an enlargement that the next scan begins with.
const GROWN_SHARE: f64 = 0.95;
/// Largest distance between the positions of the solver and those of the rollout in a converged plan [m].
const LARGEST_DEFECT_M: f64 = 0.01;

/// What a plan is made from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task<'a> {
    /// What a plan must respect.
    pub(crate) scene: Scene<'a>,
    /// The path that a plan follows.
    pub(crate) reference_path: &'a ReferencePath,
    /// The state of the controller, with the last plan.
    pub(crate) last: &'a ControllerState,
    /// Time of the start of the plan [ns].
    pub(crate) start_ns: u64,
    /// Largest velocity to plan with [m/s].
    pub(crate) fastest_mps: f64,
}

impl<'a> Task<'a> {
    /// The task of a scan, at the largest velocity of its start.
    pub(crate) fn new(
        scene: Scene<'a>,
        reference_path: &'a ReferencePath,
        last: &'a ControllerState,
        pose: &Pose,
        start: &Start,
    ) -> Self {
        let behind = start.is_reverse.then(|| last.behind(pose, scene.config.seen_for_ns()));
        let scene = Scene { behind, ..scene };
        Self { scene, reference_path, last, start_ns: pose.predicted_ns, fastest_mps: start.limit_mps }
    }

    fn pace(&self) -> Pace {
        let config = self.scene.config;
        Pace {
            cruise: config.cruise_mps.min(self.fastest_mps),
            slowest: config.vehicle.bounds.velocity_min_mps,
            goal_x: config.goal.x_m,
            landing_time: config.landing_time_s.max(LANDING_PERIODS * config.period_s),
        }
    }

    /// Time since the start of the last plan [s], when there is one that may still be used.
    fn elapsed(&self) -> Option<f64> {
        let elapsed_s = self.start_ns.checked_sub(self.last.plan_start_ns)? as f64 * 1e-9;
        let usable = self.last.plan_length >= 2
            && elapsed_s < MAX_REST_S.max(MAX_REST_PERIODS * self.scene.config.period_s)
            && (self.last.plan_interval_s - self.scene.config.interval_s()).abs() < 1e-9;
        usable.then_some(elapsed_s)
    }
}

/// A plan that may be driven; its controls and rollout are in the planner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Choice {
    /// How it was found.
    pub(crate) level: Level,
    /// The evidence that it may be driven.
    pub(crate) verified: Verified,
}

/// The solver with its problem, and the plan of this scan.
#[derive(Debug, Clone)]
pub(crate) struct Planner {
    solver: Solver,
    problem: Problem,
    /// The models of the robot forwards and backwards.
    models: [Arc<Parameters>; 2],
    guess: Trajectory,
    solution: Solution,
    /// Index of the obstacle that each ellipse of the problem belongs to.
    owners: Vec<usize>,
    /// By how much each ellipse is enlarged [m].
    grown: Vec<f64>,
    /// The frames of the nodes.
    frames: Frames,
    /// The obstacle for which a plan was refused last.
    pub(crate) refused_for: Option<usize>,
    /// Whether the plan that was refused last comes to ground that was not seen.
    pub(crate) comes_unseen: bool,
    /// Controls of the plan.
    pub(crate) controls: Vec<Control>,
    /// The trajectory of `controls`.
    pub(crate) rollout: Rollout,
    /// Bad plans of a test.
    #[cfg(test)]
    pub(crate) injection: Injection,
}

impl Planner {
    /// A planner for `config`, which is valid.
    pub(crate) fn new(config: &ControllerConfig) -> Self {
        let parameters = config.vehicle.parameters();
        let models = [parameters, parameters.mirrored()].map(Arc::new);
        let problem = Problem {
            model: models[0].clone(),
            bounds: config.vehicle.bounds,
            x_range: config.track.x_m,
            y_range: config.y_range(),
            intervals: vec![config.interval_s(); config.intervals],
            initial: State::default(),
            previous: None,
            references: Vec::with_capacity(config.intervals),
            control_reference: Control::default(),
            weights: config.weights.over(config.interval_s()),
            ellipses: Vec::with_capacity(config.max_ellipses),
            frames: Vec::new(),
        };
        Self {
            solver: Solver::new(config.solver),
            models,
            problem,
            guess: Trajectory::default(),
            solution: Solution::default(),
            owners: Vec::with_capacity(config.max_ellipses),
            grown: Vec::with_capacity(config.max_ellipses),
            frames: Frames::default(),
            refused_for: None,
            comes_unseen: false,
            controls: Vec::with_capacity(config.intervals),
            rollout: Rollout::default(),
            #[cfg(test)]
            injection: Injection::default(),
        }
    }

    /// Plans for the robot and the direction of travel of `config` from now on.
    pub(crate) fn turn(&mut self, config: &ControllerConfig) {
        let parameters = config.vehicle.parameters();
        if let Some(model) = self.models.iter().find(|model| ***model == parameters) {
            self.problem.model = model.clone();
        }
        self.problem.bounds = config.vehicle.bounds;
        (self.problem.x_range, self.problem.y_range) = (config.track.x_m, config.y_range());
    }

    /// The first plan that may be driven, `None` without one. The figures of the solver go into `command`.
    pub(crate) fn plan(&mut self, task: &Task, budget: &Budget, command: &mut Command) -> Option<Choice> {
        let mut used = 0;
        if let Some(choice) = self.continue_plan(task, budget, &mut used, command) {
            return Some(choice);
        }
        // The reserve of the steering is for this.
        self.problem.bounds.steering_max_rad = task.scene.config.vehicle.bounds.steering_max_rad;
        if let Some(elapsed_s) = task.elapsed()
            && self.start_from_plan(task, elapsed_s)
            && let Some(choice) = self.solve(task, budget, &mut used, command)
        {
            return Some(choice);
        }
        self.start_from_reference(task);
        if let Some(choice) = self.solve(task, budget, &mut used, command) {
            return Some(choice);
        }
        let tight =
            Task { scene: task.scene.keeping(task.scene.margin.used_up(), task.scene.speed), ..*task };
        if let Some(choice) = self.continue_plan(&tight, budget, &mut used, command) {
            return Some(Choice { level: Level::BestIterate, ..choice });
        }
        self.problem.bounds.steering_max_rad = task.scene.config.vehicle.bounds.steering_max_rad;
        self.start_from_reference(task);
        if task.reference_path.clear
            && let Some(choice) = self.verify_guess(task, Level::BestIterate)
        {
            return Some(choice);
        }
        let elapsed_s = task.elapsed()?;
        let interval_s = task.scene.config.interval_s();
        read_plan(task.last, &mut self.controls);
        warm::shift(&self.controls, interval_s, elapsed_s, &mut self.guess.controls);
        let left = self.guess.controls.len().saturating_sub((elapsed_s / interval_s).ceil() as usize);
        self.guess.controls.truncate(left);
        warm::clamp(&self.problem.bounds, &mut self.guess.controls);
        self.verify_guess(task, Level::LastPlan)
    }

    /// A plan out of the way of a body that comes as near as `stopped_m` to a robot that stops.
    pub(crate) fn escape(&mut self, task: &Task, stopped_m: f64) -> Option<Choice> {
        self.refused_for = None;
        let scene = Scene { escapes: true, ..task.scene.keeping(task.scene.margin.none(), task.scene.speed) };
        turn_away(&scene, stopped_m, &mut self.rollout, &mut self.guess.controls)
            .then(|| self.verify_guess(&Task { scene, ..*task }, Level::BestIterate))?
    }

    /// The solution from the last plan, when there is one that passes obstacles on the sides of the reference path.
    pub(crate) fn continue_plan(
        &mut self,
        task: &Task,
        budget: &Budget,
        used: &mut u32,
        command: &mut Command,
    ) -> Option<Choice> {
        self.build_problem(task);
        self.refused_for = None;
        let elapsed_s = task.elapsed()?;
        if !self.start_from_plan(task, elapsed_s) {
            return None;
        }
        self.solve(task, budget, used, command)
    }

    /// Fills the optimal control problem of this scan.
    fn build_problem(&mut self, task: &Task) {
        let Task { scene: Scene { config, predicted, initial, .. }, last, .. } = *task;
        let problem = &mut self.problem;
        problem.initial = initial;
        problem.bounds.velocity_max_mps = config.vehicle.bounds.velocity_max_mps.min(task.fastest_mps);
        problem.bounds.steering_max_rad = STEERING_SHARE * config.vehicle.bounds.steering_max_rad;
        let previous = Control { velocity: last.velocity_mps, steering: last.steering_rad };
        problem.previous = (previous.velocity > 0.0).then_some(previous);
        let is_wide = task.reference_path.limits.is_empty();
        let line = (task.reference_path.clear && is_wide).then_some(config.goal.y_m);
        problem.weights = config.weights.over(config.interval_s());
        // A slow robot is beside an obstacle for longer, and would rather wait there than pay for its offset.
        if task.scene.behind.is_none() {
            let slower = config.cruise_mps.clamp(SLOW_MPS, 1.0).powi(-4);
            problem.weights.node[3] *= slower;
            problem.weights.terminal[3] *= slower;
        }
        // The pace of a path past narrow places need not be kept. Waiting for a body that moves seldom pays.
        let moving = predicted.iter().any(PredictedObstacle::moves).then_some(HASTE);
        if let Some([along, last]) = if line.is_none() { Some(FOLLOWING) } else { moving } {
            problem.weights.node[3] = along * config.interval_s();
            problem.weights.terminal[3] = last;
        }
        problem.control_reference = reference::fill(
            task.reference_path,
            &task.pace(),
            line,
            initial.x,
            config.interval_s(),
            config.intervals,
            &mut problem.references,
        );
        if !config.course.is_line() {
            for reference in &mut problem.references {
                let speed = task.pace().along(task.reference_path, reference.x);
                reference.yaw_rate += config.course.curvature(reference.x) * speed;
            }
        }
        problem.weights.goal = goal_nodes(task).map(|(node, share)| (node, share * config.weights.goal));
        let (speed, cruise) = (task.reference_path.slowest(), task.pace().cruise);
        let margin = |obstacle: &PredictedObstacle, way_m: f64| {
            config.ellipse_margin_m
                + task.scene.margin.growth(if is_wide { way_m / cruise } else { 0.0 }, speed)
                + GROWN_SHARE * grown(&last.ellipses, obstacle.id)
        };
        fill_ellipses(&task.scene, margin, &mut problem.ellipses, &mut self.owners);
        self.grown.clear();
        self.grown.extend(
            self.owners.iter().map(|owner| GROWN_SHARE * grown(&last.ellipses, predicted[*owner].id)),
        );
    }

    /// Makes the last plan, shifted in time, the guess; false when it passes an obstacle on another side than the
    /// reference path.
    fn start_from_plan(&mut self, task: &Task, elapsed_s: f64) -> bool {
        #[cfg(test)]
        self.injection.guess_is(Place::SolutionFromPlan);
        read_plan(task.last, &mut self.controls);
        if self.controls.is_empty() {
            return false;
        }
        // A plan that was cut at the goal continues with its last control.
        self.controls.resize(task.scene.config.intervals, self.controls[self.controls.len() - 1]);
        warm::shift(&self.controls, task.scene.config.interval_s(), elapsed_s, &mut self.guess.controls);
        self.drive_guess(task);
        let (scene, path, guess) = (&task.scene, task.reference_path, &self.rollout.samples);
        warm::agrees(scene, path, guess) && warm::leads(scene, path, guess)
    }

    fn start_from_reference(&mut self, task: &Task) {
        #[cfg(test)]
        self.injection.guess_is(Place::SolutionFromReference);
        let intervals = task.scene.config.intervals;
        warm::follow(&task.scene, task.reference_path, &task.pace(), intervals, &mut self.guess.controls);
        self.drive_guess(task);
    }

    /// Fills the states of the guess by driving its controls.
    fn drive_guess(&mut self, task: &Task) {
        warm::clamp(&self.problem.bounds, &mut self.guess.controls);
        self.rollout.drive(&task.scene, &self.guess.controls);
        self.guess.states.clone_from(&self.rollout.nodes);
        self.frames.place(&task.scene, &self.guess.states, &mut self.problem.frames);
        self.frames.place_ellipses(&task.scene, &self.owners, &mut self.problem.ellipses);
    }

    /// Makes the guess the plan when it may be driven.
    fn verify_guess(&mut self, task: &Task, level: Level) -> Option<Choice> {
        #[cfg(test)]
        self.injection.replace_guess(level, &mut self.guess.controls);
        let verdict = verify(&task.scene, &self.guess.controls, &mut self.rollout);
        self.controls.clone_from(&self.guess.controls);
        self.refused_for = self.refused_for.or(verdict.obstacle());
        self.comes_unseen = verdict.comes_unseen();
        verdict.verified().map(|verified| Choice { level, verified })
    }

    /// Solves from the guess; where the body of the result comes too near to an obstacle, its ellipse is enlarged by what is
    /// missing, and the problem is solved again.
    fn solve(
        &mut self,
        task: &Task,
        budget: &Budget,
        used: &mut u32,
        command: &mut Command,
    ) -> Option<Choice> {
        for _ in 0..=TIGHTENINGS {
            let choice = self.solve_once(task, budget, used, command);
            if choice.is_some() {
                // The next plan keeps a little more than it must, so that noise does not refuse it.
                self.tighten(&task.scene, RESERVE_M);
                return choice;
            }
            if self.refused_for.is_none()
                || self.solution.status == Status::Failed
                || !self.tighten(&task.scene, 0.0)
            {
                return None;
            }
            self.guess.clone_from(&self.solution.trajectory);
        }
        None
    }

    /// Whether the plan gets about as far as its reference.
    pub(crate) fn is_fast(&self) -> bool {
        let (start, end) = (self.problem.initial.x, self.rollout.nodes.last().map_or(0.0, |state| state.x));
        let wanted = self.problem.references.last().map_or(0.0, |state| state.x);
        end - start > FAST_SHARE * (wanted - start)
    }

    /// Number of ellipse constraints that are active in the last solution.
    pub(crate) fn active_ellipses(&self) -> u32 {
        self.solution.active_ellipses
    }

    /// The limits that shape the last solution: its nodes, multipliers, and the obstacle of an ellipse by its place.
    pub(crate) fn active_limits(&self) -> impl Iterator<Item = (ActiveLimit, Option<usize>)> {
        self.solver.active_limits(&self.problem).map(|active| match active.limit {
            Limit::Ellipse(ellipse) => (active, self.owners.get(ellipse).copied()),
            Limit::State(_) => (active, None),
        })
    }

    /// By how much the ellipse of an obstacle was enlarged for this plan [m].
    pub(crate) fn grown(&self, index: usize) -> f64 {
        let ellipse = self.owners.iter().position(|owner| *owner == index);
        ellipse.map_or(0.0, |ellipse| self.grown[ellipse])
    }

    /// Enlarges the ellipses of the bodies that the rollout comes too near to, with `reserve_m` in addition to the margin;
    /// false when there is none.
    fn tighten(&mut self, scene: &Scene, reserve_m: f64) -> bool {
        let baseline = scene.baseline();
        let mut tightened = false;
        for (ellipse, (&owner, grown)) in
            self.problem.ellipses.iter_mut().zip(self.owners.iter().zip(&mut self.grown))
        {
            let short = self
                .rollout
                .samples
                .iter()
                .take_while(|sample| sample.t <= VERIFIED_S)
                .map(|sample| scene.shortfall(&baseline, sample, owner, reserve_m))
                .fold(0.0, f64::max);
            let more = (short + SPARE_M).min(MAX_GROWN_M - *grown);
            if short > 0.0 && more > 0.0 {
                (ellipse.a, ellipse.b) = (ellipse.a + more, ellipse.b + more);
                *grown += more;
                tightened = true;
            }
        }
        tightened
    }

    /// Solves once.
    fn solve_once(
        &mut self,
        task: &Task,
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
        self.solver.solve_into(&self.problem, &self.guess, &rest, &mut self.solution);
        #[cfg(test)]
        self.injection.replace_solution(&mut self.solution);
        let solution = &self.solution;
        *used = used.saturating_add(solution.iterations.max(1));
        report(solution, *used, command);
        self.controls.clone_from(&solution.trajectory.controls);
        let usable = solution.status != Status::Failed
            && self.controls.len() == task.scene.config.intervals
            && self.controls.iter().all(Control::is_finite);
        if !usable {
            return None;
        }
        warm::clamp(&task.scene.bounds(), &mut self.controls);
        slow_down(task, &mut self.controls);
        let scene = &task.scene;
        let verdict = verify(scene, &self.controls, &mut self.rollout);
        let agrees =
            !task.reference_path.clear || warm::agrees(scene, task.reference_path, &self.rollout.samples);
        self.refused_for = self.refused_for.or(verdict.obstacle());
        self.comes_unseen = verdict.comes_unseen();
        let verified = verdict.verified().filter(|_| agrees)?;
        let defect = self.frames.largest_distance(scene, &solution.trajectory.states, &self.rollout.nodes);
        command.largest_violation = command.largest_violation.max(defect);
        let exact = solution.status == Status::Converged && defect < LARGEST_DEFECT_M;
        let level = if exact { Level::Converged } else { Level::BestIterate };
        Some(Choice { level, verified })
    }
}

/// Limits the velocity of each interval to that of the path: the objective only asks for it.
fn slow_down(task: &Task, controls: &mut [Control]) {
    if task.reference_path.limits.is_empty() {
        return;
    }
    let (interval_s, slowest) = (task.scene.config.interval_s(), task.pace().slowest);
    let mut x = task.scene.initial.x;
    for control in controls {
        let limit = task.reference_path.speed_over(x, control.velocity * interval_s);
        control.velocity = control.velocity.min(limit.max(slowest));
        x += control.velocity * interval_s;
    }
}

/// The two nodes between which the plan passes the goal, with the shares of its weight; node 0 for none.
///
/// The last plan tells when, and has no such nodes where it does not get there; without a last plan the reference does.
fn goal_nodes(task: &Task) -> [(usize, f64); 2] {
    let config = task.scene.config;
    let (goal_x, interval_s, intervals) = (config.goal.x_m, config.interval_s(), config.intervals);
    let last = &task.last.plan[..task.last.plan_length as usize];
    let passed = match task.elapsed() {
        Some(elapsed_s) => {
            last.windows(2).position(|pair| (pair[0].x_m..pair[1].x_m).contains(&goal_x)).map(|index| {
                let share = (goal_x - last[index].x_m) / (last[index + 1].x_m - last[index].x_m);
                index as f64 + share - elapsed_s / interval_s
            })
        }
        None => Some((goal_x - task.scene.initial.x) / (task.pace().cruise * interval_s)),
    };
    let Some(along) = passed.filter(|along| (0.0..=intervals as f64).contains(along)) else {
        return [(0, 0.0); 2];
    };
    let (before, share) = (along as usize, along.fract());
    [(before, 1.0 - share), ((before + 1).min(intervals), share)]
}

/// Puts the controls of the last plan into `controls`.
fn read_plan(last: &ControllerState, controls: &mut Vec<Control>) {
    controls.clear();
    let intervals = (last.plan_length as usize).clamp(1, last.plan.len()) - 1;
    let control = |node: &PlanNode| Control { velocity: node.velocity_mps, steering: node.steering_rad };
    controls.extend(last.plan[..intervals].iter().map(control));
}

fn report(solution: &Solution, iterations: u32, command: &mut Command) {
    command.status = wire_status(solution.status);
    command.iterations = iterations;
    command.active_constraints = solution.active_constraints;
    // A failed solve reports infinities, which have no place in a sample.
    let finite = |value: f64| if value.is_finite() { value } else { f64::MAX };
    command.kkt_residual = finite(solution.kkt_residual);
    command.largest_violation = finite(solution.largest_violation);
    command.slack = finite(solution.slack);
    command.objective = finite(solution.objective);
}

fn wire_status(status: Status) -> u32 {
    match status {
        Status::Converged => SolveStatus::Converged,
        Status::MaxIterations => SolveStatus::MaxIterations,
        Status::OutOfTime => SolveStatus::OutOfTime,
        Status::Failed => SolveStatus::Failed,
    }
    .wire()
}
