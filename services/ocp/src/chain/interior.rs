//! The chain by a primal-dual interior-point method, used where the search for the active set cycles.
//!
//! Every finite bound and limit is a side with its distance and multiplier; a soft side also has its slack and the
//! multiplier of `slack >= 0`, which are eliminated, so that each iteration is one Riccati factorisation with two
//! right-hand sides (predictor and corrector). Sides start consistent and one step length serves all, so only the
//! stationarity of the controls is left to converge. The Hessian must be convex.

use super::{Chain, Path};
use crate::dense::refill;
use crate::hessian::Block;
use crate::qp::{BoundState, QpSolution, RowState};
use crate::shooting::Shooting;

/// The constraint of a side.
#[derive(Debug, Clone, Copy)]
enum Owner {
    Control(usize),
    Row(usize),
}

/// One inequality `sign * value <= sign * limit (+ slack)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Side {
    owner: Owner,
    sign: f64,
    /// Distance to the limit, and its multiplier.
    distance: f64,
    multiplier: f64,
    /// Slack of a soft side, and the multiplier of `slack >= 0`.
    slack: f64,
    relief: f64,
    /// Targets of the two products, less their second-order terms.
    targets: [f64; 2],
    /// Changes of slack and multiplier without a change of the value.
    still: [f64; 2],
    /// Changes of distance, multiplier, slack and relief.
    changes: [f64; 4],
    /// 1 / (relief + 2 L2 slack) of a soft side, and the reciprocal of what is left of the distance after the slack.
    inner: f64,
    outer: f64,
}

impl Side {
    /// Fills the factors of the elimination at the present values.
    fn prepare(&mut self, bend: f64) {
        self.inner = match self.owner {
            Owner::Control(_) => 0.0,
            Owner::Row(_) => 1.0 / (self.relief + bend * self.slack),
        };
        self.outer = 1.0 / (self.distance + self.multiplier * self.slack * self.inner);
    }

    /// The weight of the square of the value in the eliminated system.
    fn weight(&self) -> f64 {
        self.multiplier * self.outer
    }

    /// Linear term of the change of the value in the eliminated system; keeps the changes of slack and multiplier at a
    /// constant value.
    fn slope(&mut self) -> f64 {
        let slack = (self.targets[1] - self.slack * self.relief) * self.inner;
        let short = self.targets[0] - self.distance * self.multiplier;
        self.still = [slack, (short - self.multiplier * slack) * self.outer];
        self.sign * (self.multiplier + self.still[1])
    }

    /// Fills the changes for a change of the value.
    fn change(&mut self, bend: f64, change: f64) {
        let moved = self.sign * change;
        let multiplier = self.still[1] + self.weight() * moved;
        let slack = self.still[0] + self.slack * self.inner * multiplier;
        self.changes = [slack - moved, multiplier, slack, bend * slack - multiplier];
    }

    /// The largest step up to `most` that keeps everything positive.
    fn reach(&self, most: f64) -> f64 {
        let values = [self.distance, self.multiplier, self.slack, self.relief];
        let used = if matches!(self.owner, Owner::Row(_)) { 4 } else { 2 };
        // Few sides are the nearest so far, so that there are few divisions.
        values[..used].iter().zip(&self.changes).fold(most, |most, (value, change)| {
            if value + most * change < 0.0 { -value / change } else { most }
        })
    }

    /// Sum of the products after a step, and their number.
    fn product(&self, step: f64) -> (f64, f64) {
        let at = |value: f64, change: f64| value + step * change;
        let first = at(self.distance, self.changes[0]) * at(self.multiplier, self.changes[1]);
        match self.owner {
            Owner::Control(_) => (first, 1.0),
            Owner::Row(_) => {
                (first + at(self.slack, self.changes[2]) * at(self.relief, self.changes[3]), 2.0)
            }
        }
    }
}

impl Chain {
    /// Solves with convex `blocks`; false where the iterations do not end.
    pub(super) fn solve_interior(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
    ) -> bool {
        /// Bounds of the state this far away, in shares of their range, are left out at first: hardly a step reaches them.
        const FAR: f64 = 0.25;
        self.approach(shooting, blocks, FAR, solution)
            && (self.keeps_all(solution) || self.approach(shooting, blocks, f64::INFINITY, solution))
    }

    /// Whether all rows with state `Inside` are within their limits.
    fn keeps_all(&self, solution: &QpSolution) -> bool {
        /// More than the interior point leaves of any row that it knows.
        const TOLERANCE: f64 = 1e-4;
        self.rows.iter().zip(&solution.row_states).all(|(row, state)| {
            let value = row.value(&self.point.states);
            *state != RowState::Inside || (value - row.upper).max(row.lower - value) <= TOLERANCE
        })
    }

