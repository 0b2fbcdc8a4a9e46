//! Sequential quadratic programming on the multiple-shooting program of one scan.
//!
//! One iteration: linearise the intervals, solve the convex quadratic program with the chosen Hessian
//! (Gauss-Newton unless the settings say otherwise); then, unless `refine` is off, try Newton's step on the active
//! set it found, and where that is refused the program's own step, searched along. A trial gets its node states by a
//! forward sweep, so every iterate after the first satisfies the model and the exact penalty function `objective +
//! penalties` alone decides. A guess whose node states leave gaps is linearised as it is (that is what multiple
//! shooting is for), and its step competes with the roll-out of the guess's controls.
//!
//! The quadratic program finds the active set from any guess. Newton's step makes the convergence quadratic; with an
//! active ellipse the Gauss-Newton step alone needs tens of iterations or never converges. Its second-order
//! correction prevents refusals because of the large penalty (Maratos effect). The damping shortens steps where
//! limits are nearly dependent and cross beyond the validity of the linearisation.
//!
//! Both steps are solved stage by stage ([`crate::chain`]), in time linear in the number of intervals. Only where the
//! search for the active set fails, a horizon of at most `condense_up_to` intervals is condensed.
//!
//! Limits: the solution is local, and the guess decides on which side an obstacle is passed. A guess in the exact
//! centre of an ellipse has no direction to leave it. A reference far beyond what the horizon can reach makes the
//! problem badly scaled: clip it.
//!
//! [`Solver::solve`] is a function of its arguments: buffers are kept between calls, values are not. A solver that was
//! just made gives the same bits as one that has run for hours.

mod feedback;
mod program;

use vehicle::{Control, State};

use crate::chain::Chain;
use crate::collocation::Collocation;
use crate::dense::{fill, refill};
use crate::hessian::{self, Block, Hessian, Point};
use crate::kkt::{self, Multipliers};
use crate::objective::{control_bounds, linearised_penalties, penalties, smooth, smooth_slope};
use crate::problem::{ActiveLimit, Budget, Problem, Solution, Status, Trajectory};
use crate::qp::active_set::dense::DenseActiveSet;
use crate::qp::{BoundState, Qp, QpSolution, RowState};
use crate::rows::{ellipse_row, limit_of_row};
use crate::settings::SolverSettings;
use crate::shooting::{Iterate, Shooting, Sweep};
use crate::usable::is_usable;

/// Share of the predicted decrease that is asked for (Armijo).
const ARMIJO: f64 = 1e-4;
/// Step lengths tried before the program is damped: 1, 1/2 and 1/4. After these another direction is better.
const ATTEMPTS: u32 = 3;
/// First damping, in units of the objective per square of a control's range; the curvature of the objective is 1 to
/// 100.
const FIRST_DAMPING: f64 = 0.1;
/// Damping at which a step is shorter than the tolerance, so that the solve ends.
const MAX_DAMPING: f64 = 1e10;
/// Gaps up to this are always closed by a sweep: the guess is a roll-out up to rounding or Newton's tolerance.
const SMALL_GAP: f64 = 1e-6;

/// A solver with its buffers.
#[derive(Debug, Clone, Default)]
pub struct Solver {
    settings: SolverSettings,
    collocation: Collocation,
    iterate: Iterate,
    trial: Iterate,
    step: Iterate,
    shooting: Shooting,
    trial_shooting: Shooting,
    qp: Qp,
    chain: Chain,
    active_set: DenseActiveSet,
    answer: QpSolution,
    /// Newton's step and its multipliers.
    newton: QpSolution,
    /// Whether the last call was [`Solver::prepare`].
    is_prepared: bool,
    row_multipliers: Vec<f64>,
    costates: Vec<[f64; 5]>,
    /// The BFGS matrices of the nodes.
    blocks: Vec<Block>,
    /// Exact second derivatives of the nodes.
    exact: Vec<Block>,
    buffer: Vec<f64>,
    fallbacks: u64,
    /// Iterations in a row without a Newton step.
    refusals: u32,
}

/// The two kinds of step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// That of the quadratic program.
    Program,
    /// Newton's on its active set.
    Newton,
}

impl Solver {
    /// A solver with `settings`.
    pub fn new(settings: SolverSettings) -> Self {
        Self { settings, collocation: Collocation::new(settings.scheme), ..Self::default() }
    }

