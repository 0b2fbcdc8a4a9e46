//! The drive scan by scan: true state and estimate of the same scan in one row.

use std::collections::BTreeMap;

use shared_types::Pose;

use crate::picture::Moment;

/// Maximum number of rows of the drive.
pub const MAX_ROWS: usize = 200_000;

/// Bound of the squared Mahalanobis distance that a normally distributed error in the plane keeps with 95 %
/// probability: the quantile of chi-square with two degrees of freedom.
const CHI_SQUARE_95: f64 = 5.991;

/// Rows by scan, and the error of the estimate over all rows that had both halves.
#[derive(Debug, Clone, Default)]
pub(super) struct Rows {
    rows: BTreeMap<u64, Row>,
    dropped: u64,
    error: EstimateError,
}

/// True state and estimate of one scan; the two come on different topics, in any order.
#[derive(Debug, Clone, Copy, Default)]
struct Row {
    moment: Option<Moment>,
    estimate: Option<Estimate>,
}

/// An estimated position.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Estimate {
    place_m: [f64; 2],
    /// Covariance of (x, y): xx, xy, yy [m^2].
    covariance: [f64; 3],
}

impl Estimate {
    pub(super) fn of(pose: &Pose) -> Self {
        let [_, _, _, _, xx, xy, _, _, yy] = pose.covariance;
        Self { place_m: [pose.x_m, pose.y_m], covariance: [xx, xy, yy] }
    }

    /// Whether the 95 % ellipse contains a place; never when the covariance is not positive definite.
    fn contains(&self, x_m: f64, y_m: f64) -> bool {
        let [xx, xy, yy] = self.covariance;
        let (dx, dy) = (x_m - self.place_m[0], y_m - self.place_m[1]);
        let determinant = xx * yy - xy * xy;
        let scaled = dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx;
        xx > 0.0 && determinant > 0.0 && scaled <= CHI_SQUARE_95 * determinant
    }
}

/// Distance of the estimated to the true position at the same scan.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct EstimateError {
    count: u64,
    covered: u64,
    sum_of_squares: f64,
    largest_m: f64,
}

impl Rows {
    /// The true state at a scan.
    pub(super) fn put_moment(&mut self, scan_id: u64, moment: Moment) {
        self.fill(scan_id, |row| row.moment.replace(moment).is_none());
    }

    /// The estimated position at a scan.
    pub(super) fn put_estimate(&mut self, scan_id: u64, estimate: Estimate) {
        self.fill(scan_id, |row| row.estimate.replace(estimate).is_none());
    }

    /// True states in the order of scans.
    pub(super) fn moments(&self) -> impl Iterator<Item = Moment> {
        self.rows.values().filter_map(|row| row.moment)
    }

    /// Estimated positions in the order of scans [m].
    pub(super) fn estimates(&self) -> impl Iterator<Item = [f64; 2]> {
        self.rows.values().filter_map(|row| row.estimate).map(|estimate| estimate.place_m)
    }

    /// Number of first rows that were dropped.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// The error of the estimate.
    pub(super) fn error(&self) -> EstimateError {
        self.error
    }

    /// Fills one half of a row with `put`, which returns whether that half is new, and compares both once.
    fn fill(&mut self, scan_id: u64, put: impl FnOnce(&mut Row) -> bool) {
        let row = self.rows.entry(scan_id).or_default();
        let new = put(row);
        if let (true, Some(moment), Some(estimate)) = (new, row.moment, row.estimate) {
            self.error.add(&estimate, &moment);
        }
        while self.rows.len() > MAX_ROWS {
            self.rows.pop_first();
            self.dropped += 1;
        }
    }
}

impl EstimateError {
    /// The largest distance [m].
    pub(super) fn max_m(&self) -> f64 {
        self.largest_m
    }

    /// Root of the mean square of the distance, zero without values [m].
    pub(super) fn rms_m(&self) -> f64 {
        (self.sum_of_squares / self.count.max(1) as f64).sqrt()
    }

    /// Share of scans in which the 95 % ellipse contained the truth; `None` without values.
    pub(super) fn coverage(&self) -> Option<f64> {
        (self.count > 0).then(|| self.covered as f64 / self.count as f64)
    }

    fn add(&mut self, estimate: &Estimate, truth: &Moment) {
        let [x_m, y_m] = estimate.place_m;
        let error_m = (x_m - truth.x_m).hypot(y_m - truth.y_m);
        if error_m.is_finite() {
            self.count += 1;
            self.covered += u64::from(estimate.contains(truth.x_m, truth.y_m));
            self.sum_of_squares += error_m * error_m;
            self.largest_m = self.largest_m.max(error_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_m: f64, y_m: f64) -> Estimate {
        Estimate { place_m: [x_m, y_m], covariance: [0.0; 3] }
    }

    #[test]
    fn the_error_compares_equal_scans_in_whichever_order_they_come() {
        let moment = |x_m| Moment { x_m, ..Moment::default() };
        let mut rows = Rows::default();
        rows.put_estimate(1, at(3.0, 4.0));
        rows.put_moment(1, moment(0.0));
        rows.put_moment(2, moment(1.0));
        rows.put_estimate(2, at(1.0, 0.0));
        rows.put_estimate(3, at(9.0, 9.0));
        assert_eq!(rows.error().max_m(), 5.0);
        assert!((rows.error().rms_m() - 12.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_sample_that_comes_twice_is_compared_once() {
        let mut rows = Rows::default();
        rows.put_estimate(1, at(3.0, 4.0));
        rows.put_moment(1, Moment::default());
        rows.put_moment(1, Moment::default());
        assert_eq!(rows.error().count, 1);
    }

    #[test]
    fn coverage_is_the_share_of_scans_whose_ellipse_contains_the_truth() {
        // 95 % of two standard deviations of 0.1 and 0.2 m: 2.4477 times as much along each axis.
        let estimate = Estimate { place_m: [1.0, 2.0], covariance: [0.01, 0.0, 0.04] };
        assert!(estimate.contains(1.2447, 2.0) && !estimate.contains(1.2449, 2.0));
        assert!(estimate.contains(1.0, 2.4895) && !estimate.contains(1.0, 2.4897));
        let tilted = Estimate { covariance: [0.02, 0.019, 0.02], ..estimate };
        assert!(tilted.contains(1.3, 2.3) && !tilted.contains(1.3, 1.7), "the correlation counts");
        let wrong = Estimate { covariance: [-0.01, 0.0, -0.01], ..estimate };
        assert!(!at(1.0, 2.0).contains(1.0, 2.0) && !wrong.contains(1.0, 2.0));

        let mut rows = Rows::default();
        assert_eq!(rows.error().coverage(), None);
        for (scan_id, y_m) in [(1, 2.1), (2, 2.4), (3, 2.6), (4, 2.0)] {
            rows.put_estimate(scan_id, estimate);
            rows.put_moment(scan_id, Moment { x_m: 1.0, y_m, ..Moment::default() });
        }
        rows.put_estimate(5, estimate);
        assert_eq!(rows.error().coverage(), Some(0.75));
    }

    #[test]
    fn the_oldest_rows_beyond_the_maximum_are_dropped() {
        let mut rows = Rows::default();
        for scan_id in 1..=MAX_ROWS as u64 + 10 {
            rows.put_moment(scan_id, Moment::default());
        }
        assert_eq!((rows.moments().count(), rows.dropped()), (MAX_ROWS, 10));
    }
}
