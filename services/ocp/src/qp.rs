//! The quadratic program of one SQP iteration, condensed to the controls, and its solvers.
//!
//! minimise 1/2 v' H v + c' v + sum over rows of (L1 s + L2 s^2)
//! subject to lower <= v <= upper, row_lower - s <= a' v <= row_upper + s, s >= 0.
//!
//! The bounds of v are hard, the rows soft with one slack each, so the program always has a solution.

pub(crate) mod active_set;
pub(crate) mod clarabel;

use serde::{Deserialize, Serialize};

use crate::dense::{dot, fill, refill};

/// Which solver solves the quadratic programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum QpChoice {
    /// The dual active-set method, with Clarabel where its answer does not pass the check.
    #[default]
    ActiveSet,
    /// The interior-point solver Clarabel alone.
    Clarabel,
}

impl vehicle::Setting for QpChoice {}

/// Data of the program; n variables, m rows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Qp {
    /// H, n x n, symmetric, both triangles filled.
    pub hessian: Vec<f64>,
    /// c.
    pub gradient: Vec<f64>,
    /// Hard lower bounds of v.
    pub lower: Vec<f64>,
    /// Hard upper bounds of v.
    pub upper: Vec<f64>,
    /// a, m x n, row by row.
    pub rows: Vec<f64>,
    /// Soft lower limits, -inf where there is none.
    pub row_lower: Vec<f64>,
    /// Soft upper limits, +inf where there is none.
    pub row_upper: Vec<f64>,
    /// L1.
    pub slack_linear: f64,
    /// L2.
    pub slack_quadratic: f64,
}

/// Where a variable is in the solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum BoundState {
    /// Between its bounds.
    #[default]
    Free,
    /// At its lower bound.
    Lower,
    /// At its upper bound.
    Upper,
}

impl BoundState {
    /// At the upper bound or at the lower one.
    pub(crate) fn at(upper: bool) -> Self {
        if upper { Self::Upper } else { Self::Lower }
    }
}

/// Where a soft row is in the solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum RowState {
    /// Between its limits.
    #[default]
    Inside,
    /// Held at its lower limit.
    AtLower,
    /// Held at its upper limit.
    AtUpper,
    /// Below its lower limit.
    BeyondLower,
    /// Above its upper limit.
    BeyondUpper,
}

impl RowState {
    /// Sign and limit of a row beyond one of its limits: the excess is `sign * (value - limit)`.
    pub(crate) fn beyond(self, [lower, upper]: [f64; 2]) -> Option<(f64, f64)> {
        match self {
            Self::BeyondUpper => Some((1.0, upper)),
            Self::BeyondLower => Some((-1.0, lower)),
            Self::Inside | Self::AtLower | Self::AtUpper => None,
        }
    }

    /// At or beyond the upper limit or the lower one.
    pub(crate) fn held(upper: bool, beyond: bool) -> Self {
        match (upper, beyond) {
            (true, true) => Self::BeyondUpper,
            (true, false) => Self::AtUpper,
            (false, true) => Self::BeyondLower,
            (false, false) => Self::AtLower,
        }
    }
}

/// Primal and dual solution: H v + c + bound_multipliers + rows' row_multipliers = 0.
#[derive(Debug, Clone, Default)]
pub(crate) struct QpSolution {
    /// v.
    pub step: Vec<f64>,
    /// Positive at an upper bound, negative at a lower one.
    pub bound_multipliers: Vec<f64>,
    /// Positive at an upper limit, negative at a lower one; L1 + 2 L2 s beyond it.
    pub row_multipliers: Vec<f64>,
    /// Per variable.
    pub bound_states: Vec<BoundState>,
    /// Per row.
    pub row_states: Vec<RowState>,
}

impl Qp {
    /// Number of variables.
    pub(crate) fn variables(&self) -> usize {
        self.gradient.len()
    }

    /// Number of rows.
    pub(crate) fn row_count(&self) -> usize {
        self.row_lower.len()
    }

    /// Row `index` of a.
    pub(crate) fn row(&self, index: usize) -> &[f64] {
        let count = self.variables();
        &self.rows[index * count..(index + 1) * count]
    }