    /// The settings it was made with.
    pub fn settings(&self) -> &SolverSettings {
        &self.settings
    }

    /// How many quadratic programs the active set could not solve, so that the interior-point method did.
    pub fn fallbacks(&self) -> u64 {
        self.fallbacks
    }

    /// The soft limits with a multiplier in the last solution, which was that of `problem`.
    pub fn active_limits(&self, problem: &Problem) -> impl Iterator<Item = ActiveLimit> {
        let (count, ellipses) = (problem.intervals.len(), problem.ellipses.len());
        let is_of_problem = self.row_multipliers.len() == (5 + ellipses) * count;
        let rows =
            self.row_multipliers.iter().enumerate().filter(move |(_, value)| is_of_problem && **value != 0.0);
        rows.map(move |(row, value)| {
            let (node, limit) = limit_of_row(count, ellipses, row);
            ActiveLimit { node, limit, multiplier: value.abs() }
        })
    }

    /// Solves `problem` from `guess`, with the measured state in the place of the guess's first.
    ///
    /// A guess without states, or with a wrong number of them, stands for the roll-out of its controls; missing
    /// controls are filled with the last, or with the reference. Input that is not finite or contradicts itself gives
    /// [`Status::Failed`] and the guess itself. A solve that ends early gives its best iterate, which satisfies the
    /// model and the bounds of the controls as soon as one iteration was made.
    pub fn solve(&mut self, problem: &Problem, guess: &Trajectory, budget: &Budget) -> Solution {
        let mut solution = Solution::default();
        self.solve_into(problem, guess, budget, &mut solution);
        solution
    }

    /// As [`Solver::solve`], into a solution whose memory is used again.
    ///
    /// From the second solve of a size on nothing is allocated, unless the interior-point method is called.
    pub fn solve_into(
        &mut self,
        problem: &Problem,
        guess: &Trajectory,
        budget: &Budget,
        solution: &mut Solution,
    ) {
        self.is_prepared = false;
        if is_usable(problem, guess) && self.start(problem, guess) {
            let (status, iterations, kkt_residual) = self.iterate(problem, budget);
            self.report(problem, status, iterations, kkt_residual, solution);
        } else {
            refuse(guess, solution);
        }
    }

    /// Iterates to the end: how it ended, after how many iterations, and the scaled KKT residual.
    fn iterate(&mut self, problem: &Problem, budget: &Budget) -> (Status, u32, f64) {
        let mut iterations = 0;
        let mut damping = 0.0;
        self.refusals = 0;
        let (status, kkt_residual) = loop {
            let residual = kkt::residual(
                problem,
                &self.iterate,
                &self.shooting,
                &self.row_multipliers,
                &mut self.buffer,
            );
            if !residual.is_finite() {
                break (Status::Failed, f64::INFINITY);
            }
            if residual <= self.settings.tolerance {
                break (Status::Converged, residual);
            }
            if iterations >= self.settings.max_iterations {
                break (Status::MaxIterations, residual);
            }
            if !budget.allows(iterations) {
                break match budget {
                    Budget::Deadline { .. } => (Status::OutOfTime, residual),
                    Budget::Iterations(_) => (Status::MaxIterations, residual),
                };
            }
            iterations += 1;
            if self.is_closed() {
                if !self.advance(problem, &mut damping) {
                    // The iterate satisfies the model, but no step improves it.
                    break (Status::MaxIterations, residual);
                }
            } else if !self.close_gaps(problem) {
                break (Status::Failed, residual);
            }
        };
        (status, iterations, kkt_residual)
    }

    /// Starts from the guess; false where its collocation equations have no solution.
    fn start(&mut self, problem: &Problem, guess: &Trajectory) -> bool {
        let sweep = self.iterate.start(problem, guess);
        if !self.shooting.sweep(problem, &self.collocation, &mut self.iterate, sweep, true) {
            return false;
        }
        let row_count = (5 + problem.ellipses.len()) * problem.intervals.len();
        refill(&mut self.row_multipliers, row_count, 0.0);
        self.answer.reset(2 * problem.intervals.len(), row_count);
        if self.settings.hessian == Hessian::Bfgs {
            hessian::start_bfgs(problem, &mut self.blocks);
        }
        // Controls of the guess at a bound are the first guess of the active set.
        let (lower, upper) = control_bounds(problem);
        for (states, control) in self.answer.bound_states.chunks_exact_mut(2).zip(&self.iterate.controls) {
            for component in 0..2 {
                if control[component] == upper[component] {
                    states[component] = BoundState::Upper;
                } else if control[component] == lower[component] {
                    states[component] = BoundState::Lower;
                }
            }
        }
        self.chain.reserve(problem.intervals.len(), row_count);
        self.reserve_condensed(problem);
        let gap = self.shooting.gaps.iter().flatten().fold(0.0, |largest: f64, gap| largest.max(gap.abs()));
        gap == 0.0
            || gap > SMALL_GAP
            || self.shooting.sweep(problem, &self.collocation, &mut self.iterate, Sweep::Close, false)
    }

