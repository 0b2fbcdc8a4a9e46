//! The drive with the least J over the same course.
//!
//! # What it is compared with
//! It starts from the state of the first drive command and ends at the same place as the measured part of the drive. It
//! has the model, the bounds, the ellipses and the margin of the controller. Controls change every 0.1 s; nodes, and
//! with them the ellipses, are as far apart.
//!
//! # What it knows
//! What the robot knew: an ellipse counts from the node on at which it was first described in the drive. The optimum may
//! be ahead of the drive or behind it, so that node is the first one that is as late, or as far along the track, as the
//! drive was then. The optimum plans to the end with the ellipses known at the start, follows this plan to the next
//! first sight, plans again from its own state there, and so on. So a body is passed on the side that is best by what is
//! known, and its last description is known from the first sight on.
//!
//! # Sides
//! Each plan is the best of the solutions for all combinations of passing sides, at most 2^5; a moving body is tried at
//! several speeds as well. A solution counts when it has converged with a slack of 1e-6 at most.
//!
//! # The end
//! The time that the optimum takes is a result. Each plan is solved for a duration; the last interval is then lengthened
//! or shortened by the distance that is missing to the end, until none is. This is the least J because arriving later
//! never costs less. Horizons have 200 intervals at most. A plan over a longer way ends earlier, with the weights of the
//! end there, and is renewed when the rest of the way fits: what is known lies a few metres ahead.

use std::fmt;
use std::sync::Arc;

use ocp::{Budget, EllipsePath, Problem, Solver, SolverSettings, Status, Trajectory};
use vehicle::{Bounds, Control, Goal, Parameters, State};

use crate::drive::{Drive, Issued, Moment};
use crate::ellipse::Ellipse;
use crate::guess::{Guess, guess};
use crate::objective::{BEFORE_GOAL_M, CRUISE, INTERVAL_S, SPEED_MPS, weights};
use crate::sides::{bodies, combinations};

/// Maximum number of intervals of the solver.
const MAX_INTERVALS: usize = 200;
/// Largest slack of an ellipse in an accepted solution.
const LARGEST_SLACK: f64 = 1e-6;
/// Largest scaled KKT residual of an accepted solution. Over long horizons the merit has rounding errors that end a solve
/// between this and the tolerance of the solver; the objective is exact to its sixth digit then.
const LARGEST_RESIDUAL: f64 = 1e-3;
/// Weights of the slack that are tried in turn: the first is enough where the penalty is exact with it.
const SLACK_WEIGHTS: [f64; 2] = [500.0, 1e5];
/// Limit of SQP iterations of one solve.
const MAX_ITERATIONS: u32 = 60;
/// Largest distance to the end [m].
const END_M: f64 = 1e-6;
/// Solves in which the end is found.
const MAX_CORRECTIONS: usize = 6;
/// Velocities of the guesses past moving bodies, as shares of the largest.
const SLOWER: [f64; 3] = [1.0, 0.6, 0.3];
/// Maximum number of plans, for a course that leads nowhere.
const MAX_PLANS: usize = 100;

/// What is driven.
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    /// The vehicle.
    pub parameters: Parameters,
    /// Hard bounds of the controls and soft bounds of the lateral state.
    pub bounds: Bounds,
    /// Bounds of the position along the track [m].
    pub x_range: [f64; 2],
    /// Bounds of the lateral position [m].
    pub y_range: [f64; 2],
    /// The goal; its lateral position is the line.
    pub goal: Goal,
    /// When the first drive command acts [s].
    pub start_s: f64,
    /// The state then.
    pub start: State,
    /// The ellipses, with their margin.
    pub ellipses: Vec<Ellipse>,
}

impl Course {
    /// Where the measured part of the drive ends [m].
    pub fn end_x_m(&self) -> f64 {
        self.goal.x_m - BEFORE_GOAL_M
    }
}

/// Where a plan starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct From {
    pub(crate) time_s: f64,
    pub(crate) state: State,
    pub(crate) previous: Option<Control>,
}

