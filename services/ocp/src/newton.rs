//! A Newton step of the nonlinear program on the constraints that its quadratic program found active.
//!
//! The quadratic program finds the active set. Its Gauss-Newton Hessian is always convex but lacks the curvature of
//! the model and of the ellipses, so alone it converges linearly, or oscillates. Here controls at their bounds are
//! fixed, limits that are kept become equations, and limits that are exceeded become quadratic penalties. The exact
//! Hessian then gives quadratic convergence where it is positive definite on the remaining space. Elsewhere there is
//! no step, and the caller uses that of the quadratic program.

use crate::dense::{backward, cholesky, dot, fill, forward, refill, solve_factored};
use crate::qp::{BoundState, Qp, QpSolution, RowState};
use crate::walk::{Met, Walk};

/// Buffers of the step.
#[derive(Debug, Clone, Default)]
pub(crate) struct Newton {
    /// The exact Hessian, both triangles.
    pub hessian: Vec<f64>,
    /// The step and its multipliers, after [`Newton::solve`] has returned true.
    pub solution: QpSolution,
    free: Vec<usize>,
    equations: Vec<usize>,
    matrix: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    columns: Vec<f64>,
    schur: Vec<f64>,
    schur_factor: Vec<f64>,
    multipliers: Vec<f64>,
}

impl Newton {
    /// The step on the active set of `answer`; false where the exact Hessian is not positive definite there.
    ///
    /// With `shift` it is made so, for iterations that would otherwise be slow along a direction of negative
    /// curvature. A constraint that is met on the way from the step of the quadratic program joins the active set.
    pub(crate) fn solve(&mut self, qp: &Qp, answer: &QpSolution, shift: bool) -> bool {
        /// How many constraints may join; with more, the quadratic program is too far from the step.
        const JOINING: usize = 4;
        self.solution.copy_from(answer);
        self.reserve(qp.variables());
        for round in 0..=JOINING {
            self.select(qp);
            if !self.solve_selected(qp, shift) {
                if round == 0 {
                    return false;
                }
                // The part walked so far is a valid step, which cannot be corrected.
                self.equations.clear();
                break;
            }
            if !self.walk(qp) {
                break;
            }
        }
        self.report(qp);
        self.solution.step.iter().all(|value| value.is_finite())
    }

    /// Makes room for as many equations as there are variables, so that later calls allocate nothing.
    fn reserve(&mut self, variables: usize) {
        let Self { matrix, factor, columns, schur, schur_factor, right, multipliers, .. } = self;
        for buffer in [matrix, factor, columns, schur, schur_factor] {
            buffer.clear();
            buffer.reserve(variables * variables);
        }
        for buffer in [right, multipliers] {
            buffer.clear();
            buffer.reserve(variables);
        }
        self.equations.clear();
        self.equations.reserve(2 * variables);
    }

    /// Solves for the free variables with the selected rows as equations; false where that has no unique minimum.
    fn solve_selected(&mut self, qp: &Qp, shift: bool) -> bool {
        if self.free.is_empty() || self.equations.len() > self.free.len() {
            return false;
        }
        self.assemble(qp);
        self.factorise(qp, shift) && self.solve_equations(qp)
    }

    /// The multipliers of fixed variables that make the step stationary, and zero for free ones.
    pub(crate) fn fill_bound_multipliers(&mut self, qp: &Qp) {
        let count = qp.variables();
        for index in 0..count {
            let mut sum = qp.gradient[index]
                + dot(&self.hessian[index * count..(index + 1) * count], &self.solution.step);
            for row in 0..qp.row_count() {
                sum += self.solution.row_multipliers[row] * qp.row(row)[index];
            }
            let free = self.solution.bound_states[index] == BoundState::Free;
            self.solution.bound_multipliers[index] = if free { 0.0 } else { -sum };
        }
    }

    /// Free variables and rows held at a limit.
    fn select(&mut self, qp: &Qp) {
        let solution = &self.solution;
        fill(
            &mut self.free,
            (0..qp.variables()).filter(|&index| solution.bound_states[index] == BoundState::Free),
        );
        fill(
            &mut self.equations,
            (0..qp.row_count())
                .filter(|&row| matches!(solution.row_states[row], RowState::AtLower | RowState::AtUpper)),
        );
    }

