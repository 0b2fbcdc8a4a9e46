//! The Riccati recursion: the program without inequalities, with some controls held.
//!
//! The state of the recursion is (x, w), where w is the control of the interval before, to which the control
//! differences tie. From the end to the start, the cost to go is 1/2 z' P z + p' z; the matrices are factorised once
//! and then serve for any number of right-hand sides. Work is linear in the number of intervals.

#![expect(clippy::needless_range_loop, reason = "small matrices read best by their indices")]

use crate::dense::refill;
use crate::hessian::Block;
use crate::interval::Linearisation;
use crate::qp::BoundState;

/// One interval after the factorisation.
#[derive(Debug, Clone, Copy, Default)]
struct Stage {
    /// Second derivatives of the cost to go by the control.
    hessian: [[f64; 2]; 2],
    /// Its inverse on the free components; zero for those that are held.
    inverse: [[f64; 2]; 2],
    /// Second derivatives by the control and z.
    cross: [[f64; 7]; 2],
    /// u = open - gain z.
    gain: [[f64; 7]; 2],
}

/// The factorised recursion.
#[derive(Debug, Clone, Default)]
pub(crate) struct Riccati {
    stages: Vec<Stage>,
    /// P at nodes 0 to N.
    costs: Vec<Block>,
}

/// A solution for one right-hand side.
#[derive(Debug, Clone, Default)]
pub(crate) struct Path {
    /// x at nodes 0 to N.
    pub states: Vec<[f64; 5]>,
    /// u of the intervals.
    pub controls: Vec<[f64; 2]>,
    open: Vec<[f64; 2]>,
    /// Derivative of the cost to go by u at z = 0, u = 0.
    linear: Vec<[f64; 2]>,
}

impl Riccati {
    /// Factorises; false where the program is not safely convex in the free controls.
    pub(crate) fn factorise(
        &mut self,
        intervals: &[Linearisation],
        blocks: &[Block],
        change: &[f64; 2],
        tied: bool,
        states: &[BoundState],
    ) -> bool {
        /// Curvature below this, for an objective of order one, may be a rounding error.
        const MIN_CURVATURE: f64 = 1e-9;
        let count = intervals.len();
        self.stages.clear();
        refill(&mut self.costs, count + 1, [[0.0; 7]; 7]);
        let mut cost = [[0.0; 7]; 7];
        for row in 0..5 {
            cost[row][..5].copy_from_slice(&blocks[count][row][..5]);
        }
        self.costs[count] = cost;
        for index in (0..count).rev() {
            let interval = &intervals[index];
            let block = &blocks[index];
            let change = if index > 0 || tied { *change } else { [0.0; 2] };

            // P A, by columns of A, and P C + the part of w, which is this control.
            let mut ahead = [[0.0; 5]; 5];
            let mut mixed = [[0.0; 2]; 5];
            for row in 0..5 {
                let line = &cost[row];
                let mut sums = [0.0; 4];
                for middle in 0..5 {
                    sums[0] += line[middle] * interval.by_lateral[middle][0];
                    sums[1] += line[middle] * interval.by_lateral[middle][1];
                    sums[2] += line[middle] * interval.by_control[middle][0];
                    sums[3] += line[middle] * interval.by_control[middle][1];
                }
                let by_yaw = line[1] + interval.by_yaw[0] * line[3] + interval.by_yaw[1] * line[4];
                let [by_x, by_y] = interval.back([line[3], line[4]]);
                ahead[row] = [sums[0], by_yaw, sums[1], by_x, by_y];
                mixed[row] = [sums[2] + line[5], sums[3] + line[6]];
            }

            let mut stage = Stage::default();
            for row in 0..2 {
                let column = [mixed[0][row], mixed[1][row], mixed[2][row], mixed[3][row], mixed[4][row]];
                let back = interval.transport_back(&column);
                for place in 0..5 {
                    stage.cross[row][place] = back[place] + block[5 + row][place];
                }
                stage.cross[row][5 + row] = -change[row];
                for column in 0..2 {
                    let mut sum = block[5 + row][5 + column] + cost[5 + row][5 + column];
                    for middle in 0..5 {
                        sum += interval.by_control[middle][row] * mixed[middle][column];
                        sum += cost[5 + row][middle] * interval.by_control[middle][column];
                    }
                    stage.hessian[row][column] = sum;
                }
                stage.hessian[row][row] += change[row];
            }
            let free = [0, 1].map(|component: usize| states[2 * index + component] == BoundState::Free);
            let Some(inverse) = invert(&stage.hessian, free, MIN_CURVATURE) else { return false };
            stage.inverse = inverse;
            for row in 0..2 {
                for place in 0..7 {
                    stage.gain[row][place] =
                        inverse[row][0] * stage.cross[0][place] + inverse[row][1] * stage.cross[1][place];
                }
            }

            // A' P A + B, less the decrease by the control.
            let mut next = [[0.0; 7]; 7];
            for column in 0..5 {
                let mut sums = [0.0; 2];
                for middle in 0..5 {
                    sums[0] += interval.by_lateral[middle][0] * ahead[middle][column];
                    sums[1] += interval.by_lateral[middle][1] * ahead[middle][column];
                }
                next[0][column] = sums[0];
                next[1][column] = ahead[1][column]
                    + interval.by_yaw[0] * ahead[3][column]
                    + interval.by_yaw[1] * ahead[4][column];
                next[2][column] = sums[1];
                [next[3][column], next[4][column]] = interval.back([ahead[3][column], ahead[4][column]]);
            }
            for row in 0..5 {
                for column in 0..5 {
                    next[row][column] += block[row][column];
                }
            }
            next[5][5] = change[0];
            next[6][6] = change[1];
            for row in 0..7 {
                for column in 0..=row {
                    let value = next[row][column]
                        - stage.cross[0][row] * stage.gain[0][column]
                        - stage.cross[1][row] * stage.gain[1][column];
                    next[row][column] = value;
                    next[column][row] = value;
                }
            }
            self.costs[index] = next;
            self.stages.push(stage);
            cost = next;
        }
        self.stages.reverse();
        true
    }

