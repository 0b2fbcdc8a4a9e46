//! How the soft rows of a quadratic program are numbered: the bounds of the state node by node, then the ellipses.

use crate::objective::{ellipse_excess, state_bounds};
use crate::problem::{Limit, Problem};
use crate::shooting::Iterate;

/// Row of the program that belongs to the bound of a state component at a node (1 to N).
#[inline]
pub(crate) fn bound_row(node: usize, component: usize) -> usize {
    5 * (node - 1) + component
}

/// Row of the program that belongs to an ellipse at a node (1 to N) of `count` nodes.
#[inline]
pub(crate) fn ellipse_row(count: usize, ellipses: usize, node: usize, ellipse: usize) -> usize {
    5 * count + ellipses * (node - 1) + ellipse
}

/// What a row of the program of `count` nodes is, with its node.
pub(crate) fn limit_of_row(count: usize, ellipses: usize, row: usize) -> (usize, Limit) {
    if row < 5 * count {
        (row / 5 + 1, Limit::State(row % 5))
    } else {
        let place = row - 5 * count;
        (place / ellipses + 1, Limit::Ellipse(place % ellipses))
    }
}

/// How far `iterate` is above the upper limit of a row of the program, or below the lower one as a negative number.
pub(crate) fn row_excess(problem: &Problem, iterate: &Iterate, row: usize, upper: bool) -> f64 {
    let (node, limit) = limit_of_row(problem.intervals.len(), problem.ellipses.len(), row);
    match limit {
        Limit::State(component) => {
            let (low, high) = state_bounds(problem, node);
            iterate.states[node][component] - if upper { high[component] } else { low[component] }
        }
        Limit::Ellipse(which) => ellipse_excess(&problem.ellipses[which], node, &iterate.states[node]).0,
    }
}
