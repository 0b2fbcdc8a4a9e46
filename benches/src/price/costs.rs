//! What one step of latency, rate and pose uncertainty costs: slopes of least-squares lines through the figures.

use serde::Serialize;

use super::Row;
use super::condition::Varied;

/// Step of the latency [ms].
const LATENCY_STEP_MS: f64 = 10.0;
/// Step of the pose sigma [m].
const POSE_SIGMA_STEP_M: f64 = 0.01;

/// What one step costs; `None` where fewer than two conditions have a figure.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Cost {
    pub(super) gap_m: Option<f64>,
    pub(super) stopping_distance_m: Option<f64>,
}

/// What one step of each kind costs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(super) struct Costs {
    /// 10 ms of latency.
    pub(super) latency_10_ms: Cost,
    /// Half the rate of the chosen system: its scan period once more.
    pub(super) half_rate: Cost,
    /// 1 cm of pose sigma.
    pub(super) pose_sigma_1_cm: Cost,
}

impl Costs {
    /// The costs in these rows; `rate_hz` is the rate of the chosen system.
    pub(super) fn of(rows: &[Row], rate_hz: f64) -> Self {
        Self {
            latency_10_ms: cost(rows, Varied::Latency, LATENCY_STEP_MS),
            half_rate: cost(rows, Varied::Rate, 1e3 / rate_hz),
            pose_sigma_1_cm: cost(rows, Varied::PoseSigma, POSE_SIGMA_STEP_M),
        }
    }
}

impl Row {
    /// The quantity that varies in the group of this row: latency [ms], scan period [ms], pose sigma or radius [m].
    pub(super) fn abscissa(&self) -> f64 {
        match self.varied {
            Varied::Latency => self.latency_ms,
            Varied::Rate => 1e3 / self.rate_hz,
            Varied::PoseSigma => self.pose_sigma_m,
            Varied::Bend => self.radius_m.unwrap_or(f64::INFINITY),
        }
    }
}

/// The points of a group that have a figure.
pub(super) fn points(rows: &[Row], varied: Varied, figure: impl Fn(&Row) -> Option<f64>) -> Vec<[f64; 2]> {
    let rows = rows.iter().filter(|row| row.varied == varied);
    rows.filter_map(|row| Some([row.abscissa(), figure(row)?])).collect()
}

fn cost(rows: &[Row], varied: Varied, step: f64) -> Cost {
    let of = |figure: fn(&Row) -> Option<f64>| slope(&points(rows, varied, figure)).map(|slope| slope * step);
    Cost { gap_m: of(|row| row.smallest_gap_m), stopping_distance_m: of(|row| row.stopping_distance_m) }
}

/// Slope of the least-squares line; `None` without two different abscissas.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let count = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / count;
    let (middle_x, middle_y) = (mean(0), mean(1));
    let square: f64 = points.iter().map(|[x, _]| (x - middle_x).powi(2)).sum();
    let product: f64 = points.iter().map(|[x, y]| (x - middle_x) * (y - middle_y)).sum();
    (square > 0.0).then(|| product / square)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::price::tests::row;

    #[test]
    fn the_slope_of_a_line_is_exact_and_of_scattered_points_the_best_one() {
        assert_eq!(slope(&[[0.0, 1.0], [1.0, 3.0], [4.0, 9.0]]), Some(2.0));
        // Means 1 and 1; sum of products 1, of squares 2.
        assert_eq!(slope(&[[0.0, 1.0], [1.0, 0.0], [2.0, 2.0]]), Some(0.5));
    }

    #[test]
    fn no_slope_goes_through_less_than_two_abscissas() {
        for points in [&[][..], &[[1.0, 2.0]], &[[1.0, 2.0], [1.0, 3.0]]] {
            assert_eq!(slope(points), None);
        }
    }

    #[test]
    fn costs_are_per_10_ms_per_scan_period_and_per_centimetre() {
        let row = |varied, latency_ms, rate_hz, pose_sigma_m, gap_m| Row {
            smallest_gap_m: gap_m,
            ..row(varied, latency_ms, rate_hz, pose_sigma_m)
        };
        let rows = [
            row(Varied::Latency, 0.0, 10.0, 0.0, Some(0.8)),
            row(Varied::Latency, 50.0, 10.0, 0.0, None),
            row(Varied::Latency, 100.0, 10.0, 0.0, Some(1.0)),
            row(Varied::Rate, 0.0, 5.0, 0.0, Some(1.0)),
            row(Varied::Rate, 0.0, 20.0, 0.0, Some(0.7)),
            row(Varied::PoseSigma, 0.0, 10.0, 0.04, Some(0.9)),
        ];
        let costs = Costs::of(&rows, 10.0);
        assert!((costs.latency_10_ms.gap_m.unwrap() - 0.02).abs() < 1e-12);
        // 0.3 m over 150 ms.
        assert!((costs.half_rate.gap_m.unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(costs.pose_sigma_1_cm, Cost::default());
    }
}
