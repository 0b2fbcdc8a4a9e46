//! One configuration of the solver and its measurements so far.

use std::time::{Duration, Instant};

use figures::{Distribution, Figures};
use ocp::{Budget, Hessian, Problem, QpChoice, Solution, Solver, SolverSettings, Status, Trajectory};
use serde::Serialize;

use crate::allocations;

/// Timed solves per case, whose median counts; one untimed solve before them warms up caches and buffers. The median of
/// three removes a single disturbance by the system, for the peers as well.
pub(super) const REPEATS: usize = 3;
/// A first solve that took longer than this counts itself: warm caches change it little.
const SLOW: Duration = Duration::from_millis(10);
/// Time that a configuration may take for all cases. A slower one leaves out cases, evenly over all of them: the
/// interior point with 96 intervals would take minutes.
const BUDGET: Duration = Duration::from_secs(8);

/// A solver with its measurements.
pub(super) struct Contender {
    solver: Solver,
    solution: Solution,
    /// Without figures.
    row: ContenderRow,
    step: Distribution,
    feedback: Distribution,
    solve: Distribution,
    iterations: Distribution,
    spent: Duration,
}

/// What is printed of a contender.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct ContenderRow {
    /// Name of the solver of the quadratic programs.
    pub name: String,
    /// Hessian of the quadratic programs.
    pub hessian: String,
    /// Whether steps are refined by Newton's method on the active set.
    pub refine: bool,
    /// Number of intervals.
    pub n: usize,
    /// `condensed` to the controls, or stage by stage: `stages`.
    pub layout: &'static str,
    /// Number of measured cases; less than all where they would take too long.
    pub cases: u64,
    /// Number of them in which it converged.
    pub converged: u64,
    /// Number of them in which it did not.
    pub failed: u64,
    /// One SQP iteration from the warm start [us].
    pub step_us: Figures,
    /// The part of it after the initial state has arrived [us].
    pub feedback_us: Figures,
    /// Converged solve [us].
    pub solve_us: Figures,
    /// SQP iterations of a converged solve.
    pub iterations: Figures,
    /// Most heap allocations of a solve.
    pub allocations: u64,
}

impl Contender {
    pub(super) fn new(settings: SolverSettings, intervals: usize) -> Self {
        let is_by_stages = settings.qp == QpChoice::ActiveSet && intervals > settings.condense_up_to;
        let row = ContenderRow {
            name: name_of(&settings.qp),
            hessian: name_of(&settings.hessian),
            refine: settings.refine,
            n: intervals,
            layout: if is_by_stages { "stages" } else { "condensed" },
            ..ContenderRow::default()
        };
        Self {
            solver: Solver::new(settings),
            solution: Solution::default(),
            row,
            step: Distribution::of_times(),
            feedback: Distribution::of_times(),
            solve: Distribution::of_times(),
            iterations: Distribution::of_counts(),
            spent: Duration::ZERO,
        }
    }

    /// All configurations that are compared with `intervals` intervals: each Hessian with each QP solver, and with the
    /// published number of intervals the classic methods without refinement as well.
    pub(super) fn all(intervals: usize) -> Vec<Self> {
        let mut all = Vec::new();
        for refine in [true, false] {
            for qp in [QpChoice::ActiveSet, QpChoice::Clarabel] {
                for hessian in [Hessian::GaussNewton, Hessian::Bfgs, Hessian::Exact] {
                    if refine || (intervals == 6 && qp == QpChoice::ActiveSet) {
                        let settings = SolverSettings { hessian, qp, refine, ..SolverSettings::default() };
                        all.push(Self::new(settings, intervals));
                    }
                }
            }
        }
        all
    }

    /// Its number of intervals.
    pub(super) fn intervals(&self) -> usize {
        self.row.n
    }

    /// Whether it has the settings of the controller.
    pub(super) fn is_default(&self) -> bool {
        *self.solver.settings() == SolverSettings::default()
    }

    /// Whether to leave out the case after this share of all cases, because the time for that share is used up.
    pub(super) fn leaves_out(&self, share: f64) -> bool {
        self.spent > BUDGET.mul_f64(share.clamp(0.0, 1.0)) && self.row.cases > 0 && !self.is_default()
    }