/// A problem with its best solution.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The problem.
    pub problem: Problem,
    /// Its solution.
    pub trajectory: Trajectory,
    /// The objective of the solution.
    pub objective: f64,
    /// Whether it reaches the end.
    is_whole: bool,
}

/// The optimum of a course.
#[derive(Debug, Clone)]
pub struct Optimum {
    /// What is driven; clearances are not known here.
    pub drive: Drive,
    /// The plans, in the order in which they were followed.
    pub plans: Vec<Plan>,
}

/// Why there is no optimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoOptimum {
    /// How many combinations of sides were tried in the plan that failed.
    pub combinations: usize,
}

impl fmt::Display for NoOptimum {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "no optimum: none of {} combinations of sides has a solution", self.combinations)
    }
}

/// The optimum of a course.
///
/// # Errors
/// [`NoOptimum`] when there is no solution without slack from some state on.
pub fn optimum(course: &Course) -> Result<Optimum, NoOptimum> {
    let settings = SolverSettings { max_iterations: MAX_ITERATIONS, ..SolverSettings::default() };
    let mut solver = Solver::new(settings);
    let mut from = From { time_s: course.start_s, state: course.start, previous: None };
    let mut optimum = Optimum { drive: Drive::default(), plans: Vec::new() };
    optimum.drive.moments.push(moment(from.time_s, from.state, 0.0));
    while optimum.plans.len() < MAX_PLANS {
        let known = known(course, &from);
        let plan = best_plan(&mut solver, course, &from, &known)?;
        let followed = follow(course, &from, &known, &plan, &mut optimum.drive);
        optimum.plans.push(plan);
        let Some(next) = followed else { return Ok(optimum) };
        from = next;
    }
    Err(NoOptimum { combinations: 0 })
}

/// The ellipses that are known, without standing ones that are behind.
fn known<'a>(course: &'a Course, from: &From) -> Vec<&'a Ellipse> {
    let State { x, .. } = from.state;
    let counts = |ellipse: &&Ellipse| {
        let ahead = ellipse.moves() || ellipse.centre_at(from.time_s)[0] + ellipse.a > x;
        ellipse.is_known(from.time_s, x) && ahead
    };
    course.ellipses.iter().filter(counts).collect()
}

/// Follows a plan until an ellipse is seen that it does not know, or to its end; the start of the next plan.
fn follow(course: &Course, from: &From, known: &[&Ellipse], plan: &Plan, drive: &mut Drive) -> Option<From> {
    let Trajectory { states, controls } = &plan.trajectory;
    let intervals = &plan.problem.intervals;
    // A plan that ends before the course is renewed after the time that it was too short, five seconds at most.
    let renewed = if plan.is_whole { usize::MAX } else { 50 };
    let mut time_s = from.time_s;
    for (index, (control, state)) in controls.iter().zip(&states[1..]).enumerate() {
        drive.commands.push(Issued { time_s, control: *control });
        time_s += intervals[index];
        drive.moments.push(moment(time_s, *state, control.velocity));
        let is_new = |ellipse: &Ellipse| {
            ellipse.is_known(time_s, state.x)
                && !ellipse.is_known(from.time_s, from.state.x)
                && !known.contains(&ellipse)
        };
        let rest = index + 1 < controls.len();
        if rest && (course.ellipses.iter().any(is_new) || index + 1 >= renewed) {
            return Some(From { time_s, state: *state, previous: Some(*control) });
        }
    }
    None
}

fn moment(time_s: f64, state: State, speed_mps: f64) -> Moment {
    Moment { time_s, state, speed_mps, clearance_m: f64::INFINITY }
}

