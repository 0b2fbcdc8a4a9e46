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
//! Needs a positive definite H and L2 > 0. The caller checks the answer by its optimality conditions. What it needs to
//! know of a program is a [`Program`]: the condensed one ([`dense`]), or the stages of a chain.

pub(crate) mod dense;

use super::{BoundState, QpSolution, RowState};
use crate::dense::{fill, refill};

/// A program of which the normals m of the working constraints can be had, each with the sign of its constraint.
pub(crate) trait Program {
    /// Numbers of variables and of rows.
    fn size(&self) -> (usize, usize);
    /// Lower and upper bound of a variable, or limit of a row.
    fn range(&self, what: Constraint) -> [f64; 2];
    /// L1 and L2.
    fn penalty(&self) -> (f64, f64);
    /// Forgets all normals.
    fn clear(&mut self);
    /// Adds the normal of a constraint behind the others.
    fn join(&mut self, what: Constraint, sign: f64);
    /// Removes the normal at `position`.
    fn leave(&mut self, position: usize);
    /// m' m of two of them.
    fn product(&self, left: usize, right: usize) -> f64;
    /// m' f of one.
    fn offset(&self, position: usize) -> f64;
    /// v = -H^-1 (c + sum of multipliers times constraints).
    fn primal(&mut self, multipliers: impl Iterator<Item = f64>, step: &mut Vec<f64>);
    /// The values of all rows at the last v, which is `step`.
    fn values(&self, step: &[f64], values: &mut Vec<f64>);
}

/// The method with its buffers.
#[derive(Debug, Clone, Default)]
pub(crate) struct ActiveSet {
    working: Vec<Working>,
    /// m' f of the working constraints.
    offsets: Vec<f64>,
    /// M M', the lower triangle row by row.
    products: Vec<f64>,
    /// Lower triangular factor of M M' + D, rows of `stride`; and the same by columns, so that sums over many rows are
    /// made at once, each in its order.
    gram: Vec<f64>,
    columns: Vec<f64>,
    sums: Vec<f64>,
    stride: usize,
    /// Rows of `gram` that are up to date.
    fresh: usize,
    direction: Vec<f64>,
    values: Vec<f64>,
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

impl Working {
    /// The limit that it is held at or beyond.
    fn limit(&self, program: &impl Program) -> f64 {
        let [lower, upper] = program.range(self.what);
        if self.sign > 0.0 { upper } else { lower }
    }
}

/// A constraint of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Constraint {
    /// The bounds of a variable.
    Bound(usize),
    /// The limits of a row.
    Row(usize),
}

/// Outcome of bringing the factor of the working set up to date.
enum Factored {
    Regular,
    /// The constraint at this position depends on those before it.
    Dependent(usize),
}

impl ActiveSet {
    /// Solves a program from the multipliers and states in `solution`, where those fit its size, and overwrites them.
    ///
    /// False where L2 is 0, or the steps do not end.
    pub(crate) fn solve_program(&mut self, program: &mut impl Program, solution: &mut QpSolution) -> bool {
        if program.penalty().1 <= 0.0 {
            return false;
        }
        self.start(program, solution);
        let (count, rows) = program.size();
        // One step per changed constraint is usual; ten times all constraints indicates rounding errors.
        let limit = 10 * (count + rows) as u32;
        self.iterations = 0;
        while self.iterations < limit {
            self.iterations += 1;
            if !self.maximise(program) {
                continue;
            }
            self.primal(program, solution);
            let Some(joining) = self.max_violated(program, &solution.step) else {
                self.report(program, solution);
                return solution.step.iter().chain(&solution.row_multipliers).all(|value| value.is_finite());
            };
            self.join(program, joining);
        }
        false
    }

