//! One interval: collocation of the model between two nodes under a constant control.
//!
//! Only (sideslip, yaw rate) are implicit: they form a closed system of their own, (7.27) and (7.29). Yaw is the
//! quadrature of the yaw rate, and the position the quadrature of the course, (7.28), (7.30), (7.31), so an
//! interval costs one block elimination of 2s unknowns with five right-hand sides.
//!
//! The stage values are part of the iterates of the optimisation ("lifted" collocation). [`linearise`] makes one
//! Newton step of the collocation equations from them, which is enough near the solution.
//!
//! States are ordered (sideslip, yaw, yaw rate, x, y), controls (velocity, steering).

#![expect(clippy::needless_range_loop, reason = "small matrices read best by their indices")]

use crate::collocation::{Collocation, MAX_STAGES};
use crate::model::{LateralModel, LateralSlope};
use crate::node_frame::{NodeFrame, turned, turned_back};
use crate::trig::sin_cos;

/// (sideslip, yaw rate) at the stages; entries beyond the stages of the scheme are not used.
pub type StageValues = [[f64; 2]; MAX_STAGES];

/// The end of an interval, linearised at the present values.
#[derive(Debug, Clone, Copy, Default)]
pub struct Linearisation {
    /// End state from the present stage values.
    pub end: [f64; 5],
    /// Change of the end state by the Newton step of the stages alone.
    pub correction: [f64; 5],
    /// Derivatives of the end state by the start's (sideslip, yaw rate).
    pub by_lateral: [[f64; 2]; 5],
    /// Derivatives of the end's (x, y) by the start's yaw; that of yaw itself is 1, the others are 0.
    pub by_yaw: [f64; 2],
    /// Derivatives of the end state by (velocity, steering).
    pub by_control: [[f64; 2]; 5],
    /// Change of each stage by: the Newton step, the start's (sideslip, yaw rate), and (velocity, steering).
    pub stages: [[[f64; 5]; 2]; MAX_STAGES],
    /// Cosine and sine by which the frame of the end is turned to the left of that of the start; `None` for the same frame.
    pub direction: Option<[f64; 2]>,
}

/// Model, scheme and length of an interval.
#[derive(Debug, Clone, Copy)]
pub struct Interval<'a> {
    /// The lateral model.
    pub model: &'a dyn LateralModel,
    /// Its discretisation.
    pub collocation: &'a Collocation,
    /// Length [s].
    pub length: f64,
}

/// End state, residual and sensitivities from the present start, control and stage values.
pub(crate) fn linearise(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &StageValues,
) -> Linearisation {
    match interval.collocation.stages {
        1 => linearise_stages::<1>(interval, start, control, stages),
        2 => linearise_stages::<2>(interval, start, control, stages),
        3 => linearise_stages::<3>(interval, start, control, stages),
        _ => linearise_stages::<4>(interval, start, control, stages),
    }
}

/// Newton's method on the stage values until none changes by more than `tolerance`: the last linearisation, whose
/// sensitivities belong to values that differ by the last step only, and its largest change.
///
/// From afar, as from a guess, steps without sensitivities come first. `None` where that takes more than `steps`, or the
/// result is not finite.
pub(crate) fn settle(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &mut StageValues,
    steps: usize,
    tolerance: f64,
    mut is_far: bool,
) -> Option<(Linearisation, f64)> {
    /// The equations are nearly linear: after a change of this size the next one is a rounding error.
    const NEAR: f64 = 1e-4;
    for _ in 0..steps {
        if is_far {
            is_far = correct(interval, start, control, stages) > NEAR;
            continue;
        }
        let linearisation = linearise(interval, start, control, stages);
        let mut largest = 0.0f64;
        for (stage, change) in stages.iter_mut().zip(&linearisation.stages) {
            for component in 0..2 {
                stage[component] += change[component][0];
                largest = largest.max(change[component][0].abs());
            }
        }
        if largest <= tolerance {
            let finite =
                linearisation.end.iter().chain(&linearisation.correction).all(|value| value.is_finite());
            return finite.then_some((linearisation, largest));
        }
        is_far = largest > NEAR;
    }
    None
}

impl Linearisation {
    /// Derivatives of the end state by the start state, row by row.
    pub(crate) fn by_state(&self) -> [[f64; 5]; 5] {
        let mut matrix = [[0.0; 5]; 5];
        for (row, lateral) in matrix.iter_mut().zip(&self.by_lateral) {
            row[0] = lateral[0];
            row[2] = lateral[1];
        }
        matrix[1][1] = 1.0;
        matrix[3][1] = self.by_yaw[0];
        matrix[4][1] = self.by_yaw[1];
        [matrix[3][3], matrix[4][3]] = self.forth([1.0, 0.0]);
        [matrix[3][4], matrix[4][4]] = self.forth([0.0, 1.0]);
        matrix
    }

