//! The quadratic program of one iteration with its node states: a chain of stages, solved in time linear in their
//! number.
//!
//! It is the program of [`crate::qp`] before the states are eliminated:
//!
//! minimise sum over nodes of 1/2 (x, u)' B (x, u) + q' (x, u) + sum over intervals of d (u - u of the interval
//! before)^2 subject to x(k+1) = A x(k) + C u(k) + gap(k), x(0) = 0, bounds of u, and the soft rows of each node.
//!
//! [`riccati`] solves it with some controls held, some rows as penalties and some as equations; [`active_set`] finds
//! which, [`dual`] and [`interior`] are other methods for where that fails, and [`newton`] makes the step with the exact
//! Hessian. Rows and controls are numbered as in the condensed program, so that both write the same kind of solution.

mod active_set;
mod dual;
mod interior;
mod newton;
mod riccati;

use crate::condense::control_damping;
use crate::dense::{fill, refill};
use crate::hessian::Block;
use crate::objective::{
    control_bounds, control_gradient, ellipse_excess, node_weights, reference, state_bounds,
};
use crate::problem::Problem;
use crate::qp::active_set::{ActiveSet, Constraint};
use crate::qp::{BoundState, QpSolution};
use crate::rows::{bound_row, ellipse_row};
use crate::shooting::{Iterate, Shooting};

pub(crate) use riccati::{Path, Riccati};

/// A soft row: `factors[0] * x[places[0]] + factors[1] * x[places[1]]` at a node.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    node: usize,
    places: [usize; 2],
    factors: [f64; 2],
    lower: f64,
    upper: f64,
}

impl Row {
    fn value(&self, states: &[[f64; 5]]) -> f64 {
        let state = &states[self.node];
        self.factors[0] * state[self.places[0]] + self.factors[1] * state[self.places[1]]
    }

    /// Adds `weight` times the square of the row.
    fn add_square(&self, weight: f64, blocks: &mut [Block]) {
        let block = &mut blocks[self.node];
        for (&row, left) in self.places.iter().zip(self.factors) {
            for (&column, right) in self.places.iter().zip(self.factors) {
                block[row][column] += weight * left * right;
            }
        }
    }

    /// Adds `weight` times the row to the slope of its node.
    fn add_to(&self, weight: f64, slope: &mut [f64; 7]) {
        for (&place, factor) in self.places.iter().zip(self.factors) {
            slope[place] += weight * factor;
        }
    }
}

/// The program and the buffers of its solvers.
#[derive(Debug, Clone, Default)]
pub(crate) struct Chain {
    /// q at nodes 0 to N.
    slopes: Vec<[f64; 7]>,
    /// Bounds of the controls, two per interval.
    lower: Vec<f64>,
    upper: Vec<f64>,
    rows: Vec<Row>,
    /// 2 d of the two controls.
    change: [f64; 2],
    /// Whether the change of the first control is weighted as well.
    tied: bool,
    damping: [f64; 2],
    slack_linear: f64,
    slack_quadratic: f64,

    riccati: Riccati,
    path: Path,
    /// The point from which Newton's step starts.
    point: Path,
    /// B and q with what the solver adds to them.
    blocks: Vec<Block>,
    sums: Vec<[f64; 7]>,
    /// Derivatives of the objective at the point of the interior-point method.
    base: Vec<[f64; 7]>,
    held: Vec<f64>,
    equations: Vec<usize>,
    violations: Vec<f64>,
    /// Responses of the states and controls to the multipliers of the equations.
    responses: Vec<Path>,
    schur: Vec<f64>,
    schur_factor: Vec<f64>,
    multipliers: Vec<f64>,
    sides: Vec<interior::Side>,
    dual: ActiveSet,
    /// Constraints that have a response in the dual method, with their signs, and a list with nothing held.
    joined: Vec<(Constraint, f64)>,
    unheld: Vec<BoundState>,
    /// The solution of the search, until it is known to be one.
    exact: QpSolution,
    /// Whether the recursion is factorised for the last set that was solved.
    is_factorised: bool,
}