    /// Starts the working set with the constraints that are active in `solution`.
    fn start(&mut self, program: &mut impl Program, solution: &QpSolution) {
        let (count, rows) = program.size();
        let (linear, _) = program.penalty();
        self.working.clear();
        self.offsets.clear();
        self.products.clear();
        program.clear();
        self.fresh = 0;
        self.stride = 2 * count + 8;
        // Working sets beyond this size are rare, and may allocate.
        self.working.reserve(self.stride);
        self.offsets.reserve(self.stride);
        self.products.reserve(self.stride * (self.stride + 1) / 2);
        self.gram.resize(self.stride * self.stride, 0.0);
        self.columns.resize(self.stride * self.stride, 0.0);
        self.sums.reserve(self.stride);
        self.direction.reserve(self.stride);
        refill(&mut self.in_bounds, count, false);
        refill(&mut self.in_rows, rows, false);
        if solution.bound_states.len() == count && solution.bound_multipliers.len() == count {
            for (index, state) in solution.bound_states.iter().enumerate() {
                let sign = match state {
                    BoundState::Free => continue,
                    BoundState::Lower => -1.0,
                    BoundState::Upper => 1.0,
                };
                let multiplier = (sign * solution.bound_multipliers[index]).max(0.0);
                let what = Constraint::Bound(index);
                self.join(program, Working { what, sign, multiplier, beyond: false });
            }
        }
        if solution.row_states.len() == rows && solution.row_multipliers.len() == rows {
            for (row, state) in solution.row_states.iter().enumerate() {
                let (sign, beyond) = match state {
                    RowState::Inside => continue,
                    RowState::AtLower => (-1.0, false),
                    RowState::AtUpper => (1.0, false),
                    RowState::BeyondLower => (-1.0, true),
                    RowState::BeyondUpper => (1.0, true),
                };
                let value = (sign * solution.row_multipliers[row]).max(0.0);
                let multiplier = if beyond { value.max(linear) } else { value.min(linear) };
                self.join(program, Working { what: Constraint::Row(row), sign, multiplier, beyond });
            }
        }
    }

    /// Adds a constraint to the working set.
    fn join(&mut self, program: &mut impl Program, joining: Working) {
        match joining.what {
            Constraint::Bound(index) => self.in_bounds[index] = true,
            Constraint::Row(row) => self.in_rows[row] = true,
        }
        program.join(joining.what, joining.sign);
        self.working.push(joining);
        let last = self.working.len() - 1;
        self.offsets.push(program.offset(last));
        self.products.extend((0..=last).map(|other| program.product(last, other)));
    }

    /// Removes the constraint at `position`.
    fn leave(&mut self, program: &mut impl Program, position: usize) {
        match self.working.remove(position).what {
            Constraint::Bound(index) => self.in_bounds[index] = false,
            Constraint::Row(row) => self.in_rows[row] = false,
        }
        program.leave(position);
        self.offsets.remove(position);
        let (mut read, mut write) = (0, 0);
        for row in 0..=self.working.len() {
            for column in 0..=row {
                if row != position && column != position {
                    self.products[write] = self.products[read];
                    write += 1;
                }
                read += 1;
            }
        }
        self.products.truncate(write);
        self.fresh = self.fresh.min(position);
    }

    /// Moves the multipliers to the maximum of the dual on the working set; false where one met the end of its range
    /// on the way and has changed its state.
    fn maximise(&mut self, program: &mut impl Program) -> bool {
        let size = self.working.len();
        let (linear, _) = program.penalty();
        let (length, dependent) = match self.factorise(program) {
            Factored::Regular => {
                self.solve_target(program);
                for (direction, working) in self.direction.iter_mut().zip(&self.working) {
                    *direction -= working.multiplier;
                }
                (1.0, false)
            }
            Factored::Dependent(position) => {
                self.null_direction(program, position);
                (f64::INFINITY, true)
            }
        };
        let mut length = length;
        let mut blocking = None;
        for (position, working) in self.working.iter().enumerate() {
            let change = self.direction[position];
            let (low, high) = match working.what {
                Constraint::Bound(_) => (0.0, f64::INFINITY),
                Constraint::Row(_) if working.beyond => (linear, f64::INFINITY),
                Constraint::Row(_) => (0.0, linear),
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
            self.leave(program, size - 1);
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
                working.multiplier = linear;
                self.fresh = self.fresh.min(position);
            }
            (Constraint::Row(_), false, false) => {
                working.beyond = true;
                working.multiplier = linear;
                self.fresh = self.fresh.min(position);
            }
            _ => self.leave(program, position),
        }
        false
    }

