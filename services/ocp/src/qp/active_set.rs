//! The quadratic program by a dual active-set method that starts from the multipliers of the program before.
//!
//! The dual is maximised over the multipliers. A soft row has a multiplier between 0 and L1 while it is held at a
//! limit, and L1 + 2 L2 s beyond it; so the dual is piecewise quadratic, and a working constraint reads `a' v - d *
//! multiplier = b` with (d, b) = (0, limit) at a limit and (1 / (2 L2), limit - L1 / (2 L2)) beyond it. With H = L
//! L', y = L' v and m = L^-1 a, the multipliers of a working set solve `(M M' + D) multipliers = -(b + M f)`. From
//! dual feasible multipliers the method walks towards that solution; a multiplier that meets the end of its range on
//! the way changes its state (it leaves, or goes beyond its limit, or returns to it), else the most violated
//! constraint joins. Each step raises the dual, so sets do not repeat. Any multipliers of the right sign are a start:
//! where the active set has not changed, one solve is enough.
//!
//! Dependent working sets, which overlapping ellipses make, have a direction along which the multipliers move without
//! moving v; it is followed to the first end of a range. Soft rows always have one.
//!
//! Needs a positive definite H and L2 > 0. The caller checks the answer by its optimality conditions.

use super::{BoundState, Qp, QpSolution, RowState};
use crate::dense::{backward, cholesky, dot, fill, forward, refill};

/// The method with its buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct ActiveSet {
    factor: Vec<f64>,
    /// f = L^-1 c.
    offset: Vec<f64>,
    working: Vec<Working>,
    /// m of the working constraints, row by row.
    normals: Vec<f64>,
    /// Lower triangular factor of M M' + D, rows of `stride`.
    gram: Vec<f64>,
    stride: usize,
    /// Rows of `gram` that are up to date.
    fresh: usize,
    direction: Vec<f64>,
    in_bounds: Vec<bool>,
    in_rows: Vec<bool>,
    iterations: u32,
}

/// One constraint of the working set, written as `sign * a' v <= sign * limit`.
#[derive(Debug, Clone, Copy)]
struct Working {
    what: Constraint,
    sign: f64,
    multiplier: f64,
    /// A soft row beyond its limit.
    beyond: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Constraint {
    Bound(usize),
    Row(usize),
}

/// Outcome of bringing the factor of the working set up to date.
enum Factored {
    Regular,
    /// The constraint at this position depends on those before it.
    Dependent(usize),
}

impl ActiveSet {
    /// Steps of the last solve.
    #[cfg(test)]
    pub(crate) fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Solves `qp` from the multipliers and states in `solution`, where those fit its size, and overwrites them.
    ///
    /// False where H is not positive definite, L2 is 0, or the steps do not end.
    pub(crate) fn solve(&mut self, qp: &Qp, solution: &mut QpSolution) -> bool {
        let count = qp.variables();
        if qp.slack_quadratic <= 0.0 || !cholesky(&qp.hessian, count, &mut self.factor) {
            return false;
        }
        fill(&mut self.offset, qp.gradient.iter().copied());
        forward(&self.factor, count, &mut self.offset);
        self.start(qp, solution);
        // One step per changed constraint is usual; ten times all constraints indicates rounding errors.
        let limit = 10 * (count + qp.row_count()) as u32;
        self.iterations = 0;
        while self.iterations < limit {
            self.iterations += 1;
            if !self.maximise(qp) {
                continue;
            }
            self.primal(qp, solution);
            let Some(joining) = self.max_violated(qp, &solution.step) else {
                self.report(qp, solution);
                return solution.step.iter().chain(&solution.row_multipliers).all(|value| value.is_finite());
            };
            self.join(qp, joining);
        }
        false
    }

    /// Starts the working set with the constraints that are active in `solution`.
    fn start(&mut self, qp: &Qp, solution: &QpSolution) {
        let count = qp.variables();
        self.working.clear();
        self.normals.clear();
        self.fresh = 0;
        self.stride = 2 * count + 8;
        // Working sets beyond this size are rare, and may allocate.
        self.working.reserve(self.stride);
        self.normals.reserve(self.stride * count);
        self.gram.resize(self.stride * self.stride, 0.0);
        self.direction.reserve(self.stride);
        refill(&mut self.in_bounds, count, false);
        refill(&mut self.in_rows, qp.row_count(), false);
        if solution.bound_states.len() == count && solution.bound_multipliers.len() == count {
            for (index, state) in solution.bound_states.iter().enumerate() {
                let sign = match state {
                    BoundState::Free => continue,
                    BoundState::Lower => -1.0,
                    BoundState::Upper => 1.0,
                };
                let multiplier = (sign * solution.bound_multipliers[index]).max(0.0);
                let what = Constraint::Bound(index);
                self.join(qp, Working { what, sign, multiplier, beyond: false });
            }
        }
        if solution.row_states.len() == qp.row_count() && solution.row_multipliers.len() == qp.row_count() {
            for (row, state) in solution.row_states.iter().enumerate() {
                let (sign, beyond) = match state {
                    RowState::Inside => continue,
                    RowState::AtLower => (-1.0, false),
                    RowState::AtUpper => (1.0, false),
                    RowState::BeyondLower => (-1.0, true),
                    RowState::BeyondUpper => (1.0, true),
                };
                let value = (sign * solution.row_multipliers[row]).max(0.0);
                let multiplier = if beyond { value.max(qp.slack_linear) } else { value.min(qp.slack_linear) };
                self.join(qp, Working { what: Constraint::Row(row), sign, multiplier, beyond });
            }
        }
    }

