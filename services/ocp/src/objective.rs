//! The objective of the program and its exact penalties.
//!
//! With e the distance to the reference, g the excess over a soft limit and s = max(0, g), the objective is
//!
//!   sum over nodes 1 to N of  sum_i w_i e_i^2  +  sum over soft limits of (L1 s + L2 s^2)
//!   + sum over intervals of  sum_j c_j (u_j - ref_j)^2 + d_j (u_j - u_j of the interval before)^2 .
//!
//! There is no factor 1/2. Soft limits at each node are the five bounds of the state, in their own units, and
//! g = 1 - ((x - xh)/a)^2 - ((y - yh)/b)^2 of each ellipse, (7.34). Each limit has its own slack; one L1 and one L2
//! hold for all. The penalty is exact: a limit that can be kept is kept when L1 exceeds its multiplier.

use crate::problem::{EllipsePath, Problem};
use crate::shooting::Iterate;

/// L1 s + L2 s^2 with s = max(0, excess).
#[inline]
pub(crate) fn penalty(problem: &Problem, excess: f64) -> f64 {
    if excess > 0.0 {
        excess * (problem.weights.slack_linear + problem.weights.slack_quadratic * excess)
    } else if excess.is_nan() {
        excess
    } else {
        0.0
    }
}

/// Lower and upper soft bounds of (sideslip, yaw, yaw rate, x, y) at `node` (1 to N).
#[inline]
pub(crate) fn state_bounds(problem: &Problem, node: usize) -> ([f64; 5], [f64; 5]) {
    let bounds = &problem.bounds;
    let limits = [bounds.sideslip_max_rad, bounds.yaw_max_rad, bounds.yaw_rate_max_radps];
    let [low, high] = problem.frames.get(node - 1).map_or(problem.y_range, |frame| frame.y_range);
    (
        [-limits[0], -limits[1], -limits[2], problem.x_range[0], low],
        [limits[0], limits[1], limits[2], problem.x_range[1], high],
    )
}

/// Lower and upper hard bounds of (velocity, steering).
pub(crate) fn control_bounds(problem: &Problem) -> ([f64; 2], [f64; 2]) {
    let bounds = &problem.bounds;
    ([bounds.velocity_min_mps, -bounds.steering_max_rad], [bounds.velocity_max_mps, bounds.steering_max_rad])
}

/// Excess g of an ellipse at node `node` and its derivatives by x and y, (7.34).
#[inline]
pub(crate) fn ellipse_excess(ellipse: &EllipsePath, node: usize, state: &[f64; 5]) -> (f64, [f64; 2]) {
    let centre = ellipse.centres[node];
    let along = (state[3] - centre[0]) / ellipse.a;
    let across = (state[4] - centre[1]) / ellipse.b;
    (1.0 - along * along - across * across, [-2.0 * along / ellipse.a, -2.0 * across / ellipse.b])
}

/// Weights of the state at `node` (1 to N).
#[inline]
pub(crate) fn node_weights(problem: &Problem, node: usize) -> [f64; 5] {
    let weights = &problem.weights;
    let mut row = if node == problem.intervals.len() { weights.terminal } else { weights.node };
    for (_, more) in weights.goal.iter().filter(|(at, _)| *at == node) {
        row[4] += more;
    }
    row
}

/// Reference of the state at `node` (1 to N).
#[inline]
pub(crate) fn reference(problem: &Problem, node: usize) -> [f64; 5] {
    problem.references[node - 1].to_vector().into()
}

/// The smooth part of the objective at `iterate`.
pub(crate) fn smooth(problem: &Problem, iterate: &Iterate) -> f64 {
    let weights = &problem.weights;
    let mut sum = 0.0;
    for node in 1..iterate.states.len() {
        let (state, reference) = (&iterate.states[node], reference(problem, node));
        for (component, weight) in node_weights(problem, node).iter().enumerate() {
            sum += weight * (state[component] - reference[component]).powi(2);
        }
    }
    let mut before = problem.previous.map(|control| [control.velocity, control.steering]);
    for (interval, control) in iterate.controls.iter().enumerate() {
        let centre = problem.control_reference(interval);
        for component in 0..2 {
            sum += weights.control[component] * (control[component] - centre[component]).powi(2);
            if let Some(before) = before {
                sum += weights.change[component] * (control[component] - before[component]).powi(2);
            }
        }
        before = Some(*control);
    }
    sum
}

