//! A straight line and a power law through cost over number of intervals.

use serde::Serialize;

/// `cost = intercept + slope n` and `cost ~ n^exponent`, by least squares.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Fit {
    /// Constant part of the cost [us].
    pub intercept_us: f64,
    /// Cost per interval [us].
    pub slope_us: f64,
    /// Share of the variance that the line explains.
    pub r_squared: f64,
    /// 1 where cost is proportional to n, 3 where it is cubic.
    pub exponent: f64,
}

/// The fit through pairs (n, cost); `None` for fewer than three, or where a value is not above zero.
pub(super) fn fit(pairs: &[(f64, f64)]) -> Option<Fit> {
    if pairs.len() < 3 || pairs.iter().any(|&(n, cost)| !(n > 0.0 && cost > 0.0)) {
        return None;
    }
    let (intercept_us, slope_us) = line(pairs);
    let mean = pairs.iter().map(|pair| pair.1).sum::<f64>() / pairs.len() as f64;
    let total: f64 = pairs.iter().map(|pair| (pair.1 - mean).powi(2)).sum();
    let left: f64 = pairs.iter().map(|&(n, cost)| (cost - intercept_us - slope_us * n).powi(2)).sum();
    let logarithms: Vec<_> = pairs.iter().map(|&(n, cost)| (n.ln(), cost.ln())).collect();
    let (_, exponent) = line(&logarithms);
    Some(Fit {
        intercept_us,
        slope_us,
        r_squared: if total > 0.0 { 1.0 - left / total } else { 1.0 },
        exponent,
    })
}

/// Intercept and slope.
fn line(pairs: &[(f64, f64)]) -> (f64, f64) {
    let count = pairs.len() as f64;
    let mean_x = pairs.iter().map(|pair| pair.0).sum::<f64>() / count;
    let mean_y = pairs.iter().map(|pair| pair.1).sum::<f64>() / count;
    let square: f64 = pairs.iter().map(|pair| (pair.0 - mean_x).powi(2)).sum();
    let product: f64 = pairs.iter().map(|pair| (pair.0 - mean_x) * (pair.1 - mean_y)).sum();
    let slope = if square > 0.0 { product / square } else { 0.0 };
    (mean_y - slope * mean_x, slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_exactly() {
        let fit = fit(&[(24.0, 53.0), (48.0, 101.0), (96.0, 197.0)]).unwrap();
        assert!((fit.intercept_us - 5.0).abs() < 1e-9 && (fit.slope_us - 2.0).abs() < 1e-9);
        assert!((fit.r_squared - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_exponent_tells_cubic_from_linear() {
        let exponent =
            |power: i32| fit(&[24.0, 48.0, 96.0].map(|n: f64| (n, n.powi(power)))).unwrap().exponent;
        assert!((exponent(1) - 1.0).abs() < 1e-12 && (exponent(3) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn too_few_points_have_no_fit() {
        assert_eq!(fit(&[(24.0, 1.0), (48.0, 2.0)]), None);
        assert_eq!(fit(&[(24.0, 1.0), (48.0, 2.0), (96.0, 0.0)]), None);
    }
}
