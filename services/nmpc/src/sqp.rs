//! Sequential quadratic programming on the multiple-shooting program of one scan.
//!
//! Each iteration linearises the intervals, condenses, solves one quadratic program and searches along its step with
//! the exact merit function `objective + penalties + rho * |defects|`. The search compares with the largest of the last
//! few merit values, so that a good full step is not cut because of the curvature of the model (Maratos effect). Where
//! no step length is accepted, the program is solved again with damping.
//!
//! Assumptions and limits: the reference lies within what the horizon can reach (else the model is linearised far from
//! where the step leads, and the search needs many iterations); with an active ellipse convergence is linear, because
//! the Gauss-Newton Hessian lacks its curvature. The solution is a local one: the guess decides the side on which an
//! obstacle is passed. A guess in the very centre of an ellipse has no direction to leave it.
//!
//! [`Solver::solve`] is a function of its arguments: buffers are kept between calls, values are not. A solver that was
//! just made gives the same bits as one that has run for hours.

use serde::{Deserialize, Serialize};
use shared_types::SolveStatus;
use vehicle::{Control, Invalid, State, require};

use crate::collocation::{Collocation, Scheme};
use crate::condense::{Multipliers, add_second_order, condense, row_excess};
use crate::kkt;
use crate::objective::{linearised_penalties, penalties, smooth, smooth_along};
use crate::problem::{Budget, Problem, Solution, Trajectory};
use crate::newton::Newton;
use crate::qp::{Qp, QpChoice, QpSolution, RowState, clarabel};
use crate::shooting::{Iterate, Shooting, Sweep};

/// The largest number of intervals.
pub const MAX_INTERVALS: usize = 200;

/// How the nonlinear program is solved.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SolverSettings {
    /// Collocation inside the intervals.
    pub scheme: Scheme,
    /// Solver of the quadratic programs.
    pub qp: QpChoice,
    /// Converged when the scaled KKT residual is at most this, 1e-10 to 1e-2.
    pub tolerance: f64,
    /// SQP iterations at most, 1 to 1000.
    pub max_iterations: u32,
}

impl Default for SolverSettings {
    fn default() -> Self {
        Self { scheme: Scheme::default(), qp: QpChoice::default(), tolerance: 1e-6, max_iterations: 60 }
    }
}

impl SolverSettings {
    /// Checks every number.
    ///
    /// # Errors
    /// [`Invalid`] names key, value and range.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("tolerance", self.tolerance, 1e-10..=1e-2)?;
        require("max_iterations", f64::from(self.max_iterations), 1.0..=1000.0)
    }
}

/// A solver with its buffers.
#[derive(Debug, Clone)]
pub struct Solver {
    settings: SolverSettings,
    collocation: Collocation,
    iterate: Iterate,
    trial: Iterate,
    step: Iterate,
    shooting: Shooting,
    trial_shooting: Shooting,
    qp: Qp,
    answer: QpSolution,
    row_multipliers: Vec<f64>,
    gradient: Vec<f64>,
    costates: Vec<[f64; 5]>,
    newton: Newton,
    recent: Vec<f64>,
}

/// How many accepted iterates a new one is compared with.
const MEMORY: usize = 1;
/// Share of the predicted decrease that is asked for.
const SUFFICIENT: f64 = 1e-4;
/// Step lengths tried before the program is damped: 1, 1/2, ... 1/128.
const HALVINGS: u32 = 3;
/// Damping of the first repetition, against Hessian entries of 1 to 1000.
const FIRST_DAMPING: f64 = 1e-1;
/// Damping beyond which a step is shorter than the tolerance, so that repeating is pointless.
const LARGEST_DAMPING: f64 = 1e10;

impl Solver {
    /// A solver with `settings`.
    pub fn new(settings: SolverSettings) -> Self {
        Self {
            settings,
            collocation: Collocation::new(settings.scheme),
            iterate: Iterate::default(),
            trial: Iterate::default(),
            step: Iterate::default(),
            shooting: Shooting::default(),
            trial_shooting: Shooting::default(),
            qp: Qp::default(),
            answer: QpSolution::default(),
            row_multipliers: Vec::new(),
            gradient: Vec::new(),
            costates: Vec::new(),
            newton: Newton::default(),
            recent: Vec::with_capacity(MEMORY),
        }
    }