    /// The solution for the linear terms `slopes`, with the values of `held` controls (zero for free ones) and gaps.
    pub(crate) fn solve(
        &self,
        intervals: &[Linearisation],
        slopes: &[[f64; 7]],
        held: &[f64],
        gaps: Option<&[[f64; 5]]>,
        path: &mut Path,
    ) {
        let count = intervals.len();
        path.resize(count);
        let mut next = [0.0; 7];
        next[..5].copy_from_slice(&slopes[count][..5]);
        for index in (0..count).rev() {
            if let Some(gaps) = gaps {
                for (value, row) in next.iter_mut().zip(&self.costs[index + 1]) {
                    for (entry, gap) in row.iter().zip(&gaps[index]) {
                        *value += entry * gap;
                    }
                }
            }
            let held = [held[2 * index], held[2 * index + 1]];
            next = self.retreat(index, &intervals[index], &next, &slopes[index], held, path);
        }
        self.advance(intervals, gaps, path);
    }

    /// The solution for a single linear term at `node`, of its state or of the control behind it, without gaps and with all
    /// held controls at zero.
    pub(crate) fn respond(
        &self,
        intervals: &[Linearisation],
        node: usize,
        slope: &[f64; 7],
        path: &mut Path,
    ) {
        let count = intervals.len();
        path.resize(count);
        path.open[node..].fill([0.0; 2]);
        path.linear[node..].fill([0.0; 2]);
        let mut next = *slope;
        if slope[5] != 0.0 || slope[6] != 0.0 {
            next = self.retreat(node, &intervals[node], &[0.0; 7], slope, [0.0; 2], path);
        }
        for index in (0..node).rev() {
            next = self.retreat(index, &intervals[index], &next, &[0.0; 7], [0.0; 2], path);
        }
        self.advance(intervals, None, path);
    }

    /// Derivative of the Lagrangian by the controls of an interval at the solution, without the bounds' multipliers.
    pub(crate) fn control_slope(&self, index: usize, path: &Path) -> [f64; 2] {
        let stage = &self.stages[index];
        let before = if index > 0 { path.controls[index - 1] } else { [0.0; 2] };
        let (state, control) = (&path.states[index], &path.controls[index]);
        [0, 1].map(|row: usize| {
            let cross = &stage.cross[row];
            let by_state: f64 = cross.iter().zip(state).map(|(entry, value)| entry * value).sum();
            path.linear[index][row]
                + by_state
                + cross[5] * before[0]
                + cross[6] * before[1]
                + stage.hessian[row][0] * control[0]
                + stage.hessian[row][1] * control[1]
        })
    }

