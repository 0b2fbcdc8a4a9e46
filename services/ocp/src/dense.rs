//! The little dense linear algebra that the solvers share: matrices are slices, row by row.

/// Makes `values` a list of `length` times `value`, without allocating where that fits.
pub(crate) fn refill<T: Clone>(values: &mut Vec<T>, length: usize, value: T) {
    values.clear();
    values.resize(length, value);
}

/// Fills `values` from an iterator, without allocating where that fits.
pub(crate) fn fill<T>(values: &mut Vec<T>, with: impl IntoIterator<Item = T>) {
    values.clear();
    values.extend(with);
}

/// Lower triangular factor of the symmetric `matrix` of `size`, both row by row; false where it is not safely
/// positive definite.
pub(crate) fn cholesky(matrix: &[f64], size: usize, factor: &mut Vec<f64>) -> bool {
    /// Pivots below this share of the largest diagonal entry may be rounding errors.
    const MIN_PIVOT: f64 = 1e-10;
    fill(factor, matrix[..size * size].iter().copied());
    let largest = (0..size).map(|index| matrix[index * size + index]).fold(0.0, f64::max);
    for row in 0..size {
        for column in 0..=row {
            let (before, here) = factor.split_at_mut(row * size);
            let other = if column == row { &here[..column] } else { &before[column * size..][..column] };
            let value = here[column] - dot(&here[..column], other);
            here[column] = if column < row {
                value / before[column * size + column]
            } else if value > MIN_PIVOT * largest {
                value.sqrt()
            } else {
                return false;
            };
        }
    }
    true
}

/// Solves L x = b in place.
pub(crate) fn forward(factor: &[f64], size: usize, values: &mut [f64]) {
    for row in 0..size {
        let line = &factor[row * size..row * size + row];
        values[row] = (values[row] - dot(line, &values[..row])) / factor[row * size + row];
    }
}

/// Solves L' x = b in place.
pub(crate) fn backward(factor: &[f64], size: usize, values: &mut [f64]) {
    for row in (0..size).rev() {
        values[row] /= factor[row * size + row];
        let value = values[row];
        for (target, entry) in values[..row].iter_mut().zip(&factor[row * size..row * size + row]) {
            *target -= value * entry;
        }
    }
}

/// Solves L L' x = b in place.
pub(crate) fn solve_factored(factor: &[f64], size: usize, values: &mut [f64]) {
    forward(factor, size, values);
    backward(factor, size, values);
}

/// Scalar product.
#[inline]
pub(crate) fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_solves_its_system() {
        let matrix = [4.0, 2.0, 2.0, 2.0, 5.0, 3.0, 2.0, 3.0, 6.0];
        let mut factor = Vec::new();
        assert!(cholesky(&matrix, 3, &mut factor));
        let mut values = [8.0, 10.0, 11.0];
        forward(&factor, 3, &mut values);
        backward(&factor, 3, &mut values);
        assert!(values.iter().all(|value| (value - 1.0).abs() < 1e-14), "{values:?}");
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        assert!(!cholesky(&[1.0, 2.0, 2.0, 1.0], 2, &mut Vec::new()));
        assert!(!cholesky(&[f64::NAN], 1, &mut Vec::new()));
    }
}