/// The penalties at `iterate`, and the largest slack of an ellipse.
pub(crate) fn penalties(problem: &Problem, iterate: &Iterate) -> (f64, f64) {
    let (mut sum, mut slack) = (0.0, 0.0f64);
    for (node, state) in iterate.states.iter().enumerate().skip(1) {
        let (lower, upper) = state_bounds(problem, node);
        for component in 0..5 {
            let excess = (lower[component] - state[component]).max(state[component] - upper[component]);
            sum += penalty(problem, excess);
        }
        for ellipse in &problem.ellipses {
            let (excess, _) = ellipse_excess(ellipse, node, state);
            sum += penalty(problem, excess);
            slack = slack.max(excess);
        }
    }
    (sum, slack)
}

/// The penalties of the soft limits linearised at `iterate`, after a full `step`.
pub(crate) fn linearised_penalties(problem: &Problem, iterate: &Iterate, step: &Iterate) -> f64 {
    let mut sum = 0.0;
    for (node, (state, change)) in iterate.states.iter().zip(&step.states).enumerate().skip(1) {
        let (lower, upper) = state_bounds(problem, node);
        for component in 0..5 {
            let moved = state[component] + change[component];
            sum += penalty(problem, (lower[component] - moved).max(moved - upper[component]));
        }
        for ellipse in &problem.ellipses {
            let (excess, slope) = ellipse_excess(ellipse, node, state);
            sum += penalty(problem, excess + slope[0] * change[3] + slope[1] * change[4]);
        }
    }
    sum
}

/// Slope of the smooth part along `step`.
pub(crate) fn smooth_slope(problem: &Problem, iterate: &Iterate, step: &Iterate) -> f64 {
    let weights = &problem.weights;
    let mut slope = 0.0;
    for node in 1..iterate.states.len() {
        let (state, change, reference) =
            (&iterate.states[node], &step.states[node], reference(problem, node));
        for (component, weight) in node_weights(problem, node).iter().enumerate() {
            slope += weight * (state[component] - reference[component]) * change[component];
        }
    }
    let mut before = problem.previous.map(|control| ([control.velocity, control.steering], [0.0; 2]));
    for (interval, (control, change)) in iterate.controls.iter().zip(&step.controls).enumerate() {
        let centre = problem.control_reference(interval);
        for component in 0..2 {
            slope +=
                weights.control[component] * (control[component] - centre[component]) * change[component];
            if let Some((before, change_before)) = before {
                let difference = control[component] - before[component];
                slope +=
                    weights.change[component] * difference * (change[component] - change_before[component]);
            }
        }
        before = Some((*control, *change));
    }
    2.0 * slope
}

/// Gradient of the smooth part by the controls alone, two numbers per interval.
pub(crate) fn control_gradient(problem: &Problem, iterate: &Iterate, gradient: &mut Vec<f64>) {
    let weights = &problem.weights;
    gradient.clear();
    for (index, control) in iterate.controls.iter().enumerate() {
        let centre = problem.control_reference(index);
        let before = match (index, problem.previous) {
            (0, None) => *control,
            (0, Some(previous)) => [previous.velocity, previous.steering],
            _ => iterate.controls[index - 1],
        };
        let after = iterate.controls.get(index + 1).unwrap_or(control);
        for component in 0..2 {
            let value = control[component];
            gradient.push(
                2.0 * weights.control[component] * (value - centre[component])
                    + 2.0
                        * weights.change[component]
                        * ((value - before[component]) - (after[component] - value)),
            );
        }
    }
}
