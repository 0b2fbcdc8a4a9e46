//! Second derivatives of an interval, contracted with the costate of its end.
//!
//! They are the part of the model that the Gauss-Newton Hessian leaves out: the product of velocity and steering
//! angle in the yaw rate, and the curvature of the path. With large costates (an active ellipse) they are not small,
//! and without them the iteration oscillates.
//!
//! With Z the stage values, M = I - h A x J the matrix of the collocation equations and zeta the derivative of the
//! contracted end state by Z, the implicit part is zeta' Z'' = sum over stages of nu(j)' f''(j), where
//! nu(j) = h sum over i of A(i, j) eta(i) and M' eta = zeta: one transposed solve, no third-order tensors.

#![expect(clippy::needless_range_loop, reason = "small matrices read best by their indices")]

use crate::collocation::MAX_STAGES;
use crate::interval::{Interval, Linearisation, StageValues};
use crate::model::LateralSlope;
use crate::trig::sin_cos;

/// Symmetric second derivatives by (sideslip, yaw rate, yaw, velocity, steering) of the start and the control.
pub(crate) type Curvature = [[f64; 5]; 5];

/// Second derivatives of `costate' end` of an interval, linearised at these values by `linearisation`.
pub(crate) fn curvature(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &StageValues,
    linearisation: &Linearisation,
    costate: &[f64; 5],
) -> Curvature {
    match interval.collocation.stages {
        1 => curvature_stages::<1>(interval, start, control, stages, linearisation, costate),
        2 => curvature_stages::<2>(interval, start, control, stages, linearisation, costate),
        3 => curvature_stages::<3>(interval, start, control, stages, linearisation, costate),
        _ => curvature_stages::<4>(interval, start, control, stages, linearisation, costate),
    }
}

fn curvature_stages<const S: usize>(
    interval: &Interval,
    start: &[f64; 5],
    control: &[f64; 2],
    stages: &StageValues,
    linearisation: &Linearisation,
    costate: &[f64; 5],
) -> Curvature {
    let Interval { model, collocation, length } = *interval;
    let mut slopes = [LateralSlope::default(); S];
    model.slopes(*control, &stages[..S], &mut slopes);
    let mut result = [[0.0; 5]; 5];
    let mut zeta = [[0.0; 2]; S];

    for stage in 0..S {
        zeta[stage][0] += costate[0] * collocation.end[stage];
        zeta[stage][1] += costate[2] * collocation.end[stage];
        let weight = length * collocation.weights[stage];
        zeta[stage][1] += costate[1] * weight;

        // Course at the stage, its derivatives by the five variables, and the position's part.
        let mut course = start[1] + stages[stage][0];
        let columns = &linearisation.stages[stage][0];
        let mut slope = [columns[1], columns[2], 1.0, columns[3], columns[4]];
        for other in 0..S {
            let factor = length * collocation.integrals[stage][other];
            course += factor * stages[other][1];
            let columns = &linearisation.stages[other][1];
            for (slope, column) in slope.iter_mut().zip([columns[1], columns[2], 0.0, columns[3], columns[4]])
            {
                *slope += factor * column;
            }
        }
        let (sin, cos) = sin_cos(course);
        let across = weight * (costate[4] * cos - costate[3] * sin);
        let bend = -weight * control[0] * (costate[3] * cos + costate[4] * sin);
        for row in 0..5 {
            for column in 0..5 {
                result[row][column] += bend * slope[row] * slope[column];
            }
            result[row][3] += across * slope[row];
            result[3][row] += across * slope[row];
        }
        let by_course = control[0] * across;
        zeta[stage][0] += by_course;
        for other in 0..S {
            zeta[other][1] += by_course * length * collocation.integrals[stage][other];
        }
    }

    let mut matrix = [[[[0.0; 2]; 2]; S]; S];
    for stage in 0..S {
        let slope = slopes[stage].by_state;
        for row in 0..S {
            let factor = length * collocation.integrals[row][stage];
            // Block (row, stage) of M stands transposed at (stage, row).
            for first in 0..2 {
                for second in 0..2 {
                    matrix[stage][row][second][first] = -factor * slope[first][second];
                }
            }
        }
        matrix[stage][stage][0][0] += 1.0;
        matrix[stage][stage][1][1] += 1.0;
    }
    let mut eta = zeta.map(|pair| [[pair[0]], [pair[1]]]);
    crate::interval::eliminate(&mut matrix, &mut eta);

    for stage in 0..S {
        let mut weights = [0.0; 2];
        for row in 0..S {
            let factor = length * collocation.integrals[row][stage];
            weights[0] += factor * eta[row][0][0];
            weights[1] += factor * eta[row][1][0];
        }
        let inner = model.curvature(*control, stages[stage], weights);
        // Derivatives of (sideslip, yaw rate, velocity, steering) at the stage by the five variables.
        let mut by = [[0.0; 5]; 4];
        for component in 0..2 {
            let columns = &linearisation.stages[stage][component];
            by[component] = [columns[1], columns[2], 0.0, columns[3], columns[4]];
        }
        by[2][3] = 1.0;
        by[3][4] = 1.0;
        let mut product = [[0.0; 5]; 4];
        for row in 0..4 {
            for column in 0..5 {
                for middle in 0..4 {
                    product[row][column] += inner[row][middle] * by[middle][column];
                }
            }
        }
        for row in 0..5 {
            for column in 0..5 {
                for middle in 0..4 {
                    result[row][column] += by[middle][row] * product[middle][column];
                }
            }
        }
    }
    result
}