    /// The derivative by the start state times a change of it.
    #[inline]
    pub(crate) fn transport(&self, change: &[f64; 5]) -> [f64; 5] {
        let mut end = [0.0; 5];
        for (value, lateral) in end.iter_mut().zip(&self.by_lateral) {
            *value = lateral[0] * change[0] + lateral[1] * change[2];
        }
        end[1] += change[1];
        let position = self.forth([change[3], change[4]]);
        end[3] += self.by_yaw[0] * change[1] + position[0];
        end[4] += self.by_yaw[1] * change[1] + position[1];
        end
    }

    /// The transposed derivative by the start state times a costate of the end.
    #[inline]
    pub(crate) fn transport_back(&self, costate: &[f64; 5]) -> [f64; 5] {
        let mut start = [0.0; 5];
        for (value, lateral) in costate.iter().zip(&self.by_lateral) {
            start[0] += lateral[0] * value;
            start[2] += lateral[1] * value;
        }
        start[1] = costate[1] + self.by_yaw[0] * costate[3] + self.by_yaw[1] * costate[4];
        [start[3], start[4]] = self.back([costate[3], costate[4]]);
        start
    }

    /// Turns the end into the frame of the next node.
    pub(crate) fn turn(&mut self, bend: &NodeFrame) {
        let direction = bend.direction();
        self.end = bend.apply(&self.end);
        [self.correction[3], self.correction[4]] =
            turned(direction, [self.correction[3], self.correction[4]]);
        self.by_yaw = turned(direction, self.by_yaw);
        for rows in [&mut self.by_lateral, &mut self.by_control] {
            for column in 0..2 {
                [rows[3][column], rows[4][column]] = turned(direction, [rows[3][column], rows[4][column]]);
            }
        }
        self.direction = Some(direction);
    }

    /// A position's change at the start as one at the end.
    #[inline]
    pub(crate) fn forth(&self, change: [f64; 2]) -> [f64; 2] {
        self.direction.map_or(change, |direction| turned(direction, change))
    }

    /// The transpose of [`Self::forth`].
    #[inline]
    pub(crate) fn back(&self, costate: [f64; 2]) -> [f64; 2] {
        self.direction.map_or(costate, |direction| turned_back(direction, costate))
    }
}

/// One Newton step of the collocation equations without sensitivities; the largest change of a stage.
fn correct(interval: &Interval, start: &[f64; 5], control: &[f64; 2], stages: &mut StageValues) -> f64 {
    match interval.collocation.stages {
        1 => correct_stages::<1>(interval, start, control, stages),
        2 => correct_stages::<2>(interval, start, control, stages),
        3 => correct_stages::<3>(interval, start, control, stages),
        _ => correct_stages::<4>(interval, start, control, stages),
    }
}

fn correct_stages<const S: usize>(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &mut StageValues,
) -> f64 {
    let Interval { model, collocation, length } = *interval;
    let mut slopes = [LateralSlope::default(); S];
    model.slopes(*control, &stages[..S], &mut slopes);
    let mut matrix = [[[[0.0; 2]; 2]; S]; S];
    let mut right = [[[0.0; 1]; 2]; S];
    for row in 0..S {
        for component in 0..2 {
            let mut left = start[2 * component] - stages[row][component];
            for column in 0..S {
                let factor = length * collocation.integrals[row][column];
                let slope = &slopes[column];
                matrix[row][column][component][0] = -factor * slope.by_state[component][0];
                matrix[row][column][component][1] = -factor * slope.by_state[component][1];
                left += factor * slope.value[component];
            }
            matrix[row][row][component][component] += 1.0;
            right[row][component][0] = left;
        }
    }
    eliminate(&mut matrix, &mut right);
    let mut largest = 0.0f64;
    for (stage, change) in stages.iter_mut().zip(&right) {
        for component in 0..2 {
            stage[component] += change[component][0];
            largest = largest.max(change[component][0].abs());
        }
    }
    largest
}

