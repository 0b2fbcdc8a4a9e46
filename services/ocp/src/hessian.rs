//! The Hessian of the quadratic programs as one block per node, and its three kinds.
//!
//! Without the control differences, whose second derivatives are constant and always exact, the Lagrangian is a sum
//! over the nodes: block k holds its second derivatives by (state at node k, control of interval k), the terminal
//! block by the state alone. Gauss-Newton keeps the weights of the objective. Exact adds the curvature of the model
//! and of the ellipses, contracted with the multipliers; it may be indefinite, and is made convex block by block
//! where it is. BFGS starts from the weights and learns the rest of each block from the change of the gradient of the
//! Lagrangian between iterates.
//!
//! Source note: the source updates one BFGS matrix of the controls, because they are not correlated. The blocks here
//! are those of multiple shooting, before the states are eliminated: N small matrices learn in one step as much as
//! one large matrix in N steps.

#![expect(clippy::needless_range_loop, reason = "small matrices read best by their indices")]

use nalgebra::{SMatrix, SymmetricEigen};
use serde::{Deserialize, Serialize};

use crate::collocation::Collocation;
use crate::curvature::{Curvature, curvature};
use crate::dense::{dot, refill};
use crate::interval::Interval;
use crate::kkt::Multipliers;
use crate::objective::{ellipse_excess, node_weights};
use crate::problem::Problem;
use crate::rows::ellipse_row;
use crate::shooting::{Iterate, Shooting};

/// Second derivatives of the quadratic programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Hessian {
    /// The weights of the objective alone: convex, and independent of the multipliers.
    #[default]
    GaussNewton,
    /// One BFGS matrix per node with Powell's damping, from the gradients of the Lagrangian: the source's choice.
    Bfgs,
    /// Exact second derivatives; where the program is not convex with them, negative curvature of a block is cut off.
    Exact,
}

impl vehicle::Setting for Hessian {}

/// Second derivatives by (sideslip, yaw, yaw rate, x, y, velocity, steering) of a node and its interval.
pub(crate) type Block = [[f64; 7]; 7];

/// Blocks of the Gauss-Newton Hessian at nodes 0 to N.
pub(crate) fn gauss_newton(problem: &Problem, blocks: &mut Vec<Block>) {
    let count = problem.intervals.len();
    refill(blocks, count + 1, [[0.0; 7]; 7]);
    for (node, block) in blocks.iter_mut().enumerate() {
        // Node 0 is given.
        if node > 0 {
            for (component, weight) in node_weights(problem, node).iter().enumerate() {
                block[component][component] = 2.0 * weight;
            }
        }
        if node < count {
            for (component, weight) in problem.weights.control.iter().enumerate() {
                block[5 + component][5 + component] = 2.0 * weight;
            }
        }
    }
}

/// Blocks of the exact Hessian at nodes 0 to N.
pub(crate) fn exact(
    problem: &Problem,
    collocation: &Collocation,
    iterate: &Iterate,
    shooting: &Shooting,
    multipliers: Multipliers,
    blocks: &mut Vec<Block>,
) {
    /// Places of the variables of [`curvature`] in a block.
    const PLACES: [usize; 5] = [0, 2, 1, 5, 6];
    gauss_newton(problem, blocks);
    let count = problem.intervals.len();
    let ellipses = problem.ellipses.len();
    for node in 0..count {
        let bend = bend(problem, collocation, Point { iterate, shooting }, multipliers, node);
        // The state at node 0 does not move.
        let first = if node == 0 { 3 } else { 0 };
        for row in first..5 {
            for column in first..5 {
                blocks[node][PLACES[row]][PLACES[column]] += bend[row][column];
            }
        }
    }
    for node in 1..=count {
        for (which, ellipse) in problem.ellipses.iter().enumerate() {
            let multiplier = multipliers.rows[ellipse_row(count, ellipses, node, which)];
            blocks[node][3][3] -= 2.0 * multiplier / (ellipse.a * ellipse.a);
            blocks[node][4][4] -= 2.0 * multiplier / (ellipse.b * ellipse.b);
        }
    }
}

