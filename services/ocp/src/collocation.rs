//! Collocation schemes on the unit interval: Radau and Gauss points with one to four stages.
//!
//! The state inside an interval is the polynomial that satisfies the model at the stage points. Radau has its
//! last point at the end of the interval and is L-stable, so the fast modes of the model (up to 350 1/s, with an
//! interval of 0.45 s) are damped; it is the default. Gauss has the higher order 2s, but fast modes oscillate with the
//! factor (-1)^s per interval. The source uses two Gauss points.

#![expect(clippy::needless_range_loop, reason = "small matrices read best by their indices")]

use serde::{Deserialize, Serialize};

/// The largest number of stages of any scheme.
pub const MAX_STAGES: usize = 4;

/// Points at which the model holds inside an interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scheme {
    /// Implicit Euler, order 1.
    Radau1,
    /// Order 3.
    Radau2,
    /// Order 5: the production scheme.
    #[default]
    Radau3,
    /// Order 7.
    Radau4,
    /// Implicit midpoint rule, order 2.
    Gauss1,
    /// Order 4: the scheme of the source.
    Gauss2,
    /// Order 6.
    Gauss3,
    /// Order 8.
    Gauss4,
}

impl vehicle::Setting for Scheme {}

impl Scheme {
    /// All schemes.
    pub const ALL: [Self; 8] = [
        Self::Radau1,
        Self::Radau2,
        Self::Radau3,
        Self::Radau4,
        Self::Gauss1,
        Self::Gauss2,
        Self::Gauss3,
        Self::Gauss4,
    ];

    /// Number of stages.
    fn stages(self) -> usize {
        match self {
            Self::Radau1 | Self::Gauss1 => 1,
            Self::Radau2 | Self::Gauss2 => 2,
            Self::Radau3 | Self::Gauss3 => 3,
            Self::Radau4 | Self::Gauss4 => 4,
        }
    }

    /// Whether the last stage is the end of the interval.
    fn is_radau(self) -> bool {
        matches!(self, Self::Radau1 | Self::Radau2 | Self::Radau3 | Self::Radau4)
    }
}

/// Coefficients of a scheme. Entries beyond the number of stages are zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Collocation {
    /// Number of stages s.
    pub stages: usize,
    /// Stage points in (0, 1].
    pub points: [f64; MAX_STAGES],
    /// Integrals of the Lagrange polynomials from 0 to each point: `integrals[i][j]` of polynomial j to point i.
    pub integrals: [[f64; MAX_STAGES]; MAX_STAGES],
    /// Integrals of the Lagrange polynomials over the whole interval: the quadrature weights.
    pub weights: [f64; MAX_STAGES],
    /// The end value is `(1 - sum) * start + sum_j end[j] * stage[j]` where the stages satisfy the collocation
    /// equations; for Radau that is the last stage.
    pub end: [f64; MAX_STAGES],
}

impl Default for Collocation {
    fn default() -> Self {
        Self::new(Scheme::default())
    }
}

impl Collocation {
    /// The coefficients of `scheme`, from the roots of its polynomial.
    pub fn new(scheme: Scheme) -> Self {
        let stages = scheme.stages();
        let points = points(scheme);
        let mut collocation = Self {
            stages,
            points,
            integrals: [[0.0; MAX_STAGES]; MAX_STAGES],
            weights: integrals_to(1.0, &points, stages),
            end: [0.0; MAX_STAGES],
        };
        for (row, &point) in points.iter().enumerate().take(stages) {
            collocation.integrals[row] = integrals_to(point, &points, stages);
        }
        // end = weights * integrals^-1, so that h * weights * f equals end * (stages - start).
        let mut transposed = [[0.0; MAX_STAGES]; MAX_STAGES];
        for row in 0..stages {
            for column in 0..stages {
                transposed[row][column] = collocation.integrals[column][row];
            }
        }
        collocation.end = solve(transposed, collocation.weights, stages);
        if scheme.is_radau() {
            collocation.end = [0.0; MAX_STAGES];
            collocation.end[stages - 1] = 1.0;
        }
        collocation
    }
}

/// Roots of P_s (Gauss) or P_s - P_(s-1) (Radau), P the Legendre polynomials moved to [0, 1].
fn points(scheme: Scheme) -> [f64; MAX_STAGES] {
    let stages = scheme.stages();
    let value = |point: f64| {
        let (last, before) = legendre(stages, 2.0 * point - 1.0);
        if scheme.is_radau() { last - before } else { last }
    };
    let mut points = [0.0; MAX_STAGES];
    let mut found = 0;
    // The roots of four stages are more than 0.06 apart: sixty-three brackets separate them, none at a root.
    const BRACKETS: usize = 63;
    for bracket in 0..BRACKETS {
        let (mut low, mut high) = (bracket as f64 / BRACKETS as f64, (bracket + 1) as f64 / BRACKETS as f64);
        if found == stages || value(low) * value(high) >= 0.0 {
            continue;
        }
        while high - low > f64::EPSILON * high {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if value(low) * value(middle) <= 0.0 {
                high = middle;
            } else {
                low = middle;
            }
        }
        points[found] = 0.5 * (low + high);
        found += 1;
    }
    if scheme.is_radau() {
        points[stages - 1] = 1.0;
    }
    points
}