impl Chain {
    /// Fills the program except for the blocks, which the caller hands to the solvers.
    pub(crate) fn build(
        &mut self,
        problem: &Problem,
        iterate: &Iterate,
        damping: f64,
        gradient: &mut Vec<f64>,
    ) {
        let count = problem.intervals.len();
        let ellipses = problem.ellipses.len();
        let weights = &problem.weights;
        control_gradient(problem, iterate, gradient);
        self.change = weights.change.map(|change| 2.0 * change);
        self.tied = problem.previous.is_some();
        self.damping = control_damping(problem, damping);
        self.is_factorised = false;
        self.slack_linear = weights.slack_linear;
        self.slack_quadratic = weights.slack_quadratic;

        let (lower, upper) = control_bounds(problem);
        self.lower.clear();
        self.upper.clear();
        for control in &iterate.controls {
            self.lower.extend((0..2).map(|component| lower[component] - control[component]));
            self.upper.extend((0..2).map(|component| upper[component] - control[component]));
        }

        refill(&mut self.slopes, count + 1, [0.0; 7]);
        refill(&mut self.rows, (5 + ellipses) * count, Row::default());
        for (slope, pair) in self.slopes.iter_mut().zip(gradient.chunks_exact(2)) {
            slope[5..].copy_from_slice(pair);
        }
        for node in 1..=count {
            let (low, high) = state_bounds(problem, node);
            let state = &iterate.states[node];
            let target = reference(problem, node);
            let weights = node_weights(problem, node);
            for component in 0..5 {
                let value = state[component];
                self.slopes[node][component] = 2.0 * weights[component] * (value - target[component]);
                self.rows[bound_row(node, component)] = Row {
                    node,
                    places: [component; 2],
                    factors: [1.0, 0.0],
                    lower: low[component] - value,
                    upper: high[component] - value,
                };
            }
            for (which, ellipse) in problem.ellipses.iter().enumerate() {
                let (excess, factors) = ellipse_excess(ellipse, node, state);
                self.rows[ellipse_row(count, ellipses, node, which)] =
                    Row { node, places: [3, 4], factors, lower: f64::NEG_INFINITY, upper: -excess };
            }
        }
    }

    /// Solves the program with the convex `blocks`, from the active set in `solution`.
    ///
    /// False where the search does not end; then `solution` is as before.
    pub(crate) fn solve(&mut self, shooting: &Shooting, blocks: &[Block], solution: &mut QpSolution) -> bool {
        self.is_factorised = false;
        self.try_search(shooting, blocks, solution)
    }

    /// As [`Chain::solve`] after it, for other gaps: where the active set is the same, nothing is factorised.
    pub(crate) fn solve_again(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
    ) -> bool {
        self.try_search(shooting, blocks, solution)
    }

    /// Solves with the interior-point method, then exactly where its active set is right; false where it does not end.
    pub(crate) fn solve_from_inside(
        &mut self,
        shooting: &Shooting,
        blocks: &[Block],
        solution: &mut QpSolution,
    ) -> bool {
        self.is_factorised = false;
        self.solve_interior(shooting, blocks, solution) && {
            // The interior point is exact up to its tolerance; where its active set is right, the search is exact.
            self.is_factorised = false;
            self.try_search(shooting, blocks, solution);
            true
        }
    }

    /// Searches on a copy of `solution`, which stays as it is where that fails.
    fn try_search(&mut self, shooting: &Shooting, blocks: &[Block], solution: &mut QpSolution) -> bool {
        /// One or two are usual; where three are not enough, more seldom are.
        const ROUNDS: u32 = 3;
        let mut exact = std::mem::take(&mut self.exact);
        exact.copy_from(solution);
        let found = self.search(shooting, blocks, &mut exact, ROUNDS);
        if found {
            std::mem::swap(&mut exact, solution);
        } else {
            self.equations.clear();
        }
        self.exact = exact;
        found
    }

    /// Fills the blocks with `blocks` and the damping of the controls.
    fn damp(&mut self, blocks: &[Block]) {
        fill(&mut self.blocks, blocks.iter().copied());
        for block in self.blocks.iter_mut().take(self.lower.len() / 2) {
            block[5][5] += self.damping[0];
            block[6][6] += self.damping[1];
        }
    }