/// Second derivatives of interval `index`, contracted with the costate of its end.
pub(crate) fn bend(
    problem: &Problem,
    collocation: &Collocation,
    Point { iterate, shooting }: Point,
    multipliers: Multipliers,
    index: usize,
) -> Curvature {
    let length = problem.intervals[index];
    // Seen from the frame in which the interval is driven.
    let mut costate = multipliers.costates[index];
    [costate[3], costate[4]] = shooting.intervals[index].back([costate[3], costate[4]]);
    curvature(
        &Interval { model: problem.model.as_ref(), collocation, length },
        &iterate.states[index],
        &iterate.controls[index],
        &iterate.stages[index],
        &shooting.intervals[index],
        &costate,
    )
}

/// Cuts off the negative curvature of each block.
pub(crate) fn convexify(blocks: &mut [Block]) {
    /// Twenty steps are usual; the limit ends it for numbers that are not finite.
    const STEPS: usize = 200;
    for block in blocks {
        let matrix = SMatrix::<f64, 7, 7>::from_fn(|row, column| block[row][column]);
        let Some(eigen) = SymmetricEigen::try_new(matrix, f64::EPSILON, STEPS) else { continue };
        if eigen.eigenvalues.iter().all(|&value| value >= 0.0) {
            continue;
        }
        let vectors = &eigen.eigenvectors;
        for row in 0..7 {
            for column in 0..7 {
                block[row][column] = (0..7)
                    .map(|k| vectors[(row, k)] * eigen.eigenvalues[k].max(0.0) * vectors[(column, k)])
                    .sum();
            }
        }
    }
}

/// An iterate with its linearisation.
#[derive(Clone, Copy)]
pub(crate) struct Point<'a> {
    pub iterate: &'a Iterate,
    pub shooting: &'a Shooting,
}

/// The start of the BFGS blocks: Gauss-Newton's, with a small curvature where that has none.
pub(crate) fn start_bfgs(problem: &Problem, blocks: &mut Vec<Block>) {
    /// Small compared to the curvature of an objective of order one; the update needs a positive one.
    const MIN_CURVATURE: f64 = 1e-3;
    gauss_newton(problem, blocks);
    for block in blocks {
        for component in 0..7 {
            block[component][component] = block[component][component].max(MIN_CURVATURE);
        }
    }
}

/// The BFGS update of all blocks after a step from `before` to `after`, with the multipliers that hold after it.
pub(crate) fn update_bfgs(
    problem: &Problem,
    before: Point,
    after: Point,
    multipliers: Multipliers,
    blocks: &mut [Block],
) {
    let count = problem.intervals.len();
    for (node, block) in blocks.iter_mut().enumerate() {
        let mut step = [0.0; 7];
        let mut change = [0.0; 7];
        if node > 0 {
            let (old, new) = (&before.iterate.states[node], &after.iterate.states[node]);
            let weights = node_weights(problem, node);
            for component in 0..5 {
                step[component] = new[component] - old[component];
                change[component] = 2.0 * weights[component] * step[component];
            }
            for (which, ellipse) in problem.ellipses.iter().enumerate() {
                let multiplier = multipliers.rows[ellipse_row(count, problem.ellipses.len(), node, which)];
                let (_, old) = ellipse_excess(ellipse, node, old);
                let (_, new) = ellipse_excess(ellipse, node, new);
                change[3] += multiplier * (new[0] - old[0]);
                change[4] += multiplier * (new[1] - old[1]);
            }
        }
        if node < count {
            let costate = &multipliers.costates[node];
            let (old, new) = (&before.shooting.intervals[node], &after.shooting.intervals[node]);
            for component in 0..2 {
                let place = 5 + component;
                step[place] =
                    after.iterate.controls[node][component] - before.iterate.controls[node][component];
                change[place] = 2.0 * problem.weights.control[component] * step[place];
                for row in 0..5 {
                    let difference = new.by_control[row][component] - old.by_control[row][component];
                    change[place] += costate[row] * difference;
                }
            }
            if node > 0 {
                let (old, new) = (old.transport_back(costate), new.transport_back(costate));
                for component in 0..5 {
                    change[component] += new[component] - old[component];
                }
            }
        }
        update(block, &step, &change);
    }
}

