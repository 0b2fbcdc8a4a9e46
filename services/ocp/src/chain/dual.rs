//! The chain by the dual active-set method ([`crate::qp::active_set`]), where the search ends without an answer.
//!
//! The recursion is factorised once, with nothing held. The response of a constraint, by how much its unit multiplier moves
//! the path, is one solve with it; products of normals are entries of responses. So a step costs one solve, linear in the
//! number of intervals, where the interior point factorises anew; and it starts from the last set of the search.

use super::{Chain, Path, Riccati, Row};
use crate::dense::{fill, refill};
use crate::hessian::Block;
use crate::qp::active_set::{Constraint, Program};
use crate::qp::{BoundState, QpSolution, soft_residual};
use crate::shooting::Shooting;

/// The chain with the responses of the working constraints.
struct Staged<'a> {
    shooting: &'a Shooting,
    riccati: &'a Riccati,
    rows: &'a [Row],
    lower: &'a [f64],
    upper: &'a [f64],
    penalty: (f64, f64),
    /// The path without constraints.
    free: &'a Path,
    path: &'a mut Path,
    joined: &'a mut Vec<(Constraint, f64)>,
    responses: &'a mut Vec<Path>,
}

impl Staged<'_> {
    /// The value of a joined constraint on a path, with its sign.
    fn signed(&self, position: usize, path: &Path) -> f64 {
        let (what, sign) = self.joined[position];
        sign * match what {
            Constraint::Bound(place) => path.controls[place / 2][place % 2],
            Constraint::Row(row) => self.rows[row].value(&path.states),
        }
    }
}

impl Program for Staged<'_> {
    fn size(&self) -> (usize, usize) {
        (self.lower.len(), self.rows.len())
    }

    fn range(&self, what: Constraint) -> [f64; 2] {
        match what {
            Constraint::Bound(place) => [self.lower[place], self.upper[place]],
            Constraint::Row(row) => [self.rows[row].lower, self.rows[row].upper],
        }
    }

    fn penalty(&self) -> (f64, f64) {
        self.penalty
    }

    fn clear(&mut self) {
        self.joined.clear();
    }

    fn join(&mut self, what: Constraint, sign: f64) {
        let position = self.joined.len();
        self.joined.push((what, sign));
        if self.responses.len() == position {
            self.responses.push(Path::default());
        }
        let (response, mut slope) = (&mut self.responses[position], [0.0; 7]);
        let node = match what {
            Constraint::Bound(place) => {
                slope[5 + place % 2] = sign;
                place / 2
            }
            Constraint::Row(row) => {
                self.rows[row].add_to(sign, &mut slope);
                self.rows[row].node
            }
        };
        self.riccati.respond(&self.shooting.intervals, node, &slope, response);
    }

    fn leave(&mut self, position: usize) {
        self.responses[position..self.joined.len()].rotate_left(1);
        self.joined.remove(position);
    }

    fn product(&self, left: usize, right: usize) -> f64 {
        -self.signed(left, &self.responses[right])
    }

    fn offset(&self, position: usize) -> f64 {
        // Limits are those of the path, which has a value without controls, too.
        -self.signed(position, self.free)
    }

    fn primal(&mut self, multipliers: impl Iterator<Item = f64>, step: &mut Vec<f64>) {
        self.path.copy_from(self.free);
        for (multiplier, response) in multipliers.zip(&*self.responses) {
            self.path.add(multiplier, response);
        }
        fill(step, self.path.controls.iter().flatten().copied());
    }

    fn values(&self, _: &[f64], values: &mut Vec<f64>) {
        fill(values, self.rows.iter().map(|row| row.value(&self.path.states)));
    }
}

impl Chain {
    /// Solves with convex `blocks` from the states that the search ended with; false where the steps do not end, or the
    /// answer is not exact. Then `solution` is as before.
    pub(crate) fn solve_dual(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
    ) -> bool {
        self.is_factorised = false;
        self.equations.clear();
        let mut found = std::mem::take(&mut self.exact);
        let is_solved = self.find_dual(shooting, blocks, &mut found);
        if is_solved {
            std::mem::swap(&mut found, solution);
        }
        self.exact = found;
        is_solved && {
            // Where its set has a unique solution, the search has it to more digits, and keeps the factors.
            self.try_search(shooting, blocks, solution);
            true
        }
    }

    fn find_dual(&mut self, shooting: &Shooting, blocks: &[Block], found: &mut QpSolution) -> bool {
        let variables = self.lower.len();
        self.damp(blocks);
        refill(&mut self.held, variables, 0.0);
        refill(&mut self.unheld, variables, BoundState::Free);
        let intervals = &shooting.intervals;
        if !self.riccati.factorise(intervals, &self.blocks, &self.change, self.tied, &self.unheld) {
            return false;
        }
        self.riccati.solve(intervals, &self.slopes, &self.held, Some(&shooting.gaps), &mut self.point);
        let mut program = Staged {
            shooting,
            riccati: &self.riccati,
            rows: &self.rows,
            lower: &self.lower,
            upper: &self.upper,
            penalty: (self.slack_linear, self.slack_quadratic),
            free: &self.point,
            path: &mut self.path,
            joined: &mut self.joined,
            responses: &mut self.responses,
        };
        self.dual.solve_program(&mut program, found) && self.is_exact(found)
    }

    /// Whether the path keeps the bounds and the multipliers of the rows belong to their values. That the controls are
    /// stationary follows from how the path is made.
    fn is_exact(&self, solution: &QpSolution) -> bool {
        /// Per size of the multipliers.
        const TOLERANCE: f64 = 1e-10;
        let size = solution.row_multipliers.iter().fold(1.0, |most: f64, value| most.max(value.abs()));
        let tolerance = TOLERANCE * size;
        let controls = self.path.controls.iter().flatten();
        controls.zip(&solution.step).zip(self.lower.iter().zip(&self.upper)).all(
            |((value, step), (low, high))| {
                (value - step).abs() <= tolerance && *value >= low - tolerance && *value <= high + tolerance
            },
        ) && self.rows.iter().zip(&solution.row_multipliers).all(|(row, &multiplier)| {
            let value = row.value(&self.path.states);
            let (linear, quadratic) = (self.slack_linear, self.slack_quadratic);
            soft_residual(value, row.lower, row.upper, multiplier, linear, quadratic).abs() <= tolerance
        })
    }
}

#[cfg(test)]
mod tests;