    fn is_closed(&self) -> bool {
        self.shooting.gaps.iter().flatten().all(|&gap| gap == 0.0)
    }

    /// The iteration from an iterate with gaps: its full step, or the roll-out of its controls where that is better.
    fn close_gaps(&mut self, problem: &Problem) -> bool {
        self.build_qp(problem, 0.0);
        let stepped = self.solve_program(problem, 0.0).then(|| {
            self.expand(Step::Program);
            self.try_fraction(problem, 1.0)
        });
        let stepped = stepped.flatten();
        let rolled = self
            .shooting
            .sweep(problem, &self.collocation, &mut self.iterate, Sweep::Close, false)
            .then(|| merit(problem, &self.iterate));
        match (stepped, rolled) {
            (Some(stepped), rolled) if rolled.is_none_or(|rolled| stepped <= rolled) => {
                self.accept(problem, Step::Program);
                true
            }
            (_, rolled) => rolled.is_some(),
        }
    }

    /// One iteration from an iterate that satisfies the model; false where no step could be computed.
    fn advance(&mut self, problem: &Problem, damping: &mut f64) -> bool {
        let relieved = penalties(problem, &self.iterate).0;
        let present = smooth(problem, &self.iterate) + relieved;
        loop {
            self.build_qp(problem, *damping);
            if self.solve_program(problem, *damping) {
                if self.try_newton(problem, present, relieved) {
                    self.refusals = 0;
                    *damping = relaxed(*damping);
                    return true;
                }
                if let Some(fraction) = self.search(problem, present, relieved) {
                    self.refusals += 1;
                    if fraction == 1.0 {
                        *damping = relaxed(*damping);
                    } else if fraction < 0.5 {
                        *damping = raised(*damping);
                    }
                    return true;
                }
            }
            if *damping > MAX_DAMPING {
                return false;
            }
            *damping = raised(*damping);
        }
    }

    /// Newton's step on the active set of the quadratic program; false where there is none that is accepted in full.
    ///
    /// Without refinement it is the step of the quadratic program, with its second-order correction.
    fn try_newton(&mut self, problem: &Problem, present: f64, relieved: f64) -> bool {
        // Steps with and without the shift alternate, because either may be slow alone.
        let shift = self.refusals % 2 == 1;
        if !self.solve_newton(problem, shift) {
            return false;
        }
        self.expand(Step::Newton);
        let predicted = self.predict(problem, relieved);
        if predicted > 0.0 {
            return false;
        }
        let wanted = wanted(present, predicted);
        let mut accepted = self.try_fraction(problem, 1.0).is_some_and(|merit| merit <= wanted);
        if !accepted && self.correct(problem) {
            self.expand(Step::Newton);
            accepted = self.try_fraction(problem, 1.0).is_some_and(|merit| merit <= wanted);
        }
        if accepted {
            self.accept(problem, Step::Newton);
        }
        accepted
    }

    /// Searches along the step of the quadratic program; the accepted fraction of it.
    fn search(&mut self, problem: &Problem, present: f64, relieved: f64) -> Option<f64> {
        self.expand(Step::Program);
        let predicted = self.predict(problem, relieved).min(0.0);
        let mut fraction = 1.0;
        for _ in 0..ATTEMPTS {
            let merit = self.try_fraction(problem, fraction);
            if merit.is_some_and(|merit| merit <= wanted(present, fraction * predicted)) {
                self.accept(problem, Step::Program);
                return Some(fraction);
            }
            fraction *= 0.5;
        }
        None
    }

