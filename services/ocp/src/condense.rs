//! Condensing: the node states are eliminated with the linearised model, so that a quadratic program in the 2N
//! changes of the controls remains.
//!
//! The change of the state at node k is `sum over j < k of G(k, j) v(j) + e(k)`, with G from the sensitivities of the
//! intervals and e from their gaps. The objective is quadratic in the node states, so the Gauss-Newton Hessian
//! `sum of G' 2 W G` plus that of the controls lacks only the curvature of the model and of the ellipses. The rows of
//! G at a node serve three times: in the Hessian, as rows of the state bounds, and for the rows of the ellipses.
//!
//! Work grows with N^3, so it serves short horizons, and only where the search by stages ([`crate::chain`]) fails.

use crate::dense::refill;
use crate::hessian::Block;
use crate::interval::Linearisation;
use crate::objective::{
    control_bounds, control_gradient, ellipse_excess, node_weights, reference, state_bounds,
};
use crate::problem::Problem;
use crate::qp::Qp;
use crate::rows::{bound_row, ellipse_row};
use crate::shooting::{Iterate, Shooting};

/// Fills `qp` with the program in the changes of the controls at `iterate`.
///
/// `damping` is added to the diagonal of the Hessian; it shortens steps and does not change the solution of the
/// nonlinear program.
pub(crate) fn condense(problem: &Problem, iterate: &Iterate, shooting: &Shooting, damping: f64, qp: &mut Qp) {
    let count = problem.intervals.len();
    let width = 2 * count;
    let ellipses = problem.ellipses.len();
    let row_count = (5 + ellipses) * count;
    refill(&mut qp.rows, row_count * width, 0.0);
    refill(&mut qp.row_lower, row_count, 0.0);
    refill(&mut qp.row_upper, row_count, 0.0);
    refill(&mut qp.hessian, width * width, 0.0);
    control_gradient(problem, iterate, &mut qp.gradient);
    qp.slack_linear = problem.weights.slack_linear;
    qp.slack_quadratic = problem.weights.slack_quadratic;

    let mut offset = [0.0; 5];
    for node in 1..=count {
        let interval = &shooting.intervals[node - 1];
        let used = 2 * node;
        predict(&mut qp.rows, width, node, interval);
        offset = interval.transport(&offset);
        for (offset, gap) in offset.iter_mut().zip(&shooting.gaps[node - 1]) {
            *offset += gap;
        }

        let state = &iterate.states[node];
        let target = reference(problem, node);
        let (state_lower, state_upper) = state_bounds(problem, node);
        let weights = node_weights(problem, node);
        for component in 0..5 {
            let index = bound_row(node, component);
            let row = &qp.rows[index * width..index * width + used];
            let moved = state[component] + offset[component];
            qp.row_lower[index] = state_lower[component] - moved;
            qp.row_upper[index] = state_upper[component] - moved;
            let weight = 2.0 * weights[component];
            if weight == 0.0 {
                continue;
            }
            let slope = weight * (moved - target[component]);
            for (gradient, entry) in qp.gradient.iter_mut().zip(row) {
                *gradient += slope * entry;
            }
            add_square(weight, row, width, &mut qp.hessian);
        }
        for (which, ellipse) in problem.ellipses.iter().enumerate() {
            let (excess, slope) = ellipse_excess(ellipse, node, state);
            let index = ellipse_row(count, ellipses, node, which);
            let (states, rest) = qp.rows.split_at_mut(index * width);
            let along = &states[bound_row(node, 3) * width..][..used];
            let across = &states[bound_row(node, 4) * width..][..used];
            for ((entry, along), across) in rest.iter_mut().zip(along).zip(across) {
                *entry = slope[0] * along + slope[1] * across;
            }
            qp.row_lower[index] = f64::NEG_INFINITY;
            qp.row_upper[index] = -(excess + slope[0] * offset[3] + slope[1] * offset[4]);
        }
    }
    add_controls(problem, damping, &mut qp.hessian);
    mirror(&mut qp.hessian, width);
    limits(problem, iterate, qp);
}

/// Fills `hessian` with the condensed `blocks` of nodes 0 to N, with the `rows` that [`condense`] has filled.
pub(crate) fn condense_blocks(
    problem: &Problem,
    blocks: &[Block],
    damping: f64,
    rows: &[f64],
    hessian: &mut Vec<f64>,
) {
    let width = 2 * problem.intervals.len();
    refill(hessian, width * width, 0.0);
    for (node, block) in blocks.iter().enumerate() {
        add_product(block, [0, 1, 2, 3, 4], width, node, rows, hessian);
    }
    add_changes(problem, damping, hessian);
    mirror(hessian, width);
}

/// Adds `weight * row row'` to the lower triangle.
#[inline]
fn add_square(weight: f64, row: &[f64], width: usize, hessian: &mut [f64]) {
    for (position, entry) in row.iter().enumerate() {
        let factor = weight * entry;
        let line = &mut hessian[position * width..=position * width + position];
        for (target, entry) in line.iter_mut().zip(row) {
            *target += factor * entry;
        }
    }
}