    /// Adds a constraint to the working set.
    fn join(&mut self, qp: &Qp, joining: Working) {
        let count = qp.variables();
        let start = self.normals.len();
        match joining.what {
            Constraint::Bound(index) => {
                self.in_bounds[index] = true;
                self.normals.resize(start + count, 0.0);
                self.normals[start + index] = joining.sign;
                // Entries before `index` stay zero.
                for row in index..count {
                    let line = &self.factor[row * count + index..row * count + row];
                    let known = &self.normals[start + index..start + row];
                    let value = self.normals[start + row] - dot(line, known);
                    self.normals[start + row] = value / self.factor[row * count + row];
                }
            }
            Constraint::Row(row) => {
                self.in_rows[row] = true;
                self.normals.extend(qp.row(row).iter().map(|entry| joining.sign * entry));
                forward(&self.factor, count, &mut self.normals[start..]);
            }
        }
        self.working.push(joining);
    }

    /// Removes the constraint at `position`.
    fn leave(&mut self, count: usize, position: usize) {
        match self.working.remove(position).what {
            Constraint::Bound(index) => self.in_bounds[index] = false,
            Constraint::Row(row) => self.in_rows[row] = false,
        }
        self.normals.copy_within((position + 1) * count.., position * count);
        self.normals.truncate(self.working.len() * count);
        self.fresh = self.fresh.min(position);
    }

    /// Moves the multipliers to the maximum of the dual on the working set; false where one met the end of its range
    /// on the way and has changed its state.
    fn maximise(&mut self, qp: &Qp) -> bool {
        let size = self.working.len();
        let (length, dependent) = match self.factorise(qp) {
            Factored::Regular => {
                self.solve_target(qp);
                for (direction, working) in self.direction.iter_mut().zip(&self.working) {
                    *direction -= working.multiplier;
                }
                (1.0, false)
            }
            Factored::Dependent(position) => {
                self.null_direction(qp, position);
                (f64::INFINITY, true)
            }
        };
        let mut length = length;
        let mut blocking = None;
        for (position, working) in self.working.iter().enumerate() {
            let change = self.direction[position];
            let (low, high) = match working.what {
                Constraint::Bound(_) => (0.0, f64::INFINITY),
                Constraint::Row(_) if working.beyond => (qp.slack_linear, f64::INFINITY),
                Constraint::Row(_) => (0.0, qp.slack_linear),
            };
            let room = if change < 0.0 { low - working.multiplier } else { high - working.multiplier };
            // A change of rounding size is none.
            if change.abs() > 1e-14 * (1.0 + working.multiplier) && room.is_finite() {
                let reach = (room / change).max(0.0);
                if reach < length {
                    length = reach;
                    blocking = Some((position, change < 0.0));
                }
            }
        }
        if length.is_infinite() {
            // Only rounding can make a dependent set of hard bounds; dropping the newest is safe.
            self.leave(qp.variables(), size - 1);
            return false;
        }
        for (working, change) in self.working.iter_mut().zip(&self.direction) {
            working.multiplier += length * change;
        }
        let Some((position, falling)) = blocking else { return !dependent };
        let working = &mut self.working[position];
        match (working.what, working.beyond, falling) {
            (Constraint::Row(_), true, true) => {
                working.beyond = false;
                working.multiplier = qp.slack_linear;
                self.fresh = self.fresh.min(position);
            }
            (Constraint::Row(_), false, false) => {
                working.beyond = true;
                working.multiplier = qp.slack_linear;
                self.fresh = self.fresh.min(position);
            }
            _ => self.leave(qp.variables(), position),
        }
        false
    }

    /// Brings the factor of M M' + D up to date.
    fn factorise(&mut self, qp: &Qp) -> Factored {
        /// A pivot below this share of the diagonal entry means dependence.
        const MIN_PIVOT: f64 = 1e-11;
        let count = qp.variables();
        let size = self.working.len();
        if size > self.stride {
            self.stride = 2 * size;
            self.fresh = 0;
        }
        if self.gram.len() < self.stride * size {
            self.gram.resize(self.stride * size, 0.0);
        }
        for row in self.fresh..size {
            let normal = &self.normals[row * count..(row + 1) * count];
            for column in 0..=row {
                let other = &self.normals[column * count..(column + 1) * count];
                let entry = dot(normal, other);
                let (before, here) = self.gram.split_at_mut(row * self.stride);
                if column < row {
                    let line = &before[column * self.stride..][..=column];
                    here[column] = (entry - dot(&here[..column], &line[..column])) / line[column];
                } else {
                    let entry = entry + softness(qp, &self.working[row]);
                    let pivot = entry - dot(&here[..column], &here[..column]);
                    if pivot <= MIN_PIVOT * entry {
                        self.fresh = row;
                        return Factored::Dependent(row);
                    }
                    here[column] = pivot.sqrt();
                }
            }
        }
        self.fresh = size;
        Factored::Regular
    }

