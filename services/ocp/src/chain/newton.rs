//! Newton's step on the active set of the chain's program, with the exact Hessian.
//!
//! The quadratic program finds the active set. Its Gauss-Newton Hessian is always convex but lacks the curvature of
//! the model and of the ellipses, so alone it converges linearly, or oscillates. Here controls at their bounds are
//! fixed, limits that are kept become equations, and limits that are exceeded become quadratic penalties. The exact
//! Hessian then gives quadratic convergence where it is positive definite on the remaining space. Elsewhere there is
//! no step, and the caller uses that of the quadratic program.

use super::Chain;
use crate::dense::{fill, solve_factored};
use crate::hessian::Block;
use crate::qp::{BoundState, QpSolution};
use crate::shooting::Shooting;
use crate::walk::{Met, Walk};

impl Chain {
    /// Newton's step with `blocks`, which may be indefinite, from the step and active set in `solution`, into it;
    /// false where they are not positive definite on that set.
    ///
    /// A constraint that is met on the way from the step of the program joins the active set.
    pub(crate) fn refine(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
    ) -> bool {
        /// How many constraints may join, at least and per stage. With more, the program is too far from the step.
        /// The part walked by then is used as the step.
        const JOINING: usize = 4;
        const STAGES_PER_JOIN: usize = 12;
        self.start_walk(shooting, solution);
        for round in 0..=JOINING + self.lower.len() / 2 / STAGES_PER_JOIN {
            if !self.solve_set(shooting, blocks, solution) {
                if round == 0 {
                    return false;
                }
                // The part walked so far is a valid step, which cannot be corrected.
                self.equations.clear();
                break;
            }
            self.report_rows(solution);
            let Walk { fraction, met: Some(met) } = self.way(solution) else {
                std::mem::swap(&mut self.point, &mut self.path);
                break;
            };
            self.walk(fraction);
            match met {
                Met::Bound(place, state) => solution.bound_states[place] = state,
                Met::Row(row, state) => solution.row_states[row] = state,
            }
        }
        self.write(&self.point, solution);
        solution.step.iter().all(|value| value.is_finite())
    }

    /// The point of the step in `solution`.
    fn start_walk(&mut self, shooting: &Shooting, solution: &QpSolution) {
        fill(&mut self.point.controls, solution.step.chunks_exact(2).map(|pair| [pair[0], pair[1]]));
        self.point.follow(&shooting.intervals, &shooting.gaps);
    }

    /// The way from the point to the path up to the first constraint between them.
    fn way(&self, solution: &QpSolution) -> Walk {
        let mut walk = Walk::whole();
        let values = self.point.controls.iter().flatten().zip(self.path.controls.iter().flatten());
        for (place, (&value, &target)) in values.enumerate() {
            if solution.bound_states[place] == BoundState::Free {
                let bounds = [self.lower[place], self.upper[place]];
                walk.consider_bound(place, value, target - value, bounds);
            }
        }
        for (index, row) in self.rows.iter().enumerate() {
            let value = row.value(&self.point.states);
            let change = row.value(&self.path.states) - value;
            walk.consider_row(index, solution.row_states[index], value, change, [row.lower, row.upper]);
        }
        walk
    }

    /// Moves the point by a fraction of the way to the path.
    fn walk(&mut self, fraction: f64) {
        let (point, path) = (&mut self.point, &self.path);
        for (value, target) in point.controls.iter_mut().flatten().zip(path.controls.iter().flatten()) {
            *value += fraction * (target - *value);
        }
        for (value, target) in point.states.iter_mut().flatten().zip(path.states.iter().flatten()) {
            *value += fraction * (target - *value);
        }
    }

    /// Second-order correction: moves the step of `solution`, the last one found, so that the rows it holds, which the
    /// curvature has left by `excesses`, return to their limits. False where that is not within the bounds.
    pub(crate) fn correct(&mut self, excesses: &[f64], solution: &mut QpSolution) -> bool {
        let size = self.equations.len();
        fill(&mut self.multipliers, excesses.iter().copied());
        solve_factored(&self.schur_factor, size, &mut self.multipliers);
        let mut inside = true;
        for (place, value) in solution.step.iter_mut().enumerate() {
            if solution.bound_states[place] != BoundState::Free {
                continue;
            }
            for (response, multiplier) in self.responses.iter().zip(&self.multipliers) {
                *value += multiplier * response.controls[place / 2][place % 2];
            }
            inside &= *value >= self.lower[place] && *value <= self.upper[place];
        }
        inside
    }
}
