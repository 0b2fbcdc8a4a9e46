//! The quadratic program of one SQP iteration, condensed to the controls, and its solvers.
//!
//! minimise 1/2 v' H v + c' v + sum over rows of (L1 s + L2 s^2)
//! subject to lower <= v <= upper, row_lower - s <= a' v <= row_upper + s, s >= 0.
//!
//! The bounds of v are hard, the rows soft with one slack each, so the program always has a solution.

pub(crate) mod clarabel;

use serde::{Deserialize, Serialize};

/// Which solver solves the quadratic programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum QpChoice {
    /// The interior-point solver Clarabel.
    #[default]
    Clarabel,
}

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

    /// Largest violation of the optimality conditions by `solution`, from their definition; NaN where it has any.
    #[allow(dead_code)]
    pub(crate) fn residual(&self, solution: &QpSolution) -> f64 {
        let count = self.variables();
        let mut largest = 0.0f64;
        let mut worse = |value: f64| {
            if value.abs() > largest || value.is_nan() {
                largest = value.abs();
            }
        };
        for index in 0..count {
            let mut sum = self.gradient[index] + solution.bound_multipliers[index];
            for column in 0..count {
                sum += self.hessian[index * count + column] * solution.step[column];
            }
            for row in 0..self.row_count() {
                sum += self.rows[row * count + index] * solution.row_multipliers[row];
            }
            worse(sum);
            let (value, multiplier) = (solution.step[index], solution.bound_multipliers[index]);
            // Inlined instead of f64::clamp, which panics when the bounds are out of order.
            worse(value - (value + multiplier).max(self.lower[index]).min(self.upper[index]));
        }
        for row in 0..self.row_count() {
            let value = dot(self.row(row), &solution.step);
            worse(soft_residual(
                value,
                self.row_lower[row],
                self.row_upper[row],
                solution.row_multipliers[row],
                self.slack_linear,
                self.slack_quadratic,
            ));
        }
        largest
    }
}

/// How far `multiplier` is from belonging to `value` under a soft limit on either side, in units of the value.
///
/// It is `value - prox(value + multiplier)` with prox of the penalty, which is zero exactly when the multiplier is a
/// subgradient of the penalty: 0 inside, up to L1 at the limit, L1 + 2 L2 s beyond it.
#[inline]
pub(crate) fn soft_residual(value: f64, lower: f64, upper: f64, multiplier: f64, linear: f64, quadratic: f64) -> f64 {
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

/// Lower triangular factor of the symmetric `matrix` of `size`, both row by row; false where it is not safely
/// positive definite.
pub(crate) fn cholesky(matrix: &[f64], size: usize, factor: &mut Vec<f64>) -> bool {
    /// Pivots below this share of the largest diagonal entry are rounding errors or too flat to trust.
    const SMALLEST_PIVOT: f64 = 1e-10;
    factor.clear();
    factor.extend_from_slice(&matrix[..size * size]);
    let largest = (0..size).map(|index| matrix[index * size + index]).fold(0.0, f64::max);
    for row in 0..size {
        for column in 0..=row {
            let (before, here) = factor.split_at_mut(row * size);
            let other = if column == row { &here[..column] } else { &before[column * size..][..column] };
            let value = here[column] - dot(&here[..column], other);
            here[column] = if column < row {
                value / before[column * size + column]
            } else if value > SMALLEST_PIVOT * largest {
                value.sqrt()
            } else {
                return false;
            };
        }
    }
    true
}

/// Scalar product.
#[inline]
#[allow(dead_code)]
pub(crate) fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
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
