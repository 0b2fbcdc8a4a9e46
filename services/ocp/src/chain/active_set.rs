//! The active set of the chain by a primal-dual search: solve with the present set, then correct it everywhere at
//! once.
//!
//! Controls in the set are held at their bounds, rows beyond a limit are penalties, rows at a limit are equations.
//! The first two cost nothing in the recursion; the equations are solved for by their Schur complement, one linear
//! solve each, and there are few: a path touches an ellipse at some nodes only. From a good start one to three rounds
//! are enough, and the answer is exact. There is no proof that the rounds end; the caller limits them.

use super::Chain;
use crate::dense::{cholesky, fill, solve_factored};
use crate::hessian::Block;
use crate::qp::{BoundState, QpSolution, RowState};
use crate::shooting::Shooting;

/// Violations and multipliers of the wrong sign up to this are rounding errors.
const TOLERANCE: f64 = 1e-10;

/// The longest horizon for which memory is reserved.
const RESERVED_INTERVALS: usize = 24;

/// Makes room for `length` values.
fn reserve<T>(values: &mut Vec<T>, length: usize) {
    values.reserve(length.saturating_sub(values.len()));
}

impl Chain {
    /// Searches from the states in `solution`; false where a system is not convex or the rounds do not end.
    pub(super) fn search(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
        rounds: u32,
    ) -> bool {
        let (variables, rows) = (self.lower.len(), self.rows.len());
        if solution.bound_states.len() != variables || solution.row_states.len() != rows {
            solution.reset(variables, rows);
        }
        for _ in 0..rounds {
            if !self.is_factorised && !self.factorise_set(shooting, blocks, solution) {
                return false;
            }
            self.solve_factorised(shooting, solution);
            self.is_factorised = self.correct_set(solution);
            if self.is_factorised {
                self.write(&self.path, solution);
                return solution.step.iter().all(|value| value.is_finite());
            }
        }
        false
    }

    /// Makes room for all equations of `count` intervals, so that later solves of this size allocate nothing. Longer horizons
    /// than [`RESERVED_INTERVALS`] make room when they need it.
    pub(crate) fn reserve(&mut self, count: usize, rows: usize) {
        let most = 2 * count;
        if count > RESERVED_INTERVALS || self.equations.capacity() >= rows && self.responses.len() >= most {
            return;
        }
        reserve(&mut self.equations, rows);
        reserve(&mut self.multipliers, rows);
        reserve(&mut self.schur, most * most);
        reserve(&mut self.schur_factor, most * most);
        self.responses.resize_with(most.max(self.responses.len()), Default::default);
        self.responses.iter_mut().for_each(|response| response.resize(count));
    }

    /// Solves with the states in `solution` as they are, into the path and the multipliers of the equations; false where
    /// that has no unique solution.
    pub(super) fn solve_set(&mut self, shooting: &Shooting, blocks: &[Block], solution: &QpSolution) -> bool {
        self.is_factorised = false;
        self.factorise_set(shooting, blocks, solution) && {
            self.solve_factorised(shooting, solution);
            true
        }
    }

    /// Factorises the recursion and the equations for the states in `solution`.
    fn factorise_set(&mut self, shooting: &Shooting, blocks: &[Block], solution: &QpSolution) -> bool {
        /// Weights of the squares of the equations, in units of the curvature of their nodes. A square changes nothing
        /// where its equation holds, and with enough of it the system is positive definite when it is so on the null
        /// space; too much costs digits of the multipliers.
        const WEIGHTS: [f64; 3] = [1e2, 1e4, 1e6];
        let factorised = WEIGHTS.iter().any(|weight| {
            self.assemble(blocks, *weight, solution);
            let states = &solution.bound_states;
            self.riccati.factorise(&shooting.intervals, &self.blocks, &self.change, self.tied, states)
        });
        factorised && self.factorise_equations(shooting)
    }

    /// Solves with the present factors.
    fn solve_factorised(&mut self, shooting: &Shooting, solution: &QpSolution) {
        let intervals = &shooting.intervals;
        self.riccati.solve(intervals, &self.sums, &self.held, Some(&shooting.gaps), &mut self.path);
        self.multipliers.clear();
        for &index in &self.equations {
            let row = &self.rows[index];
            let limit = if solution.row_states[index] == RowState::AtLower { row.lower } else { row.upper };
            self.multipliers.push(row.value(&self.path.states) - limit);
        }
        solve_factored(&self.schur_factor, self.equations.len(), &mut self.multipliers);
        for (response, &multiplier) in self.responses.iter().zip(&self.multipliers) {
            self.path.add(multiplier, response);
        }
    }

    /// Blocks, linear terms, held controls and equations of the present set.
    fn assemble(&mut self, blocks: &[Block], square_weight: f64, solution: &QpSolution) {
        self.damp(blocks);
        self.sums.clone_from(&self.slopes);
        fill(
            &mut self.held,
            solution.bound_states.iter().zip(self.lower.iter().zip(&self.upper)).map(
                |(state, (lower, upper))| match state {
                    BoundState::Free => 0.0,
                    BoundState::Lower => *lower,
                    BoundState::Upper => *upper,
                },
            ),
        );
        self.equations.clear();
        let bend = 2.0 * self.slack_quadratic;
        for (index, (row, state)) in self.rows.iter().zip(&solution.row_states).enumerate() {
            if let Some((sign, limit)) = state.beyond([row.lower, row.upper]) {
                row.add_square(bend, &mut self.blocks);
                row.add_to(sign * self.slack_linear - bend * limit, &mut self.sums[row.node]);
            } else if *state != RowState::Inside {
                self.equations.push(index);
                let block = &self.blocks[row.node];
                let size = (0..5).map(|place| block[place][place].abs()).fold(1.0, f64::max);
                let square = row.factors.iter().map(|factor| factor * factor).sum::<f64>();
                let weight = square_weight * size / square.max(1e-6);
                let limit = if *state == RowState::AtLower { row.lower } else { row.upper };
                row.add_square(weight, &mut self.blocks);
                row.add_to(-weight * limit, &mut self.sums[row.node]);
            }
        }
    }