    /// Fills the step with the states that follow from its controls on the linearised model.
    fn expand(&mut self, step: Step) {
        let controls = match step {
            Step::Program => &self.answer.step,
            Step::Newton => &self.newton.step,
        };
        fill(&mut self.step.controls, controls.chunks_exact(2).map(|pair| [pair[0], pair[1]]));
        self.shooting.expand(&mut self.step);
    }

    /// Change of the merit by the full step, to first order in the smooth part and exact in the penalties of the
    /// linearised limits.
    fn predict(&self, problem: &Problem, relieved: f64) -> f64 {
        smooth_slope(problem, &self.iterate, &self.step)
            + linearised_penalties(problem, &self.iterate, &self.step)
            - relieved
    }

    /// The trial at a fraction of the step, linearised, and its merit; none where the model has no solution there.
    fn try_fraction(&mut self, problem: &Problem, fraction: f64) -> Option<f64> {
        self.trial.move_from(&self.iterate, &self.step, fraction);
        for control in &mut self.trial.controls {
            // Removes rounding errors beyond the bounds.
            let inside = problem.bounds.clamp(Control { velocity: control[0], steering: control[1] });
            *control = [inside.velocity, inside.steering];
        }
        let swept =
            self.trial_shooting.sweep(problem, &self.collocation, &mut self.trial, Sweep::Close, false);
        swept.then(|| merit(problem, &self.trial)).filter(|merit| merit.is_finite())
    }

    /// Makes the trial the iterate.
    fn accept(&mut self, problem: &Problem, step: Step) {
        std::mem::swap(&mut self.iterate, &mut self.trial);
        std::mem::swap(&mut self.shooting, &mut self.trial_shooting);
        let solution = match step {
            Step::Program => &self.answer,
            Step::Newton => &self.newton,
        };
        self.row_multipliers.clone_from(&solution.row_multipliers);
        if self.settings.hessian == Hessian::Bfgs {
            let rows = &self.row_multipliers;
            kkt::costates(problem, &self.iterate, &self.shooting, rows, &mut self.costates);
            hessian::update_bfgs(
                problem,
                Point { iterate: &self.trial, shooting: &self.trial_shooting },
                Point { iterate: &self.iterate, shooting: &self.shooting },
                Multipliers { costates: &self.costates, rows },
                &mut self.blocks,
            );
        }
    }

    fn report(
        &self,
        problem: &Problem,
        status: Status,
        iterations: u32,
        kkt_residual: f64,
        solution: &mut Solution,
    ) {
        let (penalty, slack) = penalties(problem, &self.iterate);
        let bounds = self.answer.bound_states.iter().filter(|state| **state != BoundState::Free);
        let active =
            |rows: &[RowState]| rows.iter().filter(|state| **state != RowState::Inside).count() as u32;
        let first_ellipse = ellipse_row(problem.intervals.len(), problem.ellipses.len(), 1, 0);
        let Trajectory { states, controls } = &mut solution.trajectory;
        fill(states, self.iterate.states.iter().map(|state| State::from_vector(&(*state).into())));
        fill(
            controls,
            self.iterate.controls.iter().map(|&[velocity, steering]| Control { velocity, steering }),
        );
        solution.status = status;
        solution.iterations = iterations;
        solution.kkt_residual = kkt_residual;
        solution.largest_violation = self.shooting.defect;
        solution.slack = slack;
        solution.objective = smooth(problem, &self.iterate) + penalty;
        solution.active_constraints = bounds.count() as u32 + active(&self.answer.row_states);
        solution.active_ellipses = self.answer.row_states.get(first_ellipse..).map_or(0, active);
    }
}

fn merit(problem: &Problem, iterate: &Iterate) -> f64 {
    smooth(problem, iterate) + penalties(problem, iterate).0
}

/// The largest merit that a step with this predicted change may have.
fn wanted(present: f64, predicted: f64) -> f64 {
    // Near the solution differences of the merit are rounding errors.
    const ROUNDING: f64 = 1e-13;
    present + ARMIJO * predicted + ROUNDING * (1.0 + present.abs())
}

fn raised(damping: f64) -> f64 {
    (10.0 * damping).max(FIRST_DAMPING)
}

fn relaxed(damping: f64) -> f64 {
    if damping <= FIRST_DAMPING { 0.0 } else { damping / 10.0 }
}

fn refuse(guess: &Trajectory, solution: &mut Solution) {
    solution.trajectory.clone_from(guess);
    *solution = Solution { trajectory: std::mem::take(&mut solution.trajectory), ..Solution::default() };
}
