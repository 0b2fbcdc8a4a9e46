//! A line through points, by least squares.

use serde::Serialize;

/// `y = intercept + slope x`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Line {
    /// y at x = 0.
    pub intercept: f64,
    /// Change of y per unit of x.
    pub slope: f64,
    /// Share of the variance of y that the line explains.
    pub r_squared: f64,
}

/// The line through the points; `None` without two different abscissas.
pub(super) fn line(points: &[(f64, f64)]) -> Option<Line> {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (mean_x, mean_y) = (mean(|point| point.0), mean(|point| point.1));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in points {
        let (dx, dy) = (x - mean_x, y - mean_y);
        (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
    }
    let slope = xy / xx;
    // Without any variance the line explains all of it.
    let r_squared = if yy > 0.0 { xy * xy / (xx * yy) } else { 1.0 };
    (xx > 0.0).then_some(Line { intercept: mean_y - slope * mean_x, slope, r_squared })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_give_it_back_and_one_abscissa_gives_none() {
        let found = line(&[(1.0, 5.0), (2.0, 7.0), (4.0, 11.0)]).unwrap();
        assert!((found.intercept - 3.0).abs() < 1e-12 && (found.slope - 2.0).abs() < 1e-12, "{found:?}");
        assert!((found.r_squared - 1.0).abs() < 1e-12, "{found:?}");
        assert_eq!(line(&[(2.0, 1.0), (2.0, 3.0)]), None);
        let flat = line(&[(0.0, 1.0), (1.0, 3.0), (2.0, 1.0)]).unwrap();
        assert!(flat.slope.abs() < 1e-12 && flat.r_squared < 1e-12, "{flat:?}");
    }
}