    /// Lower and upper limit of row `index`.
    pub(crate) fn limits(&self, index: usize) -> [f64; 2] {
        [self.row_lower[index], self.row_upper[index]]
    }

    /// Largest violation of the optimality conditions by `solution`, from their definition; NaN where it has any.
    ///
    /// `gradient` is a buffer.
    pub(crate) fn residual(&self, solution: &QpSolution, gradient: &mut Vec<f64>) -> f64 {
        let count = self.variables();
        let mut largest = 0.0f64;
        let mut worse = |value: f64| {
            if value.abs() > largest || value.is_nan() {
                largest = value.abs();
            }
        };
        fill(
            gradient,
            self.gradient.iter().zip(&solution.bound_multipliers).map(|(entry, bound)| entry + bound),
        );
        for row in 0..self.row_count() {
            let (line, multiplier) = (self.row(row), solution.row_multipliers[row]);
            if multiplier != 0.0 {
                for (sum, entry) in gradient.iter_mut().zip(line) {
                    *sum += multiplier * entry;
                }
            }
            let [low, high] = self.limits(row);
            let value = dot(line, &solution.step);
            worse(soft_residual(value, low, high, multiplier, self.slack_linear, self.slack_quadratic));
        }
        for (index, rest) in gradient.iter().enumerate() {
            worse(rest + dot(&self.hessian[index * count..(index + 1) * count], &solution.step));
            let (value, multiplier) = (solution.step[index], solution.bound_multipliers[index]);
            // Not f64::clamp, which panics when the bounds are out of order.
            worse(value - (value + multiplier).max(self.lower[index]).min(self.upper[index]));
        }
        largest
    }
}

impl QpSolution {
    /// Takes over the values of another, without allocating where they fit.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.step.clone_from(&other.step);
        self.bound_multipliers.clone_from(&other.bound_multipliers);
        self.row_multipliers.clone_from(&other.row_multipliers);
        self.bound_states.clone_from(&other.bound_states);
        self.row_states.clone_from(&other.row_states);
    }

    /// Zero, with nothing active.
    pub(crate) fn reset(&mut self, variables: usize, rows: usize) {
        refill(&mut self.step, variables, 0.0);
        self.release(variables, rows);
    }

    /// Nothing active; the step stays.
    pub(crate) fn release(&mut self, variables: usize, rows: usize) {
        for (values, length) in [(&mut self.bound_multipliers, variables), (&mut self.row_multipliers, rows)]
        {
            refill(values, length, 0.0);
        }
        refill(&mut self.bound_states, variables, BoundState::Free);
        refill(&mut self.row_states, rows, RowState::Inside);
    }
}

/// How far `multiplier` is from belonging to `value` under a soft limit on either side, in units of the value.
///
/// It is `value - prox(value + multiplier)` with prox of the penalty, which is zero exactly when the multiplier is a
/// subgradient of the penalty: 0 inside, up to L1 at the limit, L1 + 2 L2 s beyond it.
#[inline]
pub(crate) fn soft_residual(
    value: f64,
    lower: f64,
    upper: f64,
    multiplier: f64,
    linear: f64,
    quadratic: f64,
) -> f64 {
    let moved = value + multiplier;
    let near = if moved > upper {
        upper + ((moved - upper - linear) / (1.0 + 2.0 * quadratic)).max(0.0)
    } else if moved < lower {
        lower - ((lower - moved - linear) / (1.0 + 2.0 * quadratic)).max(0.0)
    } else {
        moved
    };
    value - near
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_soft_limit_knows_its_subgradients() {
        let residual = |value, multiplier| soft_residual(value, -1.0, 2.0, multiplier, 10.0, 3.0);
        assert_eq!(residual(0.0, 0.0), 0.0);
        assert_eq!(residual(2.0, 4.0), 0.0);
        assert_eq!(residual(2.0, 10.0), 0.0);
        assert_eq!(residual(2.5, 13.0), 0.0);
        assert_eq!(residual(-1.0, -4.0), 0.0);
        assert_eq!(residual(-1.5, -13.0), 0.0);
        assert_eq!(residual(0.0, 1e-3), -1e-3);
        assert!(residual(2.0, 11.0) != 0.0 && residual(2.5, 10.0) != 0.0 && residual(1.0, 4.0) != 0.0);
    }
}
