//! Linear least squares with equal, unknown noise.

use nalgebra::{DMatrix, DVector};

/// The solution of an overdetermined linear system.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solution {
    /// The coefficients.
    pub coefficients: DVector<f64>,
    /// Target minus prediction of each row.
    pub residuals: Vec<f64>,
    /// Rows minus coefficients.
    pub freedom: usize,
    /// Standard error of each coefficient.
    pub standard_errors: Vec<f64>,
    /// Standard deviation of the noise of one row.
    pub deviation: f64,
}

/// The coefficients that make `rows * coefficients` nearest to the targets.
///
/// `None` when the rows do not determine every coefficient, or there are no more rows than coefficients.
pub(crate) fn solve(rows: &[Vec<f64>], targets: &[f64]) -> Option<Solution> {
    let columns = rows.first()?.len();
    let freedom = rows.len().checked_sub(columns).filter(|freedom| *freedom > 0)?;
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
    // Columns of equal length: a coefficient in metres and one in 1/s have the same weight in the rank.
    let lengths: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
    if lengths.iter().any(|length| !length.is_finite() || *length <= 0.0) {
        return None;
    }
    let scaled = DMatrix::from_fn(rows.len(), columns, |row, column| matrix[(row, column)] / lengths[column]);
    let normal = scaled.transpose() * &scaled;
    let smallest = normal.symmetric_eigenvalues().min();
    if smallest.is_nan() || smallest < 1e-12 {
        return None;
    }
    let inverse = normal.cholesky()?.inverse();
    let scaled_solution = &inverse * (scaled.transpose() * DVector::from_column_slice(targets));
    let coefficients = DVector::from_fn(columns, |column, _| scaled_solution[column] / lengths[column]);
    let residuals: Vec<f64> =
        (DVector::from_column_slice(targets) - &matrix * &coefficients).iter().copied().collect();
    let deviation =
        (residuals.iter().map(|residual| residual * residual).sum::<f64>() / freedom as f64).sqrt();
    let standard_errors =
        (0..columns).map(|column| deviation * inverse[(column, column)].sqrt() / lengths[column]).collect();
    Some(Solution { coefficients, residuals, freedom, standard_errors, deviation })
}

/// Root mean square; zero for no values.
pub(crate) fn root_mean_square(values: &[f64]) -> f64 {
    let sum: f64 = values.iter().map(|value| value * value).sum();
    (sum / values.len().max(1) as f64).sqrt()
}

/// The one row that contradicts all others, and its residual from their solution.
///
/// Without it the deviation of the rest is at most a third, and its residual is larger than `floor`.
pub(crate) fn contradicting_row(rows: &[Vec<f64>], targets: &[f64], floor: f64) -> Option<(usize, f64)> {
    let all = solve(rows, targets)?;
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|one, other| all.residuals[*other].abs().total_cmp(&all.residuals[*one].abs()));
    // A wrong row pulls the solution, so its neighbours may have residuals as large as its own.
    order.into_iter().take(4).find_map(|wrong| {
        let others = || (0..rows.len()).filter(|index| *index != wrong);
        let without: Vec<Vec<f64>> = others().map(|index| rows[index].clone()).collect();
        let rest = solve(&without, &others().map(|index| targets[index]).collect::<Vec<f64>>())?;
        let expected: f64 = rows[wrong].iter().zip(&rest.coefficients).map(|(one, other)| one * other).sum();
        let missed = targets[wrong] - expected;
        (rest.deviation <= all.deviation / 3.0 && missed.abs() > floor).then_some((wrong, missed))
    })
}

/// The first residual that lies far outside of all others: beyond eight robust deviations and beyond `floor`.
///
/// The robust deviation is 1.48 times the median of the absolute residuals. Normal noise never reaches eight of them,
/// and a typing error of one digit is far beyond.
pub(crate) fn outlier(residuals: &[f64], floor: f64) -> Option<usize> {
    let mut sizes: Vec<f64> = residuals.iter().map(|residual| residual.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let limit = sizes.get(sizes.len() / 2).map_or(0.0, |median| 8.0 * 1.4826 * median).max(floor);
    residuals.iter().position(|residual| residual.abs() > limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_through_four_points_has_the_errors_of_a_hand_calculation() {
        // y = 1 + 2 x with residuals (1, -1, -1, 1) / 10, which are orthogonal to both columns.
        let rows: Vec<Vec<f64>> = [0.0, 1.0, 2.0, 3.0].iter().map(|x| vec![1.0, *x]).collect();
        let solution = solve(&rows, &[1.1, 2.9, 4.9, 7.1]).unwrap();
        assert!(
            (solution.coefficients[0] - 1.0).abs() < 1e-12 && (solution.coefficients[1] - 2.0).abs() < 1e-12
        );
        // Variance 4 * 0.01 / 2; of the slope over sum (x - 1.5)^2 = 5.
        assert!((solution.deviation - 0.02_f64.sqrt()).abs() < 1e-12);
        assert!((solution.standard_errors[1] - (0.02_f64 / 5.0).sqrt()).abs() < 1e-12);
        assert_eq!(solution.freedom, 2);
    }

    #[test]
    fn what_is_not_determined_is_not_solved() {
        assert_eq!(solve(&vec![vec![1.0, 2.0]; 5], &[1.0; 5]), None);
        assert_eq!(solve(&[vec![1.0, 0.0], vec![0.0, 1.0]], &[1.0; 2]), None);
        assert_eq!(solve(&[], &[]), None);
        assert_eq!(solve(&vec![vec![f64::NAN]; 3], &[1.0; 3]), None);
    }

    #[test]
    fn the_row_that_contradicts_all_others_is_found() {
        let rows: Vec<Vec<f64>> = (1..=6).map(|x| vec![f64::from(x)]).collect();
        let (wrong, missed) = contradicting_row(&rows, &[2.01, 3.99, 6.0, 12.0, 10.01, 11.99], 0.1).unwrap();
        assert!(wrong == 3 && (missed - 4.0).abs() < 0.02);
        assert_eq!(contradicting_row(&rows, &[2.01, 3.99, 6.0, 8.0, 10.01, 11.99], 0.1), None);
        // All of them disagree: no single row is wrong.
        assert_eq!(contradicting_row(&rows, &[3.0, 3.0, 7.0, 7.0, 11.0, 11.0], 0.1), None);
    }

    #[test]
    fn one_value_far_outside_all_others_is_found() {
        assert_eq!(outlier(&[0.1, -0.1, 0.05, 2.0, -0.02], 0.0), Some(3));
        assert_eq!(outlier(&[0.1, -0.1, 0.05, 0.2, -0.02], 0.0), None);
        assert_eq!(outlier(&[0.0, 0.0, 0.0, 1e-6], 1e-3), None, "exact data are no reason to refuse");
    }
}