    /// Brings the factor of M M' + D up to date.
    fn factorise(&mut self, program: &impl Program) -> Factored {
        /// A pivot below this share of the diagonal entry means dependence.
        const MIN_PIVOT: f64 = 1e-11;
        let size = self.working.len();
        if size > self.stride {
            self.stride = 2 * size;
            self.fresh = 0;
        }
        for factor in [&mut self.gram, &mut self.columns] {
            if factor.len() < self.stride * size {
                factor.resize(self.stride * size, 0.0);
            }
        }
        for row in self.fresh..size {
            let products = &self.products[row * (row + 1) / 2..][..=row];
            let here = &mut self.gram[row * self.stride..][..=row];
            refill(&mut self.sums, row + 1, 0.0);
            for column in 0..row {
                let factor = &self.columns[column * self.stride..][column..row];
                let value = (products[column] - self.sums[column]) / factor[0];
                here[column] = value;
                for (sum, entry) in self.sums[column + 1..row].iter_mut().zip(&factor[1..]) {
                    *sum += value * entry;
                }
                self.sums[row] += value * value;
            }
            let entry = products[row] + softness(program, &self.working[row]);
            let pivot = entry - self.sums[row];
            if pivot <= MIN_PIVOT * entry {
                self.fresh = row;
                return Factored::Dependent(row);
            }
            here[row] = pivot.sqrt();
            for (column, value) in here.iter().enumerate() {
                self.columns[column * self.stride + row] = *value;
            }
        }
        self.fresh = size;
        Factored::Regular
    }

    /// b + M f of a working constraint.
    fn gap(&self, program: &impl Program, position: usize) -> f64 {
        let working = &self.working[position];
        let (linear, quadratic) = program.penalty();
        let shift = if working.beyond { linear / (2.0 * quadratic) } else { 0.0 };
        working.sign * working.limit(program) - shift + self.offsets[position]
    }

    /// The maximiser on the working set, into `direction`.
    fn solve_target(&mut self, program: &impl Program) {
        let size = self.working.len();
        self.direction.clear();
        for position in 0..size {
            let gap = self.gap(program, position);
            self.direction.push(-gap);
        }
        refill(&mut self.sums, size, 0.0);
        for row in 0..size {
            let factor = &self.columns[row * self.stride..][row..size];
            let value = (self.direction[row] - self.sums[row]) / factor[0];
            self.direction[row] = value;
            for (sum, entry) in self.sums[row + 1..].iter_mut().zip(&factor[1..]) {
                *sum += entry * value;
            }
        }
        self.back_substitute(size);
    }

    /// A direction that leaves v where it is, along which the dual does not fall.
    fn null_direction(&mut self, program: &impl Program, position: usize) {
        let line = &self.gram[position * self.stride..][..position];
        fill(&mut self.direction, line.iter().map(|entry| -entry));
        self.back_substitute(position);
        self.direction.push(1.0);
        let slope: f64 =
            -(0..=position).map(|place| self.direction[place] * self.gap(program, place)).sum::<f64>();
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
    fn primal(&mut self, program: &mut impl Program, solution: &mut QpSolution) {
        program.primal(self.working.iter().map(|working| working.multiplier), &mut solution.step);
        // Removes rounding errors of variables that are held at a bound.
        for working in &self.working {
            if let Constraint::Bound(index) = working.what {
                solution.step[index] = working.limit(program);
            }
        }
    }

    /// The constraint outside the working set that `step` violates most.
    fn max_violated(&mut self, program: &impl Program, step: &[f64]) -> Option<Working> {
        /// Ten thousand times finer than what the optimisation is asked for.
        const TOLERANCE: f64 = 1e-10;
        let mut worst = TOLERANCE;
        let mut found = None;
        let mut consider = |what: Constraint, value: f64| {
            let [lower, upper] = program.range(what);
            let (below, above) = (lower - value, value - upper);
            if above > worst || below > worst {
                let sign = if above > below { 1.0 } else { -1.0 };
                worst = above.max(below);
                found = Some(Working { what, sign, multiplier: 0.0, beyond: false });
            }
        };
        for (index, &value) in step.iter().enumerate() {
            if !self.in_bounds[index] {
                consider(Constraint::Bound(index), value);
            }
        }
        program.values(step, &mut self.values);
        for (row, (is_working, value)) in self.in_rows.iter().zip(&self.values).enumerate() {
            if !is_working {
                consider(Constraint::Row(row), *value);
            }
        }
        found
    }

    fn report(&self, program: &impl Program, solution: &mut QpSolution) {
        let (count, rows) = program.size();
        solution.release(count, rows);
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
fn softness(program: &impl Program, working: &Working) -> f64 {
    if working.beyond { 1.0 / (2.0 * program.penalty().1) } else { 0.0 }
}

#[cfg(test)]
mod tests;
