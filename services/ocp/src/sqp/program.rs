//! The quadratic program of one iteration and Newton's step on its active set: condensed, or as a chain where it is
//! long.

use super::Solver;
use crate::condense::{add_second_order, condense, condense_blocks};
use crate::dense::{cholesky, fill};
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
        if self.is_long {
            self.chain.build(problem, &self.iterate, damping, &mut self.buffer);
            match self.settings.hessian {
                Hessian::GaussNewton => hessian::gauss_newton(problem, &mut self.blocks),
                Hessian::Bfgs => {}
                Hessian::Exact => {
                    self.find_exact(problem, Source::Iterate);
                    hessian::convexify(&mut self.exact);
                }
            }
            return;
        }
        condense(problem, &self.iterate, &self.shooting, damping, &mut self.qp);
        if self.settings.hessian == Hessian::Exact {
            self.find_exact(problem, Source::Iterate);
            let Qp { rows, hessian, gradient, .. } = &mut self.qp;
            condense_blocks(problem, &self.exact, damping, rows, hessian);
            if !cholesky(hessian, gradient.len(), &mut self.buffer) {
                hessian::convexify(&mut self.exact);
                condense_blocks(problem, &self.exact, damping, rows, hessian);
            }
        } else if self.settings.hessian == Hessian::Bfgs {
            condense_blocks(problem, &self.blocks, damping, &self.qp.rows, &mut self.qp.hessian);
        }
    }

    /// Solves the quadratic program; false where neither method does.
    pub(super) fn solve_program(&mut self, problem: &Problem, damping: f64) -> bool {
        if self.is_long {
            let exact = self.settings.hessian == Hessian::Exact;
            let blocks = if exact { &self.exact } else { &self.blocks };
            if self.chain.solve(&self.shooting, blocks, &mut self.answer) {
                return true;
            }
            self.fallbacks += 1;
            condense(problem, &self.iterate, &self.shooting, damping, &mut self.qp);
            return clarabel::solve(&self.qp, &mut self.answer);
        }
        if self.settings.qp == QpChoice::ActiveSet {
            let size = self.qp.gradient.iter().fold(1.0, |largest: f64, entry| largest.max(entry.abs()));
            if self.active_set.solve(&self.qp, &mut self.answer)
                && self.qp.residual(&self.answer, &mut self.buffer) <= QP_TOLERANCE * size
            {
                return true;
            }
            self.fallbacks += 1;
        }
        clarabel::solve(&self.qp, &mut self.answer) && {
            self.polish();
            true
        }
    }

    /// Newton's step on the active set of the quadratic program, into the solution of `newton`; false where there is
    /// none.
    pub(super) fn solve_newton(&mut self, problem: &Problem, damping: f64, shift: bool) -> bool {
        if self.is_long {
            self.refine_chain(problem, shift)
        } else {
            self.build_newton(problem, damping);
            self.newton.solve(&self.qp, &self.answer, shift)
        }
    }

    /// The second-order correction of Newton's step from what its trial has left of the held rows.
    pub(super) fn correct(&mut self, problem: &Problem) -> bool {
        let (states, trial) = (&self.newton.solution.row_states, &self.trial);
        let held = if self.is_long { self.chain.equations() } else { self.newton.equations() };
        fill(
            &mut self.buffer,
            held.iter().map(|&row| row_excess(problem, trial, row, states[row] == RowState::AtUpper)),
        );
        if self.buffer.is_empty() {
            false
        } else if self.is_long {
            self.chain.correct(&self.buffer, &mut self.newton.solution)
        } else {
            self.newton.correct(&self.qp, &self.buffer)
        }
    }

    /// Newton's step of the chain, into the solution of `newton`.
    fn refine_chain(&mut self, problem: &Problem, shift: bool) -> bool {
        self.newton.solution.copy_from(&self.answer);
        if !self.settings.refine {
            return true;
        }
        self.find_exact(problem, Source::Program);
        if self.chain.refine(&self.shooting, &self.exact, &mut self.newton.solution) {
            return true;
        }
        if !shift {
            return false;
        }
        hessian::convexify(&mut self.exact);
        self.newton.solution.copy_from(&self.answer);
        self.chain.refine(&self.shooting, &self.exact, &mut self.newton.solution)
    }

    /// Fills the Hessian of Newton's step.
    fn build_newton(&mut self, problem: &Problem, damping: f64) {
        if !self.settings.refine {
            self.newton.hessian.clone_from(&self.qp.hessian);
        } else if self.settings.hessian == Hessian::GaussNewton {
            // Only the difference to the Hessian of the program has to be added.
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
        } else {
            self.find_exact(problem, Source::Program);
            condense_blocks(problem, &self.exact, damping, &self.qp.rows, &mut self.newton.hessian);
        }
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
        self.newton.hessian.clone_from(&self.qp.hessian);
        if self.newton.solve(&self.qp, &self.answer, false) {
            self.newton.fill_bound_multipliers(&self.qp);
            let exact = self.qp.residual(&self.newton.solution, &mut self.buffer);
            if exact < self.qp.residual(&self.answer, &mut self.buffer) {
                self.answer.copy_from(&self.newton.solution);
            }
        }
    }
}