    /// b + M f of a working constraint.
    fn gap(&self, qp: &Qp, position: usize) -> f64 {
        let count = qp.variables();
        let working = &self.working[position];
        let limit = match working.what {
            Constraint::Bound(index) if working.sign > 0.0 => qp.upper[index],
            Constraint::Bound(index) => qp.lower[index],
            Constraint::Row(row) if working.sign > 0.0 => qp.row_upper[row],
            Constraint::Row(row) => qp.row_lower[row],
        };
        let shift = if working.beyond { qp.slack_linear / (2.0 * qp.slack_quadratic) } else { 0.0 };
        working.sign * limit - shift
            + dot(&self.normals[position * count..(position + 1) * count], &self.offset)
    }

    /// The maximiser on the working set, into `direction`.
    fn solve_target(&mut self, qp: &Qp) {
        let size = self.working.len();
        self.direction.clear();
        for position in 0..size {
            let gap = self.gap(qp, position);
            self.direction.push(-gap);
        }
        for row in 0..size {
            let line = &self.gram[row * self.stride..][..=row];
            self.direction[row] =
                (self.direction[row] - dot(&line[..row], &self.direction[..row])) / line[row];
        }
        self.back_substitute(size);
    }

    /// A direction that leaves v where it is, along which the dual does not fall.
    fn null_direction(&mut self, qp: &Qp, position: usize) {
        let line = &self.gram[position * self.stride..][..position];
        fill(&mut self.direction, line.iter().map(|entry| -entry));
        self.back_substitute(position);
        self.direction.push(1.0);
        let slope: f64 =
            -(0..=position).map(|place| self.direction[place] * self.gap(qp, place)).sum::<f64>();
        if slope < 0.0 {
            for direction in &mut self.direction {
                *direction = -*direction;
            }
        }
        self.direction.resize(self.working.len(), 0.0);
    }

    fn back_substitute(&mut self, size: usize) {
        for row in (0..size).rev() {
            let line = &self.gram[row * self.stride..][..=row];
            self.direction[row] /= line[row];
            let value = self.direction[row];
            for (target, entry) in self.direction[..row].iter_mut().zip(line) {
                *target -= value * entry;
            }
        }
    }

    /// v of the present multipliers.
    fn primal(&mut self, qp: &Qp, solution: &mut QpSolution) {
        let count = qp.variables();
        fill(&mut solution.step, self.offset.iter().map(|value| -value));
        for (position, working) in self.working.iter().enumerate() {
            let normal = &self.normals[position * count..(position + 1) * count];
            for (value, entry) in solution.step.iter_mut().zip(normal) {
                *value -= working.multiplier * entry;
            }
        }
        backward(&self.factor, count, &mut solution.step);
        // Removes rounding errors of variables that are held at a bound.
        for working in &self.working {
            if let Constraint::Bound(index) = working.what {
                solution.step[index] = if working.sign > 0.0 { qp.upper[index] } else { qp.lower[index] };
            }
        }
    }

    /// The constraint outside the working set that `step` violates most.
    fn max_violated(&self, qp: &Qp, step: &[f64]) -> Option<Working> {
        /// Ten thousand times finer than what the optimisation is asked for.
        const TOLERANCE: f64 = 1e-10;
        let mut worst = TOLERANCE;
        let mut found = None;
        let mut consider = |what: Constraint, below: f64, above: f64| {
            if above > worst || below > worst {
                let sign = if above > below { 1.0 } else { -1.0 };
                worst = above.max(below);
                found = Some(Working { what, sign, multiplier: 0.0, beyond: false });
            }
        };
        for (index, &value) in step.iter().enumerate() {
            if !self.in_bounds[index] {
                consider(Constraint::Bound(index), qp.lower[index] - value, value - qp.upper[index]);
            }
        }
        for row in 0..qp.row_count() {
            if !self.in_rows[row] {
                let value = dot(qp.row(row), step);
                consider(Constraint::Row(row), qp.row_lower[row] - value, value - qp.row_upper[row]);
            }
        }
        found
    }

    fn report(&self, qp: &Qp, solution: &mut QpSolution) {
        solution.release(qp.variables(), qp.row_count());
        for working in &self.working {
            let upper = working.sign > 0.0;
            match working.what {
                Constraint::Bound(index) => {
                    solution.bound_multipliers[index] = working.sign * working.multiplier;
                    solution.bound_states[index] = BoundState::at(upper);
                }
                Constraint::Row(row) => {
                    solution.row_multipliers[row] = working.sign * working.multiplier;
                    solution.row_states[row] = RowState::held(upper, working.beyond);
                }
            }
        }
    }
}

/// d of a working constraint.
fn softness(qp: &Qp, working: &Working) -> f64 {
    if working.beyond { 1.0 / (2.0 * qp.slack_quadratic) } else { 0.0 }
}

#[cfg(test)]
mod tests;