/// Legendre polynomials of degree `degree` and `degree - 1` at `argument`.
fn legendre(degree: usize, argument: f64) -> (f64, f64) {
    let (mut value, mut before) = (argument, 1.0);
    for index in 1..degree {
        let index = index as f64;
        let next = ((2.0 * index + 1.0) * argument * value - index * before) / (index + 1.0);
        before = value;
        value = next;
    }
    (value, before)
}

/// Integrals of the Lagrange polynomials from 0 to `limit`: exact for the monomials 1, t, t^2, ...
fn integrals_to(limit: f64, points: &[f64; MAX_STAGES], stages: usize) -> [f64; MAX_STAGES] {
    let mut matrix = [[0.0; MAX_STAGES]; MAX_STAGES];
    let mut moments = [0.0; MAX_STAGES];
    for power in 0..stages {
        for column in 0..stages {
            matrix[power][column] = points[column].powi(power as i32);
        }
        moments[power] = limit.powi(power as i32 + 1) / (power + 1) as f64;
    }
    solve(matrix, moments, stages)
}

/// Solves a small regular system by elimination with pivoting.
fn solve(
    mut matrix: [[f64; MAX_STAGES]; MAX_STAGES],
    mut right: [f64; MAX_STAGES],
    size: usize,
) -> [f64; MAX_STAGES] {
    for column in 0..size {
        let pivot = (column..size)
            .max_by(|&a, &b| matrix[a][column].abs().total_cmp(&matrix[b][column].abs()))
            .unwrap_or(column);
        matrix.swap(column, pivot);
        right.swap(column, pivot);
        for row in column + 1..size {
            let factor = matrix[row][column] / matrix[column][column];
            let (upper, lower) = matrix.split_at_mut(row);
            for (entry, &above) in lower[0].iter_mut().zip(&upper[column]).skip(column) {
                *entry -= factor * above;
            }
            right[row] -= factor * right[column];
        }
    }
    let mut solution = [0.0; MAX_STAGES];
    for row in (0..size).rev() {
        let rest: f64 = (row + 1..size).map(|column| matrix[row][column] * solution[column]).sum();
        solution[row] = (right[row] - rest) / matrix[row][row];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radau_with_three_stages_has_the_published_coefficients() {
        let collocation = Collocation::new(Scheme::Radau3);
        let root = 6.0f64.sqrt();
        let points = [(4.0 - root) / 10.0, (4.0 + root) / 10.0, 1.0];
        let first =
            [(88.0 - 7.0 * root) / 360.0, (296.0 - 169.0 * root) / 1800.0, (-2.0 + 3.0 * root) / 225.0];
        let last = [(16.0 - root) / 36.0, (16.0 + root) / 36.0, 1.0 / 9.0];
        for stage in 0..3 {
            assert!((collocation.points[stage] - points[stage]).abs() < 1e-14);
            assert!((collocation.integrals[0][stage] - first[stage]).abs() < 1e-14);
            assert!((collocation.integrals[2][stage] - last[stage]).abs() < 1e-14);
            assert!((collocation.weights[stage] - last[stage]).abs() < 1e-14);
        }
    }

    #[test]
    fn gauss_with_two_stages_has_the_published_coefficients() {
        let collocation = Collocation::new(Scheme::Gauss2);
        let offset = 3.0f64.sqrt() / 6.0;
        assert!((collocation.points[0] - (0.5 - offset)).abs() < 1e-14);
        assert!((collocation.integrals[0][1] - (0.25 - offset)).abs() < 1e-14);
        assert!((collocation.weights[0] - 0.5).abs() < 1e-14);
    }

    #[test]
    fn quadrature_is_exact_to_the_order_of_every_scheme() {
        for scheme in Scheme::ALL {
            let collocation = Collocation::new(scheme);
            // The order of the error at the end of an interval, for problems that are not stiff.
            let order = 2 * scheme.stages() - usize::from(scheme.is_radau());
            for power in 0..order {
                let sum: f64 = (0..collocation.stages)
                    .map(|stage| collocation.weights[stage] * collocation.points[stage].powi(power as i32))
                    .sum();
                assert!((sum - 1.0 / (power + 1) as f64).abs() < 1e-14, "{scheme:?} power {power}");
            }
        }
    }

    #[test]
    fn the_end_value_is_the_quadrature_of_the_slopes() {
        for scheme in Scheme::ALL {
            let collocation = Collocation::new(scheme);
            for column in 0..collocation.stages {
                let sum: f64 = (0..collocation.stages)
                    .map(|row| collocation.end[row] * collocation.integrals[row][column])
                    .sum();
                assert!((sum - collocation.weights[column]).abs() < 1e-13, "{scheme:?}");
            }
        }
    }
}