/// The best plan over all combinations of sides.
fn best_plan(
    solver: &mut Solver,
    course: &Course,
    from: &From,
    known: &[&Ellipse],
) -> Result<Plan, NoOptimum> {
    let bodies = bodies(known, from.time_s, [from.state.x, from.state.y], course.goal.y_m);
    let all = combinations(&bodies);
    let speeds = if known.iter().any(|ellipse| ellipse.moves()) { &SLOWER[..] } else { &SLOWER[..1] };
    let mut best: Option<Plan> = None;
    for sides in &all {
        for share in speeds {
            let speed = (course.bounds.velocity_max_mps * share).max(course.bounds.velocity_min_mps);
            let Some(guess) = guess(course, from, &bodies, sides, speed) else { continue };
            let plan = solve(solver, course, from, known, &guess);
            let better = |plan: &Plan| best.as_ref().is_none_or(|best| plan.objective < best.objective);
            best = plan.filter(better).or(best);
        }
    }
    best.ok_or(NoOptimum { combinations: all.len() })
}

/// The solution from a guess, with the duration that ends the course; `None` when it does not keep the ellipses.
fn solve(
    solver: &mut Solver,
    course: &Course,
    from: &From,
    known: &[&Ellipse],
    guess: &Guess,
) -> Option<Plan> {
    let mut trajectory = Trajectory { states: Vec::new(), controls: guess.controls.clone() };
    let longest = (MAX_INTERVALS as f64 - 0.5) * INTERVAL_S;
    let mut duration = guess.duration_s;
    for &slack in &SLACK_WEIGHTS {
        for _ in 0..MAX_CORRECTIONS {
            let is_whole = duration < longest;
            let problem = problem(course, from, known, duration.min(longest), slack);
            trajectory.states.clear();
            trajectory.controls.resize(problem.intervals.len(), CRUISE);
            let solution = solver.solve(&problem, &trajectory, &Budget::Iterations(MAX_ITERATIONS));
            if solution.status == Status::Failed {
                return None;
            }
            trajectory = solution.trajectory;
            let end = trajectory.states.last()?;
            let missing = course.end_x_m() - end.x;
            let kept = solution.slack <= LARGEST_SLACK && solution.kkt_residual <= LARGEST_RESIDUAL;
            if !is_whole || missing.abs() <= END_M {
                if kept {
                    let objective = solution.objective;
                    return Some(Plan { problem, trajectory, objective, is_whole });
                }
                break;
            }
            let speed = trajectory.controls.last()?.velocity * (end.yaw + end.sideslip).cos();
            duration += missing / speed.max(0.1);
        }
    }
    None
}

/// Intervals of [`INTERVAL_S`], the last one between half and one and a half of it.
fn intervals(duration: f64) -> Vec<f64> {
    let count = ((duration / INTERVAL_S).round() as usize).clamp(1, MAX_INTERVALS);
    let mut intervals = vec![INTERVAL_S; count];
    intervals[count - 1] = (duration - (count - 1) as f64 * INTERVAL_S).max(0.05 * INTERVAL_S);
    intervals
}

/// The problem from a state over a duration.
fn problem(course: &Course, from: &From, known: &[&Ellipse], duration: f64, slack: f64) -> Problem {
    let intervals = intervals(duration);
    let last_s = intervals[intervals.len() - 1];
    let ends = intervals.iter().scan(from.time_s, |time_s, interval| {
        *time_s += interval;
        Some(*time_s)
    });
    let times: Vec<f64> = std::iter::once(from.time_s).chain(ends).collect();
    let reference = |time_s: &f64| State {
        x: course.start.x + SPEED_MPS * (time_s - course.start_s),
        y: course.goal.y_m,
        ..State::default()
    };
    let path = |ellipse: &&Ellipse| EllipsePath {
        a: ellipse.a,
        b: ellipse.b,
        centres: times.iter().map(|time_s| ellipse.centre_at(*time_s)).collect(),
    };
    Problem {
        model: Arc::new(course.parameters),
        bounds: course.bounds,
        x_range: course.x_range,
        y_range: course.y_range,
        initial: from.state,
        previous: from.previous,
        references: times[1..].iter().map(reference).collect(),
        control_reference: CRUISE,
        weights: weights(last_s, slack),
        ellipses: known.iter().map(path).collect(),
        intervals,
    }
}
