//! The optimality conditions of the nonlinear program at an iterate, from their definition.
//!
//! Costates of the model are eliminated by the adjoint recursion, which makes the conditions on the states exact; what
//! remains is measured by natural residuals, which are zero exactly at a KKT point:
//! * controls, in shares of their range: `u - clamp(u - gradient / scale)`, where `scale` is 1, or a hundredth of the
//!   largest gradient of the smooth objective where that is more;
//! * soft limits, in their own units: `g - prox(g + multiplier)`;
//! * the model, in units of the state: gaps of the nodes and what Newton's method last changed at a stage.

use crate::dense::refill;
use crate::objective::{
    control_bounds, control_gradient, ellipse_excess, node_weights, reference, state_bounds,
};
use crate::problem::Problem;
use crate::qp::soft_residual;
use crate::rows::{bound_row, ellipse_row};
use crate::shooting::{Iterate, Shooting};

/// Multipliers at which second derivatives are taken.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Multipliers<'a> {
    /// Costates of the model at nodes 1 to N.
    pub costates: &'a [[f64; 5]],
    /// Multipliers of the soft rows.
    pub rows: &'a [f64],
}

/// Costates of the model at nodes 1 to N under the multipliers of the soft limits.
pub(crate) fn costates(
    problem: &Problem,
    iterate: &Iterate,
    shooting: &Shooting,
    row_multipliers: &[f64],
    costates: &mut Vec<[f64; 5]>,
) {
    let count = problem.intervals.len();
    let ellipses = problem.ellipses.len();
    refill(costates, count, [0.0; 5]);
    let mut costate = [0.0; 5];
    for node in (1..=count).rev() {
        let state = &iterate.states[node];
        let target = reference(problem, node);
        for (component, weight) in node_weights(problem, node).iter().enumerate() {
            costate[component] += 2.0 * weight * (state[component] - target[component])
                + row_multipliers[bound_row(node, component)];
        }
        for (which, ellipse) in problem.ellipses.iter().enumerate() {
            let (_, slope) = ellipse_excess(ellipse, node, state);
            let multiplier = row_multipliers[ellipse_row(count, ellipses, node, which)];
            costate[3] += multiplier * slope[0];
            costate[4] += multiplier * slope[1];
        }
        costates[node - 1] = costate;
        costate = shooting.intervals[node - 1].transport_back(&costate);
    }
}

/// Infinity norm of the scaled conditions at `iterate` with the multipliers of the soft limits; NaN where it has any.
///
/// `gradient` is a buffer.
pub(crate) fn residual(
    problem: &Problem,
    iterate: &Iterate,
    shooting: &Shooting,
    row_multipliers: &[f64],
    gradient: &mut Vec<f64>,
) -> f64 {
    let count = problem.intervals.len();
    let ellipses = problem.ellipses.len();
    let weights = &problem.weights;
    let mut largest = shooting.defect.max(shooting.last_step);
    let mut worse = |value: f64| {
        if value.abs() > largest || value.is_nan() {
            largest = value.abs();
        }
    };

    control_gradient(problem, iterate, gradient);
    let mut costate = [0.0; 5];
    let mut smooth_costate = [0.0; 5];
    let mut scale = 1.0f64;
    let (lower, upper) = control_bounds(problem);
    let range = [0, 1].map(|component: usize| upper[component] - lower[component]);
    for node in (1..=count).rev() {
        let state = &iterate.states[node];
        let target = reference(problem, node);
        let (state_lower, state_upper) = state_bounds(problem, node);
        for (component, weight) in node_weights(problem, node).iter().enumerate() {
            let slope = 2.0 * weight * (state[component] - target[component]);
            let multiplier = row_multipliers[bound_row(node, component)];
            smooth_costate[component] += slope;
            costate[component] += slope + multiplier;
            let (low, high) = (state_lower[component], state_upper[component]);
            let linear = weights.slack_linear;
            worse(soft_residual(state[component], low, high, multiplier, linear, weights.slack_quadratic));
        }
        for (which, ellipse) in problem.ellipses.iter().enumerate() {
            let (excess, slope) = ellipse_excess(ellipse, node, state);
            let multiplier = row_multipliers[ellipse_row(count, ellipses, node, which)];
            costate[3] += multiplier * slope[0];
            costate[4] += multiplier * slope[1];
            let linear = weights.slack_linear;
            worse(soft_residual(excess, f64::NEG_INFINITY, 0.0, multiplier, linear, weights.slack_quadratic));
        }
        let interval = &shooting.intervals[node - 1];
        for component in 0..2 {
            let entry = &mut gradient[2 * (node - 1) + component];
            let (mut total, mut smooth) = (*entry, *entry);
            for (row, by_control) in interval.by_control.iter().enumerate() {
                total += by_control[component] * costate[row];
                smooth += by_control[component] * smooth_costate[row];
            }
            *entry = total;
            scale = scale.max((smooth * range[component]).abs() / 100.0);
        }
        costate = interval.transport_back(&costate);
        smooth_costate = interval.transport_back(&smooth_costate);
    }
    for (control, gradient) in iterate.controls.iter().zip(gradient.chunks_exact(2)) {
        for component in 0..2 {
            if range[component] <= 0.0 {
                continue;
            }
            let share = (control[component] - lower[component]) / range[component];
            let moved = share - gradient[component] * range[component] / scale;
            // max and min instead of clamp: NaN must reach the comparison as NaN.
            worse(if moved.is_nan() { moved } else { share - moved.clamp(0.0, 1.0) });
        }
    }
    largest
}