    /// The settings it was made with.
    pub fn settings(&self) -> &SolverSettings {
        &self.settings
    }

    /// The collocation it uses.
    pub fn collocation(&self) -> &Collocation {
        &self.collocation
    }

    /// Solves `problem` from `guess`, with the measured state in the place of the guess's first.
    ///
    /// Input that is not finite or contradicts itself gives [`SolveStatus::Failed`] and the guess itself.
    pub fn solve(&mut self, problem: &Problem, guess: &Trajectory, budget: &Budget) -> Solution {
        if !is_usable(problem, guess) {
            return Solution {
                trajectory: guess.clone(),
                status: SolveStatus::Failed,
                iterations: 0,
                kkt_residual: f64::INFINITY,
                largest_violation: f64::INFINITY,
                slack: f64::INFINITY,
                objective: f64::INFINITY,
                active_constraints: 0,
            };
        }
        let sweep = self.iterate.start(problem, guess);
        self.row_multipliers.clear();
        self.row_multipliers.resize((5 + problem.ellipses.len()) * problem.intervals.len(), 0.0);
        self.answer.bound_multipliers.clear();
        self.recent.clear();

        let mut iterations = 0;
        let mut damping = 0.0;
        let mut usable = self.shooting.sweep(problem, &self.collocation, &mut self.iterate, sweep);
        let (status, kkt_residual) = loop {
            if !usable {
                break (SolveStatus::Failed, f64::INFINITY);
            }
            let residual =
                kkt::residual(problem, &self.iterate, &self.shooting, &self.row_multipliers, &mut self.gradient);
            if std::env::var_os("TRACE").is_some() { eprintln!("it {iterations} kkt {residual:.3e} defect {:.2e} u {:.4?}", self.shooting.defect, self.iterate.controls); }
            if !residual.is_finite() {
                break (SolveStatus::Failed, f64::INFINITY);
            }
            if residual <= self.settings.tolerance {
                break (SolveStatus::Converged, residual);
            }
            if iterations >= self.settings.max_iterations {
                break (SolveStatus::MaxIterations, residual);
            }
            if !budget.allows(iterations) {
                break match budget {
                    Budget::Deadline { .. } => (SolveStatus::OutOfTime, residual),
                    Budget::Iterations(_) => (SolveStatus::MaxIterations, residual),
                };
            }
            iterations += 1;
            usable = self.advance(problem, &mut damping);
        };
        self.report(problem, status, iterations, kkt_residual)
    }

    /// One iteration from the present linearisation; false where no step could be computed.
    fn advance(&mut self, problem: &Problem, damping: &mut f64) -> bool {
        let relieved = penalties(problem, &self.iterate).0;
        let present = smooth(problem, &self.iterate) + relieved;
        // The merit of an iterate with gaps says nothing: the first one without is accepted as it comes.
        let closed = self.shooting.gaps.iter().flatten().all(|&gap| gap == 0.0);
        if self.recent.len() == MEMORY {
            self.recent.remove(0);
        }
        if closed {
            self.recent.push(present);
        }
        loop {
            condense(problem, &self.iterate, &self.shooting, *damping, &mut self.qp);
            if clarabel::solve(&self.qp, &mut self.answer) {
                if closed && self.try_newton(problem, relieved) {
                    *damping = if *damping <= FIRST_DAMPING { 0.0 } else { *damping / 10.0 };
                    return true;
                }
                let predicted = self.predict(problem, relieved, false);
                if std::env::var_os("TRACE").is_some() { eprintln!("  step {:.3?}", self.answer.step);
                   for row in 0..self.qp.row_count() { let g = self.qp.row_upper[row]; let v = crate::qp::dot(self.qp.row(row), &self.answer.step); if self.answer.row_multipliers[row] != 0.0 && self.answer.row_multipliers[row].abs() > 1e-7 { eprintln!("  row {row} {:?} excess {:.3e} after {:.3e} lambda {:.3}", self.answer.row_states[row], -g, v-g, self.answer.row_multipliers[row]); } } }
                if let Some(fraction) = self.search(problem, closed, predicted, HALVINGS) {
                    self.row_multipliers.clone_from(&self.answer.row_multipliers);
                    if fraction == 1.0 {
                    *damping = if *damping <= FIRST_DAMPING { 0.0 } else { *damping / 10.0 };
                    } else if fraction < 0.5 {
                    *damping = (*damping * 10.0).max(FIRST_DAMPING);
                    }
                    return true;
                }
            }
            if *damping > LARGEST_DAMPING {
                return false;
            }
            *damping = (*damping * 10.0).max(FIRST_DAMPING);
        }
    }