    /// Rows that the step holds at a limit.
    pub(crate) fn equations(&self) -> &[usize] {
        &self.equations
    }

    /// Second-order correction: moves the step so that the rows it holds, which the curvature has left by `excesses`
    /// beyond the upper or before the lower limit, return to their limits. False where that is not within the bounds.
    ///
    /// Without it a good step is refused near the solution, because the penalty sees the excess and not the gain.
    pub(crate) fn correct(&mut self, qp: &Qp, excesses: &[f64]) -> bool {
        let size = self.free.len();
        let equations = self.equations.len();
        fill(&mut self.multipliers, excesses.iter().copied());
        solve_factored(&self.schur_factor, equations, &mut self.multipliers);
        refill(&mut self.right, size, 0.0);
        for (position, multiplier) in self.multipliers.iter().enumerate() {
            let column = &self.columns[position * size..(position + 1) * size];
            for (value, entry) in self.right.iter_mut().zip(column) {
                *value -= multiplier * entry;
            }
        }
        backward(&self.factor, size, &mut self.right);
        let mut inside = true;
        for (&index, change) in self.free.iter().zip(&self.right) {
            let value = &mut self.solution.step[index];
            *value += change;
            inside &= *value >= qp.lower[index] && *value <= qp.upper[index];
        }
        inside
    }

    /// Matrix and right-hand side in the free variables.
    fn assemble(&mut self, qp: &Qp) {
        let answer = &self.solution;
        let count = qp.variables();
        let size = self.free.len();
        self.matrix.clear();
        self.right.clear();
        for &row in &self.free {
            let line = &self.hessian[row * count..(row + 1) * count];
            self.matrix.extend(self.free.iter().map(|&column| line[column]));
            let fixed: f64 = (0..count)
                .filter(|&column| answer.bound_states[column] != BoundState::Free)
                .map(|column| line[column] * answer.step[column])
                .sum();
            self.right.push(-qp.gradient[row] - fixed);
        }
        for row in 0..qp.row_count() {
            let Some((sign, limit)) = answer.row_states[row].beyond(qp.limits(row)) else { continue };
            let line = qp.row(row);
            let excess = fixed_part(line, answer) - limit;
            let bend = 2.0 * qp.slack_quadratic;
            let slope = sign * qp.slack_linear + bend * excess;
            for (position, &index) in self.free.iter().enumerate() {
                self.right[position] -= slope * line[index];
                for (other, &column) in self.free.iter().enumerate() {
                    self.matrix[position * size + other] += bend * line[index] * line[column];
                }
            }
        }
        // Squares of the equations change nothing where they hold, and make the matrix positive definite when it is so
        // on their null space. Ten times the largest diagonal entry is enough unless it nearly is not.
        let largest = (0..size).map(|index| self.matrix[index * size + index].abs()).fold(0.0, f64::max);
        for &row in &self.equations {
            let line = qp.row(row);
            let square: f64 = self.free.iter().map(|&index| line[index] * line[index]).sum();
            if square <= 0.0 {
                continue;
            }
            let weight = 10.0 * largest / square;
            let target = limit_of(qp, answer, row) - fixed_part(line, answer);
            for (position, &index) in self.free.iter().enumerate() {
                self.right[position] += weight * target * line[index];
                for (other, &column) in self.free.iter().enumerate() {
                    self.matrix[position * size + other] += weight * line[index] * line[column];
                }
            }
        }
    }

    /// Factorises the matrix, after adding as much of the Gauss-Newton diagonal as makes it positive definite.
    ///
    /// Without that, iterations near a saddle point would be slow.
    fn factorise(&mut self, qp: &Qp, shift: bool) -> bool {
        /// Shares of the diagonal that are added one after the other.
        const SHARES: [f64; 4] = [0.0, 0.03, 0.3, 3.0];
        let (count, size) = (qp.variables(), self.free.len());
        SHARES[..if shift { SHARES.len() } else { 1 }].iter().any(|share| {
            for (position, &index) in self.free.iter().enumerate() {
                self.matrix[position * size + position] += share * qp.hessian[index * count + index];
            }
            cholesky(&self.matrix, size, &mut self.factor)
        })
    }

