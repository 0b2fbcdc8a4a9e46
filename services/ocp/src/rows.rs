//! How the soft rows of a quadratic program are numbered: the bounds of the state node by node, then the ellipses.

use crate::objective::{ellipse_excess, state_bounds};
use crate::problem::Problem;
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

/// How far `iterate` is above the upper limit of a row of the program, or below the lower one as a negative number.
pub(crate) fn row_excess(problem: &Problem, iterate: &Iterate, row: usize, upper: bool) -> f64 {
    let count = problem.intervals.len();
    if row < 5 * count {
        let (node, component) = (row / 5 + 1, row % 5);
        let (low, high) = state_bounds(problem, node);
        iterate.states[node][component] - if upper { high[component] } else { low[component] }
    } else {
        let place = row - 5 * count;
        let (node, which) = (place / problem.ellipses.len() + 1, place % problem.ellipses.len());
        ellipse_excess(&problem.ellipses[which], node, &iterate.states[node]).0
    }
}