    /// Expands the step of the quadratic program, or Newton's, and predicts the change of the merit to first order.
    fn predict(&mut self, problem: &Problem, relieved: f64, newton: bool) -> f64 {
        let controls = if newton { &self.newton.solution.step } else { &self.answer.step };
        self.step.controls.clear();
        self.step.controls.extend(controls.chunks_exact(2).map(|pair| [pair[0], pair[1]]));
        self.shooting.expand(&mut self.step);
        let (slope, _) = smooth_along(problem, &self.iterate, &self.step);
        slope + linearised_penalties(problem, &self.iterate, &self.step) - relieved
    }

    /// Newton's step on the active set of the quadratic program, where there is one that is accepted in full.
    fn try_newton(&mut self, problem: &Problem, relieved: f64) -> bool {
        let rows = &self.answer.row_multipliers;
        kkt::costates(problem, &self.iterate, &self.shooting, rows, &mut self.costates);
        self.newton.hessian.clone_from(&self.qp.hessian);
        add_second_order(
            problem,
            &self.collocation,
            &self.iterate,
            &self.shooting,
            Multipliers { costates: &self.costates, rows },
            &self.qp.rows,
            &mut self.newton.hessian,
        );
        if !self.newton.solve(&self.qp, &self.answer) {
            return false;
        }
        let predicted = self.predict(problem, relieved, true);
        if predicted > 0.0 { return false; }
        let mut accepted = self.search(problem, true, predicted, 1).is_some();
        if !accepted && !self.newton.equations().is_empty() {
            self.gradient.clear();
            for &row in self.newton.equations() {
                let upper = self.answer.row_states[row] == RowState::AtUpper;
                self.gradient.push(row_excess(problem, &self.trial, row, upper));
            }
            if self.newton.correct(&self.qp, &self.gradient) {
                self.predict(problem, relieved, true);
                accepted = self.search(problem, true, predicted, 1).is_some();
        if std::env::var_os("TRACE").is_some() { eprintln!("  corrected {accepted}"); }
            }
        }
        if accepted {
            self.row_multipliers.clone_from(&self.newton.solution.row_multipliers);
        }
        if std::env::var_os("TRACE").is_some() { eprintln!("  newton {accepted}"); }
        accepted
    }

    /// Tries 1, 1/2, ... of the step; an accepted one is the new iterate, with its linearisation.
    fn search(&mut self, problem: &Problem, closed: bool, predicted: f64, attempts: u32) -> Option<f64> {
        let reference = self.recent.iter().copied().fold(f64::MIN, f64::max);
        // Near the solution differences of the merit are rounding errors.
        let rounding = 1e-13 * (1.0 + reference.abs());
        let mut fraction = 1.0;
        for _ in 0..attempts {
            self.trial.move_from(&self.iterate, &self.step, fraction);
            for control in &mut self.trial.controls {
                // Removes what rounding has put outside the bounds.
                let inside = problem.bounds.clamp(Control { velocity: control[0], steering: control[1] });
                *control = [inside.velocity, inside.steering];
            }
            if self.trial_shooting.sweep(problem, &self.collocation, &mut self.trial, Sweep::Close) {
                if std::env::var_os("TRACE").is_some() { for node in 1..=6 { for (e, el) in problem.ellipses.iter().enumerate() { eprint!(" [{node} {e}] {:.4}", crate::objective::ellipse_excess(el, node, &self.trial.states[node]).0); } } eprintln!(); }
                let merit = smooth(problem, &self.trial) + penalties(problem, &self.trial).0;
                if std::env::var_os("TRACE").is_some() { eprintln!("  f {fraction:.4} ref {reference:.8} trial {merit:.8} predicted {predicted:.3e}"); }
                let wanted = reference + SUFFICIENT * fraction * predicted.min(0.0) + rounding;
                if merit <= wanted || (!closed && merit.is_finite()) {
                    std::mem::swap(&mut self.iterate, &mut self.trial);
                    std::mem::swap(&mut self.shooting, &mut self.trial_shooting);
                    return Some(fraction);
                }
            }
            fraction *= 0.5;
        }
        None
    }

