//! The drive scan by scan: true state and estimate of the same scan in one row.

use std::collections::BTreeMap;

use crate::picture::Moment;

/// Maximum number of rows of the drive.
pub const MAX_ROWS: usize = 200_000;

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
    estimate: Option<[f64; 2]>,
}

/// Distance of the estimated to the true position at the same scan.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct EstimateError {
    count: u64,
    sum_of_squares: f64,
    largest_m: f64,
}

impl Rows {
    /// The true state at a scan.
    pub(super) fn put_moment(&mut self, scan_id: u64, moment: Moment) {
        self.fill(scan_id, |row| row.moment.replace(moment).is_none());
    }

    /// The estimated position at a scan [m].
    pub(super) fn put_estimate(&mut self, scan_id: u64, estimate_m: [f64; 2]) {
        self.fill(scan_id, |row| row.estimate.replace(estimate_m).is_none());
    }

    /// True states in the order of scans.
    pub(super) fn moments(&self) -> impl Iterator<Item = Moment> {
        self.rows.values().filter_map(|row| row.moment)
    }

    /// Estimated positions in the order of scans [m].
    pub(super) fn estimates(&self) -> impl Iterator<Item = [f64; 2]> {
        self.rows.values().filter_map(|row| row.estimate)
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
        if let (true, Some(moment), Some([x_m, y_m])) = (new, row.moment, row.estimate) {
            self.error.add((x_m - moment.x_m).hypot(y_m - moment.y_m));
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

    fn add(&mut self, error_m: f64) {
        if error_m.is_finite() {
            self.count += 1;
            self.sum_of_squares += error_m * error_m;
            self.largest_m = self.largest_m.max(error_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_compares_equal_scans_in_whichever_order_they_come() {
        let moment = |x_m| Moment { x_m, ..Moment::default() };
        let mut rows = Rows::default();
        rows.put_estimate(1, [3.0, 4.0]);
        rows.put_moment(1, moment(0.0));
        rows.put_moment(2, moment(1.0));
        rows.put_estimate(2, [1.0, 0.0]);
        rows.put_estimate(3, [9.0, 9.0]);
        assert_eq!(rows.error().max_m(), 5.0);
        assert!((rows.error().rms_m() - 12.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_sample_that_comes_twice_is_compared_once() {
        let mut rows = Rows::default();
        rows.put_estimate(1, [3.0, 4.0]);
        rows.put_moment(1, Moment::default());
        rows.put_moment(1, Moment::default());
        assert_eq!(rows.error().count, 1);
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