fn linearise_stages<const S: usize>(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &StageValues,
) -> Linearisation {
    let Interval { model, collocation, length } = *interval;
    let mut slopes = [LateralSlope::default(); S];
    model.slopes(*control, &stages[..S], &mut slopes);

    // The system (I - h A x J) change = right, in 2 x 2 blocks with five right-hand sides.
    let mut matrix = [[[[0.0; 2]; 2]; S]; S];
    let mut right = [[[0.0; 5]; 2]; S];
    for row in 0..S {
        for component in 0..2 {
            let origin = start[2 * component];
            let mut sums = [0.0; 3];
            for column in 0..S {
                let factor = length * collocation.integrals[row][column];
                let slope = &slopes[column];
                matrix[row][column][component][0] = -factor * slope.by_state[component][0];
                matrix[row][column][component][1] = -factor * slope.by_state[component][1];
                sums[0] += factor * slope.value[component];
                sums[1] += factor * slope.by_control[component][0];
                sums[2] += factor * slope.by_control[component][1];
            }
            matrix[row][row][component][component] += 1.0;
            let left = origin + sums[0] - stages[row][component];
            right[row][component] = [left, 0.0, 0.0, sums[1], sums[2]];
            right[row][component][1 + component] = 1.0;
        }
    }
    eliminate(&mut matrix, &mut right);

    let mut result = Linearisation::default();
    result.stages[..S].copy_from_slice(&right);

    // Sideslip and yaw rate at the end are linear in the stages.
    let mut rest = 1.0;
    let mut ends = [[0.0; 6]; 2];
    for stage in 0..S {
        let factor = collocation.end[stage];
        rest -= factor;
        for component in 0..2 {
            ends[component][5] += factor * stages[stage][component];
            for column in 0..5 {
                ends[component][column] += factor * right[stage][component][column];
            }
        }
    }
    for component in 0..2 {
        let end = &mut ends[component];
        end[5] += rest * start[2 * component];
        end[1 + component] += rest;
        result.set(2 * component, end);
    }

    // Yaw at the end and course at the stages are quadratures of the yaw rate; the position of the course.
    let mut yaw = [0.0; 6];
    let mut position = [[0.0; 6]; 2];
    let mut by_yaw = [0.0; 2];
    yaw[5] = start[1];
    for stage in 0..S {
        let weight = length * collocation.weights[stage];
        yaw[5] += weight * stages[stage][1];
        let mut course = [0.0; 6];
        course[5] = start[1] + stages[stage][0];
        course[..5].copy_from_slice(&right[stage][0]);
        for other in 0..S {
            let factor = length * collocation.integrals[stage][other];
            course[5] += factor * stages[other][1];
            for column in 0..5 {
                course[column] += factor * right[other][1][column];
            }
        }
        for column in 0..5 {
            yaw[column] += weight * right[stage][1][column];
        }
        let (sin, cos) = sin_cos(course[5]);
        let (along, across) = (weight * cos, weight * sin);
        position[0][5] += control[0] * along;
        position[1][5] += control[0] * across;
        let slope = [-control[0] * across, control[0] * along];
        for component in 0..2 {
            by_yaw[component] += slope[component];
            for column in 0..5 {
                position[component][column] += slope[component] * course[column];
            }
        }
        position[0][3] += along;
        position[1][3] += across;
    }
    position[0][5] += start[3];
    position[1][5] += start[4];
    result.set(1, &yaw);
    result.set(3, &position[0]);
    result.set(4, &position[1]);
    result.by_yaw = by_yaw;
    result
}

impl Linearisation {
    /// Fills the row of one component from (Newton step, sideslip, yaw rate, velocity, steering, value).
    #[inline]
    fn set(&mut self, component: usize, row: &[f64; 6]) {
        self.correction[component] = row[0];
        self.by_lateral[component] = [row[1], row[2]];
        self.by_control[component] = [row[3], row[4]];
        self.end[component] = row[5];
    }
}

/// Solves the block system in place by elimination without pivoting of blocks.
///
/// The leading minors of I - h A x J are positive for the stable J of the model, since those of A are; with a
/// sideslip beyond a right angle nothing is promised, and the caller meets numbers that are not finite.
#[inline]
pub(crate) fn eliminate<const S: usize, const C: usize>(
    matrix: &mut [[[[f64; 2]; 2]; S]; S],
    right: &mut [[[f64; C]; 2]; S],
) {
    for pivot in 0..S {
        let inverse = invert(&matrix[pivot][pivot]);
        for column in pivot + 1..S {
            matrix[pivot][column] = multiply(&inverse, &matrix[pivot][column]);
        }
        right[pivot] = multiply(&inverse, &right[pivot]);
        for row in 0..S {
            if row == pivot {
                continue;
            }
            let factor = matrix[row][pivot];
            for column in pivot + 1..S {
                let product = multiply(&factor, &matrix[pivot][column]);
                subtract(&mut matrix[row][column], &product);
            }
            let product = multiply(&factor, &right[pivot]);
            subtract(&mut right[row], &product);
        }
    }
}

#[inline]
fn invert(block: &[[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let scale = 1.0 / (block[0][0] * block[1][1] - block[0][1] * block[1][0]);
    [[block[1][1] * scale, -block[0][1] * scale], [-block[1][0] * scale, block[0][0] * scale]]
}

#[inline]
fn multiply<const C: usize>(left: &[[f64; 2]; 2], right: &[[f64; C]; 2]) -> [[f64; C]; 2] {
    let mut product = [[0.0; C]; 2];
    for row in 0..2 {
        for column in 0..C {
            product[row][column] = left[row][0] * right[0][column] + left[row][1] * right[1][column];
        }
    }
    product
}

#[inline]
fn subtract<const C: usize>(target: &mut [[f64; C]; 2], value: &[[f64; C]; 2]) {
    for row in 0..2 {
        for column in 0..C {
            target[row][column] -= value[row][column];
        }
    }
}