/// Largest number of stages this module is made for.
const _: () = assert!(MAX_STAGES == 4);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collocation::{Collocation, Scheme};
    use crate::propagate::propagate;
    use proptest::prelude::*;
    use vehicle::{Control, Parameters, State};

    proptest! {
        #[test]
        fn curvature_is_the_difference_of_sensitivities(
            sideslip in -0.15..0.15f64, yaw in -1.0..1.0f64, yaw_rate in -0.8..0.8f64,
            velocity in 0.12..1.0f64, steering in -0.06..0.06f64, which in 0..8usize,
            costate in prop::array::uniform5(-3.0..3.0f64),
        ) {
            let parameters = Parameters::default();
            let collocation = Collocation::new(Scheme::ALL[which]);
            let point = [sideslip, yaw_rate, yaw, velocity, steering];
            let gradient = |point: [f64; 5]| {
                let start = State { sideslip: point[0], yaw_rate: point[1], yaw: point[2], x: 0.0, y: 0.0 };
                let control = Control { velocity: point[3], steering: point[4] };
                let run = propagate(&parameters, &collocation, 0.4533, &start, &control).expect("converges");
                let state = |column: usize| (0..5).map(|row| costate[row] * run.by_state[row][column]).sum::<f64>();
                let by_control =
                    |column: usize| (0..5).map(|row| costate[row] * run.by_control[row][column]).sum::<f64>();
                [state(0), state(2), state(1), by_control(0), by_control(1)]
            };
            let interval = Interval { model: &parameters, collocation: &collocation, length: 0.4533 };
            let start = [sideslip, yaw, yaw_rate, 0.0, 0.0];
            let mut stages = [[sideslip, yaw_rate]; MAX_STAGES];
            let mut linearisation = Linearisation::default();
            for _ in 0..8 {
                linearisation = crate::interval::linearise(&interval, &start, &[velocity, steering], &stages);
                for (stage, change) in stages.iter_mut().zip(&linearisation.stages) {
                    stage[0] += change[0][0];
                    stage[1] += change[1][0];
                }
            }
            let exact = curvature(&interval, &start, &[velocity, steering], &stages, &linearisation, &costate);
            for column in 0..5 {
                let step = 1e-5;
                let shifted = |sign: f64| {
                    let mut moved = point;
                    moved[column] += sign * step;
                    gradient(moved)
                };
                let (ahead, behind) = (shifted(1.0), shifted(-1.0));
                for row in 0..5 {
                    let difference = (ahead[row] - behind[row]) / (2.0 * step);
                    // Newton's 1e-13 over the step, and third derivatives of up to 1 / u1^4 times the step squared.
                    prop_assert!((difference - exact[row][column]).abs() < 1e-5 * (1.0 + difference.abs()),
                        "{row} {column}: {difference} {}", exact[row][column]);
                }
            }
        }
    }
}
