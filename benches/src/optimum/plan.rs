//! One plan of the optimum: the best solution over all combinations of passing sides.

use std::fmt;
use std::sync::Arc;

use ocp::{Budget, EllipsePath, Problem, Solver, SolverSettings, Status, Trajectory, Weights};
use vehicle::State;

use super::course::{Course, From};
use super::ellipse::Ellipse;
use super::guess::{Guess, guess};
use super::sides::{Sides, bodies, combinations};
use report::ride::objective::{CHANGE, CONTROL, CRUISE, INTERVAL_S, SPEED_MPS, STATE, TERMINAL};

/// Maximum number of intervals of the solver.
const MAX_INTERVALS: usize = 200;
/// Largest slack of an ellipse in an accepted solution.
const LARGEST_SLACK: f64 = 1e-6;
/// Largest scaled KKT residual of an accepted solution. Over long horizons the merit has rounding errors that end a
/// solve between this and the tolerance of the solver; the objective is exact to its sixth digit then.
const LARGEST_RESIDUAL: f64 = 1e-3;
/// Weights of the slack that are tried in turn: the first is enough where the penalty is exact with it.
const SLACK_WEIGHTS: [f64; 2] = [500.0, 1e5];
/// Limit of SQP iterations of one solve.
const MAX_ITERATIONS: u32 = 60;
/// Largest distance to the end [m].
const END_M: f64 = 1e-6;
/// Objectives of two problems in a row that differ by less than this share belong to the same solution.
const SAME_OBJECTIVE: f64 = 1e-4;
/// Solves in which the end is found.
const MAX_CORRECTIONS: usize = 6;
/// Velocities of the guesses past moving bodies, as shares of the largest.
const SLOWER: [f64; 3] = [1.0, 0.6, 0.3];
/// A problem with its best solution.
#[derive(Debug, Clone)]
pub(crate) struct Plan {
    /// The problem.
    pub problem: Problem,
    /// Its solution.
    pub trajectory: Trajectory,
    /// The objective of the solution.
    pub objective: f64,
    /// Whether it reaches the end.
    pub(crate) is_whole: bool,
}

/// Why there is no optimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct NoOptimum {
    /// How many combinations of sides were tried in the plan that failed.
    pub combinations: usize,
}

impl fmt::Display for NoOptimum {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "no optimum: none of {} combinations of sides has a solution", self.combinations)
    }
}

/// The solver of all plans.
pub(crate) fn solver() -> Solver {
    Solver::new(SolverSettings { max_iterations: MAX_ITERATIONS, ..SolverSettings::default() })
}

/// The best plan over all combinations of sides.
pub(crate) fn best_plan(
    solver: &mut Solver,
    course: &Course,
    from: &From,
    known: &[&Ellipse],
    tried: Sides,
) -> Result<Plan, NoOptimum> {
    let bodies = bodies(known, from.time_s, [from.state.x, from.state.y], course.goal.y_m, tried);
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
    let mut solved_before = None;
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
            // From the solution of a problem that differs by less than a millimetre no step may be found.
            let same = |before: f64| (solution.objective - before).abs() <= SAME_OBJECTIVE * before.abs();
            let solved = solution.kkt_residual <= LARGEST_RESIDUAL || solved_before.is_some_and(same);
            let kept = solution.slack <= LARGEST_SLACK && solved;
            solved_before = solved.then_some(solution.objective);
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
        frames: Vec::new(),
        intervals,
    }
}

/// The weights of J for a problem with intervals of [`INTERVAL_S`], the last of which has the length `last_s`.
///
/// The trapezoidal rule counts half of the last interval at the last node. The other half belongs to the node before
/// it, where a problem has the weights of all inner nodes: J is exact when both lengths are equal, and almost exact
/// else.
fn weights(last_s: f64, slack: f64) -> Weights {
    let terminal = std::array::from_fn(|index| TERMINAL[index] + STATE[index] * last_s / 2.0);
    Weights {
        node: STATE.map(|weight| weight * INTERVAL_S),
        terminal,
        control: CONTROL.map(|weight| weight * INTERVAL_S),
        change: CHANGE,
        slack_linear: slack,
        slack_quadratic: slack,
        goal: [(0, 0.0); 2],
    }
}