    /// Solves without the bounds of the state that are farther away than `far` of their range.
    fn approach(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        far: f64,
        solution: &mut QpSolution,
    ) -> bool {
        /// Ten to fifteen are usual.
        const ITERATIONS: u32 = 60;
        /// Complementarity and share of the first residual that are left at the end.
        const TOLERANCE: f64 = 1e-10;
        /// The same where steps have become short because of rounding errors, and what is short.
        const COARSE: f64 = 1e-6;
        const SHORT: f64 = 0.1;
        /// Fraction of the distance to the nearest end of a range.
        const SHARE: f64 = 0.995;
        self.start_interior(shooting, far, solution);
        let bend = 2.0 * self.slack_quadratic;
        let mut left = 1.0;
        for _ in 0..ITERATIONS {
            let centre = self.centre(0.0);
            if centre <= TOLERANCE && left <= TOLERANCE {
                break;
            }
            self.weigh(blocks);
            self.find_slopes(blocks);
            let intervals = &shooting.intervals;
            let states = &solution.bound_states;
            if !self.riccati.factorise(intervals, &self.blocks, &self.change, self.tied, states) {
                // Rounding errors of the large weights; the point reached is checked below.
                break;
            }
            for side in &mut self.sides {
                side.targets = [0.0; 2];
            }
            self.direct(shooting, bend);
            let affine = self.centre(self.reach().min(1.0));
            let target = centre * (affine / centre).powi(3);
            for side in &mut self.sides {
                let [distance, multiplier, slack, relief] = side.changes;
                side.targets = [target - distance * multiplier, target - slack * relief];
            }
            self.direct(shooting, bend);
            let step = (SHARE * self.reach()).min(1.0);
            for side in &mut self.sides {
                let [distance, multiplier, slack, relief] = side.changes;
                side.distance += step * distance;
                side.multiplier += step * multiplier;
                side.slack += step * slack;
                side.relief += step * relief;
            }
            let (point, path) = (&mut self.point, &self.path);
            for (value, change) in point.states.iter_mut().flatten().zip(path.states.iter().flatten()) {
                *value += step * change;
            }
            for (value, change) in point.controls.iter_mut().flatten().zip(path.controls.iter().flatten()) {
                *value += step * change;
            }
            left *= 1.0 - step;
            if !step.is_finite() || step <= 1e-12 {
                return false;
            }
            if step < SHORT && centre <= COARSE && left <= COARSE {
                break;
            }
        }
        self.finish_interior(solution);
        let finite = solution.step.iter().chain(&solution.row_multipliers).all(|value| value.is_finite());
        finite && self.centre(0.0) <= COARSE && left <= COARSE
    }

    /// Fills the sides; controls without room are held.
    fn start_interior(&mut self, shooting: &Shooting, far: f64, solution: &mut QpSolution) {
        /// First product of a distance and its multiplier.
        const PRODUCT: f64 = 1.0;
        /// Controls start this share of their range inside.
        const INSIDE: f64 = 0.1;
        solution.reset(self.lower.len(), self.rows.len());
        refill(&mut self.held, self.lower.len(), 0.0);
        // Where the controls start.
        refill(&mut self.point.controls, self.lower.len() / 2, [0.0; 2]);
        self.sides.clear();
        let blank = Side {
            owner: Owner::Control(0),
            sign: 1.0,
            distance: 1.0,
            multiplier: 1.0,
            slack: 0.0,
            relief: 0.0,
            targets: [0.0; 2],
            still: [0.0; 2],
            changes: [0.0; 4],
            inner: 0.0,
            outer: 0.0,
        };
        for (place, (&lower, &upper)) in self.lower.iter().zip(&self.upper).enumerate() {
            let room = upper - lower;
            if room <= 1e-9 {
                solution.bound_states[place] = BoundState::Lower;
                self.point.controls[place / 2][place % 2] = lower;
                continue;
            }
            let value = 0f64.max(lower + INSIDE * room).min(upper - INSIDE * room);
            self.point.controls[place / 2][place % 2] = value;
            for (sign, distance) in [(1.0, upper - value), (-1.0, value - lower)] {
                let owner = Owner::Control(place);
                self.sides.push(Side { owner, sign, distance, multiplier: PRODUCT / distance, ..blank });
            }
        }
        self.point.follow(&shooting.intervals, &shooting.gaps);
        // Distances to ellipses are no lengths: those rows are all kept.
        let bounds = 5 * (self.lower.len() / 2);
        for (index, row) in self.rows.iter().enumerate() {
            let value = row.value(&self.point.states);
            for (sign, limit) in [(1.0, row.upper), (-1.0, row.lower)] {
                let excess = sign * (value - limit);
                let room = far * (row.upper - row.lower);
                if limit.is_infinite() || (index < bounds && excess < -room) {
                    continue;
                }
                let slack = excess.max(0.0) + PRODUCT / self.slack_linear.max(1.0);
                let distance = slack - excess;
                let largest = self.slack_linear + 2.0 * self.slack_quadratic * slack;
                let multiplier = (PRODUCT / distance).min(0.5 * largest);
                let relief = largest - multiplier;
                let owner = Owner::Row(index);
                self.sides.push(Side { owner, sign, distance, multiplier, slack, relief, ..blank });
            }
        }
    }