    /// Responses to the equations and the factor of their Schur complement.
    fn factorise_equations(&mut self, shooting: &Shooting) -> bool {
        let size = self.equations.len();
        if size > shooting.intervals.len() * 2 {
            // More equations than controls have no unique solution.
            return false;
        }
        if self.responses.len() < size {
            self.responses.resize_with(size, Default::default);
        }
        for (response, &row) in self.responses.iter_mut().zip(&self.equations) {
            let row = &self.rows[row];
            let mut slope = [0.0; 7];
            row.add_to(1.0, &mut slope);
            self.riccati.respond(&shooting.intervals, row.node, &slope, response);
        }
        self.schur.clear();
        for &index in &self.equations {
            let row = &self.rows[index];
            self.schur.extend(self.responses[..size].iter().map(|response| -row.value(&response.states)));
        }
        cholesky(&self.schur, size, &mut self.schur_factor)
    }

    /// Corrects the states in `solution` where the path contradicts them; true where it never does. Multipliers of
    /// the present set are filled in.
    ///
    /// Where neighbouring nodes exceed the same limit only the worst of them joins: a path that is pushed out at one
    /// node is out at the next, and equations at all of them would leave it no freedom.
    fn correct_set(&mut self, solution: &mut QpSolution) -> bool {
        let mut right = true;
        self.find_violations(solution);
        for (index, pair) in self.path.controls.iter().enumerate() {
            let slopes = self.riccati.control_slope(index, &self.path);
            for component in 0..2 {
                let place = 2 * index + component;
                let (value, multiplier) = (pair[component], -slopes[component]);
                let state = &mut solution.bound_states[place];
                solution.bound_multipliers[place] = if *state == BoundState::Free { 0.0 } else { multiplier };
                // A control without room stays held.
                let room = self.upper[place] - self.lower[place];
                let found = match *state {
                    BoundState::Free if value > self.upper[place] + TOLERANCE => BoundState::Upper,
                    BoundState::Free if value < self.lower[place] - TOLERANCE => BoundState::Lower,
                    BoundState::Upper if multiplier < -TOLERANCE && room > 0.0 => BoundState::Free,
                    BoundState::Lower if multiplier > TOLERANCE && room > 0.0 => BoundState::Free,
                    same => same,
                };
                right &= found == *state;
                *state = found;
            }
        }
        self.report_rows(solution);
        let largest = self.slack_linear + TOLERANCE;
        for (index, row) in self.rows.iter().enumerate() {
            let value = row.value(&self.path.states);
            let multiplier = solution.row_multipliers[index];
            let state = &mut solution.row_states[index];
            let found = match *state {
                RowState::Inside if self.violations[index] > TOLERANCE => {
                    right = false;
                    if !self.is_worst(index) {
                        RowState::Inside
                    } else if value > row.upper {
                        RowState::AtUpper
                    } else {
                        RowState::AtLower
                    }
                }
                RowState::AtUpper if multiplier < -TOLERANCE => RowState::Inside,
                RowState::AtLower if multiplier > TOLERANCE => RowState::Inside,
                RowState::AtUpper if multiplier > largest => RowState::BeyondUpper,
                RowState::AtLower if multiplier < -largest => RowState::BeyondLower,
                RowState::BeyondUpper if value < row.upper - TOLERANCE => RowState::AtUpper,
                RowState::BeyondLower if value > row.lower + TOLERANCE => RowState::AtLower,
                same => same,
            };
            right &= found == *state;
            *state = found;
        }
        right
    }

    /// By how much rows with state `Inside` violate their limits.
    fn find_violations(&mut self, solution: &QpSolution) {
        let states = &self.path.states;
        fill(
            &mut self.violations,
            self.rows.iter().zip(&solution.row_states).map(|(row, state)| match state {
                RowState::Inside => {
                    let value = row.value(states);
                    (value - row.upper).max(row.lower - value)
                }
                _ => 0.0,
            }),
        );
    }

    /// Whether the same row of the nodes before and after is violated less.
    fn is_worst(&self, index: usize) -> bool {
        let count = self.lower.len() / 2;
        let (section, stride) = if index < 5 * count {
            (&self.violations[..5 * count], 5)
        } else {
            (&self.violations[5 * count..], self.rows.len() / count - 5)
        };
        let place = if index < 5 * count { index } else { index - 5 * count };
        let own = section[place];
        (place < stride || section[place - stride] < own)
            && section.get(place + stride).is_none_or(|next| *next <= own)
    }

    /// Fills the multipliers of the rows of the set that the path belongs to.
    pub(super) fn report_rows(&self, solution: &mut QpSolution) {
        solution.row_multipliers.fill(0.0);
        for (&row, &multiplier) in self.equations.iter().zip(&self.multipliers) {
            solution.row_multipliers[row] = multiplier;
        }
        let bend = 2.0 * self.slack_quadratic;
        for (index, row) in self.rows.iter().enumerate() {
            if let Some((sign, limit)) = solution.row_states[index].beyond([row.lower, row.upper]) {
                let excess = row.value(&self.path.states) - limit;
                solution.row_multipliers[index] = sign * self.slack_linear + bend * excess;
            }
        }
    }
}