    /// One interval of the backward sweep; returns p before it.
    #[inline]
    fn retreat(
        &self,
        index: usize,
        interval: &Linearisation,
        next: &[f64; 7],
        slope: &[f64; 7],
        held: [f64; 2],
        path: &mut Path,
    ) -> [f64; 7] {
        let stage = &self.stages[index];
        let ahead = [next[0], next[1], next[2], next[3], next[4]];
        let mut linear = [slope[5] + next[5], slope[6] + next[6]];
        for (by_control, value) in interval.by_control.iter().zip(&ahead) {
            linear[0] += by_control[0] * value;
            linear[1] += by_control[1] * value;
        }
        let moved = [0, 1].map(|row: usize| {
            linear[row] + stage.hessian[row][0] * held[0] + stage.hessian[row][1] * held[1]
        });
        let open = [0, 1].map(|row: usize| {
            held[row] - stage.inverse[row][0] * moved[0] - stage.inverse[row][1] * moved[1]
        });
        let back = interval.transport_back(&ahead);
        let mut before = [0.0; 7];
        for place in 0..5 {
            before[place] = back[place] + slope[place];
        }
        for place in 0..7 {
            before[place] += stage.cross[0][place] * open[0] + stage.cross[1][place] * open[1];
        }
        path.open[index] = open;
        path.linear[index] = linear;
        before
    }

    /// The forward sweep.
    fn advance(&self, intervals: &[Linearisation], gaps: Option<&[[f64; 5]]>, path: &mut Path) {
        let mut state = [0.0; 5];
        let mut control = [0.0; 2];
        path.states[0] = state;
        for index in 0..intervals.len() {
            let gain = &self.stages[index].gain;
            let mut next = path.open[index];
            for row in 0..2 {
                for place in 0..5 {
                    next[row] -= gain[row][place] * state[place];
                }
                next[row] -= gain[row][5] * control[0] + gain[row][6] * control[1];
            }
            control = next;
            state = intervals[index].transport(&state);
            for (value, by_control) in state.iter_mut().zip(&intervals[index].by_control) {
                *value += by_control[0] * control[0] + by_control[1] * control[1];
            }
            if let Some(gaps) = gaps {
                for (value, gap) in state.iter_mut().zip(&gaps[index]) {
                    *value += gap;
                }
            }
            path.controls[index] = control;
            path.states[index + 1] = state;
        }
    }
}

impl Path {
    /// Fills the states that the controls lead to.
    pub(crate) fn follow(&mut self, intervals: &[Linearisation], gaps: &[[f64; 5]]) {
        let mut state = [0.0; 5];
        self.states.clear();
        self.states.push(state);
        for ((interval, gap), control) in intervals.iter().zip(gaps).zip(&self.controls) {
            state = interval.transport(&state);
            for ((value, gap), by_control) in state.iter_mut().zip(gap).zip(&interval.by_control) {
                *value += gap + by_control[0] * control[0] + by_control[1] * control[1];
            }
            self.states.push(state);
        }
    }

    /// Adds `factor` times another solution of the same factors.
    pub(crate) fn add(&mut self, factor: f64, other: &Self) {
        for (value, change) in self.states.iter_mut().flatten().zip(other.states.iter().flatten()) {
            *value += factor * change;
        }
        for (value, change) in self.controls.iter_mut().flatten().zip(other.controls.iter().flatten()) {
            *value += factor * change;
        }
        for (value, change) in self.linear.iter_mut().flatten().zip(other.linear.iter().flatten()) {
            *value += factor * change;
        }
    }

    /// Takes over the values of another, without allocating where they fit.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.states.clone_from(&other.states);
        self.controls.clone_from(&other.controls);
        self.open.clone_from(&other.open);
        self.linear.clone_from(&other.linear);
    }

    pub(super) fn resize(&mut self, count: usize) {
        self.states.resize(count + 1, [0.0; 5]);
        self.controls.resize(count, [0.0; 2]);
        self.open.resize(count, [0.0; 2]);
        self.linear.resize(count, [0.0; 2]);
    }
}

/// The inverse on the free components, zero elsewhere; `None` where that is not positive definite.
fn invert(matrix: &[[f64; 2]; 2], free: [bool; 2], least: f64) -> Option<[[f64; 2]; 2]> {
    let mut inverse = [[0.0; 2]; 2];
    match free {
        [true, true] => {
            let determinant = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0];
            let safe = matrix[0][0] > least && determinant > least * matrix[0][0];
            if !safe {
                return None;
            }
            inverse[0] = [matrix[1][1] / determinant, -matrix[0][1] / determinant];
            inverse[1] = [inverse[0][1], matrix[0][0] / determinant];
        }
        [false, false] => {}
        _ => {
            let place = usize::from(free[1]);
            let curvature = matrix[place][place];
            if curvature <= least || curvature.is_nan() {
                return None;
            }
            inverse[place][place] = 1.0 / curvature;
        }
    }
    Some(inverse)
}
