//! The quadratic program of one iteration and Newton's step on its active set.
//!
//! The program is solved stage by stage, by the search for its active set, which ends after a few rounds where little has
//! changed. Where it fails, a short horizon is condensed for the dual active set; the interior point of the chain comes next,
//! then the dual active set by stages, and Clarabel last.

use super::Solver;
use crate::condense::{condense, condense_blocks};
use crate::dense::fill;
use crate::hessian::{self, Hessian};
use crate::kkt::{self, Multipliers};
use crate::problem::Problem;
use crate::qp::{Qp, QpChoice, RowState, clarabel};
use crate::rows::row_excess;

/// Largest violation of the optimality conditions by an answer of the active set, per size of the gradient.
const QP_TOLERANCE: f64 = 1e-8;

/// Where multipliers come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Source {
    /// The last accepted step.
    Iterate,
    /// The quadratic program.
    Program,
}

impl Solver {
    /// Fills the quadratic program at the iterate.
    pub(super) fn build_qp(&mut self, problem: &Problem, damping: f64) {
        self.chain.build(problem, &self.iterate, damping, &mut self.buffer);
        match self.settings.hessian {
            Hessian::GaussNewton => hessian::gauss_newton(problem, &mut self.blocks),
            Hessian::Bfgs => {}
            Hessian::Exact => {
                self.find_exact(problem, Source::Iterate);
                hessian::convexify(&mut self.exact);
            }
        }
    }

    /// Solves the quadratic program; false where no method does.
    pub(super) fn solve_program(&mut self, problem: &Problem, damping: f64) -> bool {
        let blocks = if self.settings.hessian == Hessian::Exact { &self.exact } else { &self.blocks };
        if self.settings.qp == QpChoice::ActiveSet && problem.weights.slack_quadratic > 0.0 {
            if self.chain.solve(&self.shooting, blocks, &mut self.answer) {
                return true;
            }
            let is_short = problem.intervals.len() <= self.settings.condense_up_to;
            if is_short && self.solve_condensed(problem, damping) {
                return true;
            }
            let blocks = if self.settings.hessian == Hessian::Exact { &self.exact } else { &self.blocks };
            if self.chain.solve_from_inside(&self.shooting, blocks, &mut self.answer)
                || self.chain.solve_dual(&self.shooting, blocks, &mut self.answer)
            {
                return true;
            }
        }
        if self.settings.qp == QpChoice::ActiveSet {
            self.fallbacks += 1;
        }
        self.condense(problem, damping);
        clarabel::solve(&self.qp, &mut self.answer) && {
            self.polish();
            true
        }
    }

    /// Solves the quadratic program that was solved last, after the first gap has changed.
    pub(super) fn solve_program_again(&mut self, problem: &Problem) -> bool {
        let blocks = if self.settings.hessian == Hessian::Exact { &self.exact } else { &self.blocks };
        let is_searched = self.settings.qp == QpChoice::ActiveSet && problem.weights.slack_quadratic > 0.0;
        (is_searched && self.chain.solve_again(&self.shooting, blocks, &mut self.answer))
            || self.solve_program(problem, 0.0)
    }

    /// Solves the condensed program with the dual active set; false where it does not end, or its answer is not exact.
    fn solve_condensed(&mut self, problem: &Problem, damping: f64) -> bool {
        self.condense(problem, damping);
        let size = self.qp.gradient.iter().fold(1.0, |largest: f64, entry| largest.max(entry.abs()));
        self.active_set.solve(&self.qp, &mut self.answer)
            && self.qp.residual(&self.answer, &mut self.buffer) <= QP_TOLERANCE * size
    }

    /// Makes room for the condensed program, so that later solves of this size allocate nothing.
    pub(super) fn reserve_condensed(&mut self, problem: &Problem) {
        let count = problem.intervals.len();
        let is_used = count <= self.settings.condense_up_to && self.settings.qp == QpChoice::ActiveSet;
        if is_used && self.qp.row_lower.capacity() < self.answer.row_states.len() {
            condense(problem, &self.iterate, &self.shooting, 0.0, &mut self.qp);
            self.newton.copy_from(&self.answer);
            self.active_set.solve(&self.qp, &mut self.newton);
            self.qp.residual(&self.newton, &mut self.buffer);
        }
    }

    /// Condenses the program.
    fn condense(&mut self, problem: &Problem, damping: f64) {
        condense(problem, &self.iterate, &self.shooting, damping, &mut self.qp);
        let Qp { rows, hessian, .. } = &mut self.qp;
        match self.settings.hessian {
            Hessian::GaussNewton => {}
            Hessian::Bfgs => condense_blocks(problem, &self.blocks, damping, rows, hessian),
            Hessian::Exact => condense_blocks(problem, &self.exact, damping, rows, hessian),
        }
    }

    /// Newton's step on the active set of the quadratic program, into `newton`; false where there is none.
    ///
    /// With `shift` its Hessian is made convex where it is not, for iterations that would otherwise be slow along a
    /// direction of negative curvature.
    pub(super) fn solve_newton(&mut self, problem: &Problem, shift: bool) -> bool {
        self.newton.copy_from(&self.answer);
        if !self.settings.refine {
            return true;
        }
        self.find_exact(problem, Source::Program);
        if self.chain.refine(&self.shooting, &self.exact, &mut self.newton) {
            return true;
        }
        if !shift {
            return false;
        }
        hessian::convexify(&mut self.exact);
        self.newton.copy_from(&self.answer);
        self.chain.refine(&self.shooting, &self.exact, &mut self.newton)
    }

    /// The second-order correction of Newton's step from what its trial has left of the held rows.
    ///
    /// Without it a good step is refused near the solution, because the penalty sees the excess and not the gain.
    pub(super) fn correct(&mut self, problem: &Problem) -> bool {
        let (states, trial) = (&self.newton.row_states, &self.trial);
        fill(
            &mut self.buffer,
            self.chain
                .equations()
                .iter()
                .map(|&row| row_excess(problem, trial, row, states[row] == RowState::AtUpper)),
        );
        !self.buffer.is_empty() && self.chain.correct(&self.buffer, &mut self.newton)
    }

    /// Fills the blocks of the exact Hessian.
    fn find_exact(&mut self, problem: &Problem, source: Source) {
        let rows = match source {
            Source::Iterate => &self.row_multipliers,
            Source::Program => &self.answer.row_multipliers,
        };
        kkt::costates(problem, &self.iterate, &self.shooting, rows, &mut self.costates);
        hessian::exact(
            problem,
            &self.collocation,
            &self.iterate,
            &self.shooting,
            Multipliers { costates: &self.costates, rows },
            &mut self.exact,
        );
    }

    /// Replaces the interior point's answer by the exact solution on its active set, where that is better.
    fn polish(&mut self) {
        let blocks = if self.settings.hessian == Hessian::Exact { &self.exact } else { &self.blocks };
        self.newton.copy_from(&self.answer);
        if self.chain.solve(&self.shooting, blocks, &mut self.newton) {
            let exact = self.qp.residual(&self.newton, &mut self.buffer);
            if exact < self.qp.residual(&self.answer, &mut self.buffer) {
                self.answer.copy_from(&self.newton);
            }
        }
    }
}