    /// Solves for the free variables, into `right`, and the multipliers of the equations.
    fn solve_equations(&mut self, qp: &Qp) -> bool {
        let answer = &self.solution;
        let size = self.free.len();
        let equations = self.equations.len();
        forward(&self.factor, size, &mut self.right);
        self.columns.clear();
        for &row in &self.equations {
            let line = qp.row(row);
            let start = self.columns.len();
            self.columns.extend(self.free.iter().map(|&index| line[index]));
            forward(&self.factor, size, &mut self.columns[start..]);
        }
        self.schur.clear();
        self.multipliers.clear();
        for (position, &row) in self.equations.iter().enumerate() {
            let column = &self.columns[position * size..(position + 1) * size];
            for other in 0..equations {
                self.schur.push(dot(column, &self.columns[other * size..(other + 1) * size]));
            }
            let target = limit_of(qp, answer, row) - fixed_part(qp.row(row), answer);
            self.multipliers.push(dot(column, &self.right) - target);
        }
        if equations > 0 {
            if !cholesky(&self.schur, equations, &mut self.schur_factor) {
                return false;
            }
            solve_factored(&self.schur_factor, equations, &mut self.multipliers);
        }
        for (position, multiplier) in self.multipliers.iter().enumerate() {
            let column = &self.columns[position * size..(position + 1) * size];
            for (value, entry) in self.right.iter_mut().zip(column) {
                *value -= multiplier * entry;
            }
        }
        backward(&self.factor, size, &mut self.right);
        true
    }

    /// Moves the step towards the solution for the free variables, to the first constraint on the way, which joins;
    /// whether one did.
    fn walk(&mut self, qp: &Qp) -> bool {
        let mut walk = Walk::whole();
        let solution = &self.solution;
        for (&index, &target) in self.free.iter().zip(&self.right) {
            let value = solution.step[index];
            walk.consider_bound(index, value, target - value, [qp.lower[index], qp.upper[index]]);
        }
        for row in 0..qp.row_count() {
            let line = qp.row(row);
            let value = dot(line, &solution.step);
            let change: f64 = self
                .free
                .iter()
                .zip(&self.right)
                .map(|(&index, target)| line[index] * (target - solution.step[index]))
                .sum();
            walk.consider_row(row, solution.row_states[row], value, change, qp.limits(row));
        }
        for (&index, &value) in self.free.iter().zip(&self.right) {
            let step = &mut self.solution.step[index];
            *step += walk.fraction * (value - *step);
        }
        match walk.met {
            Some(Met::Bound(index, state)) => {
                self.solution.bound_states[index] = state;
                self.solution.step[index] =
                    if state == BoundState::Upper { qp.upper[index] } else { qp.lower[index] };
            }
            Some(Met::Row(row, state)) => self.solution.row_states[row] = state,
            None => {}
        }
        walk.met.is_some()
    }

    /// Fills the multipliers of the rows.
    fn report(&mut self, qp: &Qp) {
        for (&row, &value) in self.equations.iter().zip(&self.multipliers) {
            self.solution.row_multipliers[row] = value;
        }
        for row in 0..qp.row_count() {
            let state = self.solution.row_states[row];
            if state == RowState::Inside {
                self.solution.row_multipliers[row] = 0.0;
            }
            let Some((sign, limit)) = state.beyond(qp.limits(row)) else { continue };
            let excess = dot(qp.row(row), &self.solution.step) - limit;
            self.solution.row_multipliers[row] = sign * qp.slack_linear + 2.0 * qp.slack_quadratic * excess;
        }
    }
}

/// The part of a row that belongs to fixed variables.
fn fixed_part(line: &[f64], solution: &QpSolution) -> f64 {
    line.iter()
        .zip(&solution.step)
        .zip(&solution.bound_states)
        .filter(|(_, state)| **state != BoundState::Free)
        .map(|((entry, value), _)| entry * value)
        .sum()
}

fn limit_of(qp: &Qp, answer: &QpSolution, row: usize) -> f64 {
    if answer.row_states[row] == RowState::AtLower { qp.row_lower[row] } else { qp.row_upper[row] }
}