    /// Writes the controls of `path` into `solution`, inside their bounds: free ones keep them up to a tolerance only.
    fn write(&self, path: &Path, solution: &mut QpSolution) {
        let bounds = self.lower.iter().zip(&self.upper);
        let values = path.controls.iter().flatten().zip(bounds);
        fill(&mut solution.step, values.map(|(value, (low, high))| value.max(*low).min(*high)));
    }

    /// Rows that the last solution holds at a limit.
    pub(crate) fn equations(&self) -> &[usize] {
        &self.equations
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collocation::{Collocation, Scheme};
    use crate::condense::condense;
    use crate::hessian;
    use crate::problem::Trajectory;
    use crate::qp::Qp;
    use crate::qp::active_set::dense::DenseActiveSet;
    use crate::shooting::Sweep;
    use crate::testing;
    use vehicle::Control;

    /// Programs with different active sets, as the condensed program and as the chain with its linearisation.
    fn programs() -> Vec<(Qp, Chain, Shooting, Vec<Block>)> {
        let steerings = [0.0, 0.02, -0.03, 0.05];
        let offsets = [-0.6, -0.1, 0.3, 1.45];
        let mut programs = Vec::new();
        for (steering, y) in steerings.into_iter().flat_map(|steering| offsets.map(|y| (steering, y))) {
            let mut problem = testing::problem();
            problem.initial.y = y;
            let controls = vec![Control { velocity: 0.8, steering }; 6];
            let guess = Trajectory { states: Vec::new(), controls };
            let (mut iterate, mut shooting) = (Iterate::default(), Shooting::default());
            iterate.start(&problem, &guess);
            let collocation = Collocation::new(Scheme::Radau3);
            assert!(shooting.sweep(&problem, &collocation, &mut iterate, Sweep::Close, true));
            // With gaps.
            iterate.states[3][4] += 0.02;
            iterate.states[4][1] -= 0.01;
            assert!(shooting.sweep(&problem, &collocation, &mut iterate, Sweep::Keep, true));
            let (mut qp, mut chain, mut blocks) = (Qp::default(), Chain::default(), Vec::new());
            condense(&problem, &iterate, &shooting, 0.2, &mut qp);
            chain.build(&problem, &iterate, 0.2, &mut Vec::new());
            hessian::gauss_newton(&problem, &mut blocks);
            programs.push((qp, chain, shooting, blocks));
        }
        programs
    }

    #[test]
    fn the_chain_and_the_condensed_program_have_the_same_solution() {
        let mut sizes = Vec::new();
        for (qp, mut chain, shooting, blocks) in programs() {
            let (mut expected, mut found) = (QpSolution::default(), QpSolution::default());
            assert!(DenseActiveSet::default().solve(&qp, &mut expected));
            assert!(
                chain.solve(&shooting, &blocks, &mut found)
                    || chain.solve_from_inside(&shooting, &blocks, &mut found)
            );
            for (a, b) in found.step.iter().zip(&expected.step) {
                assert!((a - b).abs() < 1e-9, "{a} {b}");
            }
            // The multipliers reach some hundred; both are those of the same condensed conditions.
            assert!(qp.residual(&found, &mut Vec::new()) < 1e-7);
            sizes.push(chain.equations().len());
        }
        // Some of them hold rows at a limit.
        assert!(sizes.iter().any(|&size| size > 0), "{sizes:?}");
    }

    #[test]
    fn the_interior_point_agrees_with_the_search() {
        for (qp, mut chain, shooting, blocks) in programs() {
            let (mut expected, mut found) = (QpSolution::default(), QpSolution::default());
            assert!(DenseActiveSet::default().solve(&qp, &mut expected));
            assert!(chain.solve_interior(&shooting, &blocks, &mut found));
            for (a, b) in found.step.iter().zip(&expected.step) {
                // It may end at complementarity 1e-7, and where that is degenerate the distance is the root of it.
                assert!((a - b).abs() < 1e-3, "{a} {b}");
            }
        }
    }
}