    /// Measures one case; the converged solution where there is one.
    pub(super) fn measure(&mut self, problem: &Problem, guess: &Trajectory) -> Option<&Solution> {
        self.row.cases += 1;
        let started = Instant::now();
        let (step_ns, _) = self.timed(problem, guess, &Budget::Iterations(1));
        self.step.record(step_ns);
        let (solve_ns, allocations) = self.timed(problem, guess, &Budget::Iterations(u32::MAX));
        self.row.allocations = self.row.allocations.max(allocations);
        self.measure_feedback(problem, guess);
        let converged = self.solution.status == Status::Converged;
        if converged {
            self.row.converged += 1;
            self.solve.record(solve_ns);
            self.iterations.record(u64::from(self.solution.iterations));
        } else {
            self.row.failed += 1;
        }
        self.spent += started.elapsed();
        converged.then_some(&self.solution)
    }

    /// The median time of the feedback phase, prepared at a state that was predicted a millimetre off.
    fn measure_feedback(&mut self, problem: &Problem, guess: &Trajectory) {
        let mut predicted = problem.clone();
        predicted.initial.y += 1e-3;
        let mut times = [0; REPEATS];
        for time in &mut times {
            if !self.solver.prepare(&predicted, guess) {
                return;
            }
            let started = Instant::now();
            let control = self.solver.feedback(&predicted, &problem.initial);
            let elapsed = started.elapsed();
            if std::hint::black_box(control).is_none() {
                return;
            }
            *time = nanoseconds(elapsed);
            if elapsed > SLOW {
                self.feedback.record(nanoseconds(elapsed));
                return;
            }
        }
        times.sort_unstable();
        self.feedback.record(times[REPEATS / 2]);
    }

    /// Nanoseconds of a solve, and the allocations of the last one.
    fn timed(&mut self, problem: &Problem, guess: &Trajectory, budget: &Budget) -> (u64, u64) {
        let mut times = [0; REPEATS];
        let (first, mut allocations) = self.once(problem, guess, budget);
        if first > SLOW {
            return (nanoseconds(first), allocations);
        }
        for time in &mut times {
            let (elapsed, counted) = self.once(problem, guess, budget);
            (*time, allocations) = (nanoseconds(elapsed), counted);
        }
        times.sort_unstable();
        (times[REPEATS / 2], allocations)
    }

    fn once(&mut self, problem: &Problem, guess: &Trajectory, budget: &Budget) -> (Duration, u64) {
        let before = allocations();
        let started = Instant::now();
        self.solver.solve_into(problem, guess, budget, &mut self.solution);
        let elapsed = started.elapsed();
        std::hint::black_box(&self.solution);
        (elapsed, allocations() - before)
    }

    pub(super) fn row(&self) -> ContenderRow {
        ContenderRow {
            step_us: self.step.figures(),
            feedback_us: self.feedback.figures(),
            solve_us: self.solve.figures(),
            iterations: self.iterations.figures(),
            ..self.row.clone()
        }
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

/// The name that a settings file has for a choice.
fn name_of(choice: &impl Serialize) -> String {
    serde_json::to_value(choice).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::problem::{Case, guess, problem};
    use super::*;
    use ocp::Collocation;

    #[test]
    fn a_case_that_converges_is_counted_with_its_iterations_and_times() {
        let problem = problem(&Case::default(), 6);
        let mut contender = Contender::new(SolverSettings::default(), 6);
        assert!(contender.is_default());
        let start = guess(&problem, &Collocation::new(SolverSettings::default().scheme), None);
        assert!(contender.measure(&problem, &start).is_some());
        let row = contender.row();
        assert_eq!((row.name.as_str(), row.n, row.converged, row.failed), ("active-set", 6, 1, 0));
        assert!(row.solve_us.count == 1 && row.step_us.count == 1 && row.iterations.max >= 1.0);
    }

    #[test]
    fn a_slow_configuration_leaves_cases_out_and_the_default_one_never() {
        let mut slow =
            Contender::new(SolverSettings { qp: QpChoice::Clarabel, ..SolverSettings::default() }, 6);
        assert!(!slow.leaves_out(0.0), "the first case is never left out");
        (slow.row.cases, slow.spent) = (1, BUDGET / 2);
        assert!(slow.leaves_out(0.4) && !slow.leaves_out(0.6));
        let mut default = Contender::new(SolverSettings::default(), 6);
        (default.row.cases, default.spent) = (1, 2 * BUDGET);
        assert!(!default.leaves_out(0.5));
    }

    #[test]
    fn a_case_that_means_nothing_is_a_failure() {
        let mut problem = problem(&Case::default(), 6);
        problem.initial.y = f64::NAN;
        let mut contender = Contender::new(SolverSettings::default(), 6);
        assert!(contender.measure(&problem, &Trajectory::default()).is_none());
        assert_eq!((contender.row().converged, contender.row().failed), (0, 1));
    }
}