/// Rows of G at `node` from those at the node before.
#[inline]
fn predict(rows: &mut [f64], width: usize, node: usize, interval: &Linearisation) {
    let used = 2 * (node - 1);
    let (before, here) = rows.split_at_mut(bound_row(node, 0) * width);
    let before = if node > 1 { &before[bound_row(node - 1, 0) * width..] } else { &[] };
    for component in 0..5 {
        let row = &mut here[component * width..(component + 1) * width];
        if used > 0 {
            let lateral = interval.by_lateral[component];
            let (sideslip, yaw, yaw_rate) =
                (&before[..used], &before[width..][..used], &before[2 * width..][..used]);
            for position in 0..used {
                let mut value = lateral[0] * sideslip[position] + lateral[1] * yaw_rate[position];
                if component == 1 {
                    value += yaw[position];
                }
                if component >= 3 {
                    let place = [before[3 * width + position], before[4 * width + position]];
                    value += interval.forth(place)[component - 3];
                    value += interval.by_yaw[component - 3] * yaw[position];
                }
                row[position] = value;
            }
        }
        row[used] = interval.by_control[component][0];
        row[used + 1] = interval.by_control[component][1];
    }
}

/// Adds second derivatives by these components of the state at `node`, then by the controls after it.
fn add_product<const S: usize, const V: usize>(
    block: &[[f64; V]; V],
    components: [usize; S],
    width: usize,
    node: usize,
    rows: &[f64],
    hessian: &mut [f64],
) {
    let used = 2 * node;
    let states: [&[f64]; S] = if node > 0 {
        components.map(|component| &rows[bound_row(node, component) * width..][..used])
    } else {
        [&[]; S]
    };
    for position in 0..used {
        let mut mixed = [0.0; V];
        for (state, line) in states.iter().zip(block) {
            for (mixed, entry) in mixed.iter_mut().zip(line) {
                *mixed += state[position] * entry;
            }
        }
        for (state, factor) in states.iter().zip(mixed) {
            let line = &mut hessian[position * width..=position * width + position];
            for (target, entry) in line.iter_mut().zip(*state) {
                *target += factor * entry;
            }
        }
        if used < width {
            hessian[used * width + position] += mixed[S];
            hessian[(used + 1) * width + position] += mixed[S + 1];
        }
    }
    if used < width {
        hessian[used * width + used] += block[S][S];
        hessian[(used + 1) * width + used] += block[S + 1][S];
        hessian[(used + 1) * width + used + 1] += block[S + 1][S + 1];
    }
}

/// Adds the controls' own part and the damping to the lower triangle.
fn add_controls(problem: &Problem, damping: f64, hessian: &mut [f64]) {
    let width = 2 * problem.intervals.len();
    for position in 0..width {
        hessian[position * width + position] += 2.0 * problem.weights.control[position % 2];
    }
    add_changes(problem, damping, hessian);
}

/// Damping on the diagonal of the two controls of an interval: in units of the objective per square of their range.
pub(crate) fn control_damping(problem: &Problem, damping: f64) -> [f64; 2] {
    let bounds = &problem.bounds;
    let range = [bounds.velocity_max_mps - bounds.velocity_min_mps, 2.0 * bounds.steering_max_rad];
    range.map(|range| damping / (range * range).max(1e-12))
}

/// Adds the part of the control differences and the damping to the lower triangle.
fn add_changes(problem: &Problem, damping: f64, hessian: &mut [f64]) {
    let count = problem.intervals.len();
    let width = 2 * count;
    let weights = &problem.weights;
    let damping = control_damping(problem, damping);
    for index in 0..count {
        for (component, damping) in damping.iter().enumerate() {
            let position = 2 * index + component;
            let earlier = if index > 0 || problem.previous.is_some() { 1.0 } else { 0.0 };
            let later = if index + 1 < count { 1.0 } else { 0.0 };
            hessian[position * width + position] +=
                2.0 * weights.change[component] * (earlier + later) + damping;
            if index > 0 {
                hessian[position * width + position - 2] -= 2.0 * weights.change[component];
            }
        }
    }
}

fn mirror(hessian: &mut [f64], width: usize) {
    for row in 1..width {
        for column in 0..row {
            hessian[column * width + row] = hessian[row * width + column];
        }
    }
}

fn limits(problem: &Problem, iterate: &Iterate, qp: &mut Qp) {
    let (lower, upper) = control_bounds(problem);
    qp.lower.clear();
    qp.upper.clear();
    for control in &iterate.controls {
        for component in 0..2 {
            qp.lower.push(lower[component] - control[component]);
            qp.upper.push(upper[component] - control[component]);
        }
    }
}

#[cfg(test)]
mod tests;