    fn report(&self, problem: &Problem, status: SolveStatus, iterations: u32, kkt_residual: f64) -> Solution {
        /// Multipliers below this share of the linear slack weight do not count as active.
        const ACTIVE: f64 = 1e-8;
        let (penalty, slack) = penalties(problem, &self.iterate);
        let small = ACTIVE * problem.weights.slack_linear.max(1.0);
        let active =
            self.row_multipliers.iter().chain(&self.answer.bound_multipliers).filter(|value| value.abs() > small);
        Solution {
            trajectory: Trajectory {
                states: self.iterate.states.iter().map(|state| State::from_vector(&(*state).into())).collect(),
                controls: self
                    .iterate
                    .controls
                    .iter()
                    .map(|control| Control { velocity: control[0], steering: control[1] })
                    .collect(),
            },
            status,
            iterations,
            kkt_residual,
            largest_violation: self.shooting.defect,
            slack,
            objective: smooth(problem, &self.iterate) + penalty,
            active_constraints: active.count() as u32,
        }
    }
}

/// Whether everything is finite, of fitting length and in order.
fn is_usable(problem: &Problem, guess: &Trajectory) -> bool {
    let count = problem.intervals.len();
    let parameters = &problem.parameters;
    let bounds = &problem.bounds;
    let weights = &problem.weights;
    let positive = |value: f64| value > 0.0 && value.is_finite();
    let natural = |value: f64| value >= 0.0 && value.is_finite();
    (1..=MAX_INTERVALS).contains(&count)
        && problem.intervals.iter().all(|&length| positive(length))
        && [parameters.mass_kg, parameters.stiffness_n_per_rad, parameters.inertia_kgm2].into_iter().all(positive)
        && [parameters.rear_m, parameters.front_m].into_iter().all(positive)
        && positive(bounds.velocity_min_mps)
        && bounds.velocity_max_mps.is_finite()
        && bounds.velocity_max_mps >= bounds.velocity_min_mps
        // The model divides by the tangent's range: steering stays below a right angle.
        && natural(bounds.steering_max_rad)
        && bounds.steering_max_rad < 1.5
        && bounds.sideslip_max_rad >= 0.0
        && bounds.yaw_max_rad >= 0.0
        && bounds.yaw_rate_max_radps >= 0.0
        && problem.x_range[0] <= problem.x_range[1]
        && problem.y_range[0] <= problem.y_range[1]
        && problem.initial.is_finite()
        && problem.previous.is_none_or(|control| control.is_finite())
        && problem.references.len() == count
        && problem.references.iter().all(State::is_finite)
        && problem.control_reference.is_finite()
        && weights.node.iter().chain(&weights.terminal).all(|&weight| natural(weight))
        && weights.control.iter().chain(&weights.change).all(|&weight| natural(weight))
        && natural(weights.slack_linear)
        && natural(weights.slack_quadratic)
        && problem.ellipses.iter().all(|ellipse| {
            positive(ellipse.a)
                && positive(ellipse.b)
                && ellipse.centres.len() == count + 1
                && ellipse.centres.iter().flatten().all(|value| value.is_finite())
        })
        && guess.states.iter().all(State::is_finite)
        && guess.controls.iter().all(Control::is_finite)
}
