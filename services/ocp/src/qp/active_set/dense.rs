//! The condensed program for the dual active set: H = L L', m = L^-1 a.

use super::{ActiveSet, Constraint, Program};
use crate::dense::{backward, cholesky, dot, fill, forward, refill};
use crate::qp::{Qp, QpSolution};

/// Buffers of a condensed program.
#[derive(Debug, Clone, Default)]
pub(crate) struct DenseActiveSet {
    method: ActiveSet,
    factor: Vec<f64>,
    /// f = L^-1 c.
    offset: Vec<f64>,
    /// m of the working constraints, row by row.
    normals: Vec<f64>,
    /// The rows, column by column: their values are made all at once, each in its order.
    columns: Vec<f64>,
}

/// A condensed program with its factors.
struct Condensed<'a> {
    qp: &'a Qp,
    factor: &'a [f64],
    offset: &'a [f64],
    normals: &'a mut Vec<f64>,
    columns: &'a [f64],
}

impl DenseActiveSet {
    /// Steps of the last solve.
    #[cfg(test)]
    pub(crate) fn iterations(&self) -> u32 {
        self.method.iterations
    }

    /// Solves `qp` from the multipliers and states in `solution`, where those fit its size, and overwrites them.
    ///
    /// False where H is not positive definite, L2 is 0, or the steps do not end.
    pub(crate) fn solve(&mut self, qp: &Qp, solution: &mut QpSolution) -> bool {
        let count = qp.variables();
        if !cholesky(&qp.hessian, count, &mut self.factor) {
            return false;
        }
        fill(&mut self.offset, qp.gradient.iter().copied());
        forward(&self.factor, count, &mut self.offset);
        let rows = qp.row_count();
        self.columns.clear();
        for column in 0..count {
            self.columns.extend((0..rows).map(|row| qp.rows[row * count + column]));
        }
        let Self { method, factor, offset, normals, columns } = self;
        method.solve_program(&mut Condensed { qp, factor, offset, normals, columns }, solution)
    }
}

impl Condensed<'_> {
    fn normal(&self, position: usize) -> &[f64] {
        let count = self.qp.variables();
        &self.normals[position * count..(position + 1) * count]
    }
}

impl Program for Condensed<'_> {
    fn size(&self) -> (usize, usize) {
        (self.qp.variables(), self.qp.row_count())
    }

    fn range(&self, what: Constraint) -> [f64; 2] {
        match what {
            Constraint::Bound(index) => [self.qp.lower[index], self.qp.upper[index]],
            Constraint::Row(row) => self.qp.limits(row),
        }
    }

    fn penalty(&self) -> (f64, f64) {
        (self.qp.slack_linear, self.qp.slack_quadratic)
    }

    fn clear(&mut self) {
        let count = self.qp.variables();
        self.normals.clear();
        self.normals.reserve((2 * count + 8) * count);
    }

    fn join(&mut self, what: Constraint, sign: f64) {
        let count = self.qp.variables();
        let start = self.normals.len();
        match what {
            Constraint::Bound(index) => {
                self.normals.resize(start + count, 0.0);
                self.normals[start + index] = sign;
                // Entries before `index` stay zero.
                for row in index..count {
                    let line = &self.factor[row * count + index..row * count + row];
                    let known = &self.normals[start + index..start + row];
                    let value = self.normals[start + row] - dot(line, known);
                    self.normals[start + row] = value / self.factor[row * count + row];
                }
            }
            Constraint::Row(row) => {
                self.normals.extend(self.qp.row(row).iter().map(|entry| sign * entry));
                forward(self.factor, count, &mut self.normals[start..]);
            }
        }
    }

    fn leave(&mut self, position: usize) {
        let count = self.qp.variables();
        self.normals.copy_within((position + 1) * count.., position * count);
        self.normals.truncate(self.normals.len() - count);
    }

    fn product(&self, left: usize, right: usize) -> f64 {
        dot(self.normal(left), self.normal(right))
    }

    fn offset(&self, position: usize) -> f64 {
        dot(self.normal(position), self.offset)
    }

    fn primal(&mut self, multipliers: impl Iterator<Item = f64>, step: &mut Vec<f64>) {
        fill(step, self.offset.iter().map(|value| -value));
        for (position, multiplier) in multipliers.enumerate() {
            for (value, entry) in step.iter_mut().zip(self.normal(position)) {
                *value -= multiplier * entry;
            }
        }
        backward(self.factor, self.qp.variables(), step);
    }

    fn values(&self, step: &[f64], values: &mut Vec<f64>) {
        let rows = self.qp.row_count();
        refill(values, rows, 0.0);
        for (index, factor) in step.iter().enumerate() {
            for (value, entry) in values.iter_mut().zip(&self.columns[index * rows..(index + 1) * rows]) {
                *value += entry * factor;
            }
        }
    }
}