    /// Adds the weights of the sides to the blocks.
    fn weigh(&mut self, blocks: &[Block]) {
        let bend = 2.0 * self.slack_quadratic;
        self.damp(blocks);
        for side in &mut self.sides {
            side.prepare(bend);
            let weight = side.weight();
            match side.owner {
                Owner::Control(place) => {
                    self.blocks[place / 2][5 + place % 2][5 + place % 2] += weight;
                }
                Owner::Row(row) => self.rows[row].add_square(weight, &mut self.blocks),
            }
        }
    }

    /// Solves for the step, into the path, and fills the changes of the sides.
    ///
    /// It solves for the step, not for the new point, because weights of 1e10 times a value would lose all other
    /// digits.
    fn direct(&mut self, shooting: &Shooting, bend: f64) {
        self.sums.clone_from(&self.base);
        for side in &mut self.sides {
            let slope = side.slope();
            match side.owner {
                Owner::Control(place) => self.sums[place / 2][5 + place % 2] += slope,
                Owner::Row(row) => self.rows[row].add_to(slope, &mut self.sums[self.rows[row].node]),
            }
        }
        self.riccati.solve(&shooting.intervals, &self.sums, &self.held, None, &mut self.path);
        for side in &mut self.sides {
            let value = match side.owner {
                Owner::Control(place) => self.path.controls[place / 2][place % 2],
                Owner::Row(row) => self.rows[row].value(&self.path.states),
            };
            side.change(bend, value);
        }
    }

    /// Derivatives of the objective at the point, node by node.
    fn find_slopes(&mut self, blocks: &[Block]) {
        self.base.clone_from(&self.slopes);
        let Path { states, controls, .. } = &self.point;
        for (node, (sums, block)) in self.base.iter_mut().zip(blocks).enumerate() {
            let control = controls.get(node).copied().unwrap_or_default();
            let values = states[node].iter().chain(&control);
            for (value, column) in values.zip(block) {
                // Blocks are symmetric.
                for (sum, entry) in sums.iter_mut().zip(column) {
                    *sum += value * entry;
                }
            }
        }
        for (index, control) in controls.iter().enumerate() {
            let before = if index > 0 { controls[index - 1] } else { [0.0; 2] };
            for component in 0..2 {
                self.base[index][5 + component] += self.damping[component] * control[component];
                if index > 0 || self.tied {
                    let pull = self.change[component] * (control[component] - before[component]);
                    self.base[index][5 + component] += pull;
                    if index > 0 {
                        self.base[index - 1][5 + component] -= pull;
                    }
                }
            }
        }
    }

    fn reach(&self) -> f64 {
        /// Steps are no longer than 1; a share of this one is still whole.
        const MAX_STEPS: f64 = 2.0;
        self.sides.iter().fold(MAX_STEPS, |most, side| side.reach(most))
    }

    /// Mean of the products after a step.
    fn centre(&self, step: f64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for side in &self.sides {
            let (product, products) = side.product(step);
            sum += product;
            count += products;
        }
        sum / f64::max(count, 1.0)
    }

    /// Reads solution and active set off the last point: a constraint is active when its multiplier exceeds its
    /// distance.
    fn finish_interior(&mut self, solution: &mut QpSolution) {
        self.write(&self.point, solution);
        for side in &self.sides {
            let active = side.multiplier > side.distance;
            let upper = side.sign > 0.0;
            match side.owner {
                Owner::Control(place) => {
                    solution.bound_multipliers[place] += side.sign * side.multiplier;
                    if active {
                        solution.bound_states[place] = BoundState::at(upper);
                    }
                }
                Owner::Row(row) => {
                    solution.row_multipliers[row] += side.sign * side.multiplier;
                    if active {
                        solution.row_states[row] = RowState::held(upper, side.slack > side.relief);
                    }
                }
            }
        }
    }
}