/// One BFGS update with Powell's damping, which keeps the block positive definite.
fn update(block: &mut Block, step: &[f64; 7], change: &[f64; 7]) {
    /// Smallest curvature along the step, as a share of the block's own (Powell's value).
    const SHARE: f64 = 0.2;
    /// Largest curvature of one update: that of an ellipse under the multiplier 500. Powell's damping alone has no
    /// such bound, and where the exact block is indefinite it gives matrices that no solver can use.
    const MAX_CURVATURE: f64 = 1e3;
    /// After these, almost nothing of the change is left.
    const HALVINGS: u32 = 30;
    /// Smaller curvature along a step is a rounding error for an objective of order one; the block stays.
    const MIN_STEP_CURVATURE: f64 = 1e-20;
    let product = block.map(|row| dot(&row, step));
    let present = dot(&product, step);
    let found = dot(change, step);
    if !found.is_finite() || present.is_nan() || present <= MIN_STEP_CURVATURE {
        return;
    }
    let mut keep = if found >= SHARE * present { 1.0 } else { (1.0 - SHARE) * present / (present - found) };
    let mut target = [0.0; 7];
    let mut curvature = present;
    for _ in 0..HALVINGS {
        for place in 0..7 {
            target[place] = keep * change[place] + (1.0 - keep) * product[place];
        }
        curvature = dot(&target, step);
        if dot(&target, &target) <= MAX_CURVATURE * curvature {
            break;
        }
        keep *= 0.5;
    }
    for row in 0..7 {
        for column in 0..7 {
            block[row][column] +=
                target[row] * target[column] / curvature - product[row] * product[column] / present;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eigenvalues(block: &Block) -> Vec<f64> {
        let matrix = SMatrix::<f64, 7, 7>::from_fn(|row, column| block[row][column]);
        matrix.symmetric_eigenvalues().iter().copied().collect()
    }

    #[test]
    fn an_update_adopts_the_curvature_along_the_step() {
        let mut block = [[0.0; 7]; 7];
        for place in 0..7 {
            block[place][place] = 1.0;
        }
        let step = [0.1, -0.2, 0.3, 0.0, 0.1, 0.2, -0.1];
        // The secant equation holds where the curvature is positive.
        let change = step.map(|entry| 3.0 * entry);
        update(&mut block, &step, &change);
        for (row, expected) in block.iter().zip(&change) {
            assert!((dot(row, &step) - expected).abs() < 1e-14);
        }
        // Negative curvature is damped to a fifth of the present 3 |step|^2.
        let change = step.map(|entry| -entry);
        update(&mut block, &step, &change);
        let along = dot(&block.map(|row| dot(&row, &step)), &step);
        assert!((along - 0.6 * dot(&step, &step)).abs() < 1e-14);
        assert!(eigenvalues(&block).iter().all(|&value| value > 0.0));
    }

    #[test]
    fn convex_blocks_lose_their_negative_curvature_only() {
        let mut blocks = [[[0.0; 7]; 7]; 2];
        for place in 0..7 {
            blocks[0][place][place] = place as f64;
            blocks[1][place][place] = place as f64;
        }
        // The block of places 5 and 6 gets the eigenvalues of ((5, 6), (6, 6)): 11.52 and -0.52.
        blocks[1][5][6] = 6.0;
        blocks[1][6][5] = 6.0;
        let before = blocks;
        convexify(&mut blocks);
        assert_eq!(blocks[0], before[0]);
        let values = eigenvalues(&blocks[1]);
        assert!(values.iter().all(|&value| value > -1e-12));
        let largest = values.iter().copied().fold(0.0, f64::max);
        assert!((largest - (5.5 + (0.25f64 + 36.0).sqrt())).abs() < 1e-12, "{largest}");
        blocks[0][3][3] = f64::NAN;
        convexify(&mut blocks);
    }
}
