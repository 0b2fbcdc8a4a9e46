//! The five figures of a distribution: count, median, 90 %, 99 %, 99.9 % and the largest value.
//!
//! Values are counted in a logarithmic histogram with three significant digits, so an hour of samples takes as
//! much memory as a second and a percentile is off by at most 0.1 %. The largest value is exact. A value above one hour
//! (or 3.6e12 counts) is counted as that; no value is left out.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// Largest value of the histogram: one hour in nanoseconds.
const MAX: u64 = 3_600_000_000_000;

/// The figures of a distribution in the unit of their key; all zero without values.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Figures {
    /// How many values there are.
    pub count: u64,
    /// The median.
    pub p50: f64,
    /// 90 % of the values are not above this.
    pub p90: f64,
    /// 99 % of the values are not above this.
    pub p99: f64,
    /// 99.9 % of the values are not above this.
    pub p999: f64,
    /// The largest value, exact.
    pub max: f64,
}

/// A distribution that grows value by value.
#[derive(Debug, Clone)]
pub struct Distribution {
    histogram: Histogram<u64>,
    largest: u64,
    unit: f64,
}

impl Distribution {
    /// A distribution of times that are recorded in nanoseconds and reported in microseconds with fractions.
    pub fn of_times() -> Self {
        Self::new(1000.0)
    }

    /// A distribution of plain counts, reported as they are.
    pub fn of_counts() -> Self {
        Self::new(1.0)
    }

    fn new(unit: f64) -> Self {
        let histogram = Histogram::new_with_bounds(1, MAX, 3).expect("the bounds are constant and valid");
        Self { histogram, largest: 0, unit }
    }

    /// Adds one value: nanoseconds, or a count.
    pub fn record(&mut self, value: u64) {
        self.histogram.saturating_record(value);
        self.largest = self.largest.max(value);
    }

    /// How many values were recorded.
    pub fn count(&self) -> u64 {
        self.histogram.len()
    }

    /// The histogram behind the figures, in the unit of [`Distribution::record`].
    pub fn histogram(&self) -> &Histogram<u64> {
        &self.histogram
    }

    /// The five figures of what was recorded so far.
    pub fn figures(&self) -> Figures {
        if self.histogram.is_empty() {
            return Figures::default();
        }
        // A bucket is reported by its upper end, which may lie above the largest value in it.
        let quantile = |share| self.histogram.value_at_quantile(share).min(self.largest) as f64 / self.unit;
        Figures {
            count: self.histogram.len(),
            p50: quantile(0.5),
            p90: quantile(0.9),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: self.largest as f64 / self.unit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_one_to_a_thousand_microseconds_are_the_ranks() {
        let mut distribution = Distribution::of_times();
        for microseconds in 1..=1000_u64 {
            distribution.record(microseconds * 1000);
        }
        let figures = distribution.figures();
        assert_eq!((figures.count, figures.max), (1000, 1000.0));
        for (value, rank) in
            [(figures.p50, 500.0), (figures.p90, 900.0), (figures.p99, 990.0), (figures.p999, 999.0)]
        {
            // Three significant digits: the upper end of a bucket is at most 0.1 % above the value.
            assert!(value >= rank && value <= rank * 1.001, "{value} for {rank}");
        }
    }

    #[test]
    fn fractions_of_a_microsecond_are_reported() {
        let mut distribution = Distribution::of_times();
        distribution.record(1_250);
        assert_eq!(
            distribution.figures(),
            Figures { count: 1, p50: 1.25, p90: 1.25, p99: 1.25, p999: 1.25, max: 1.25 }
        );
    }

    #[test]
    fn a_distribution_without_values_is_all_zeros() {
        let text = serde_json::to_string(&Distribution::of_times().figures()).unwrap();
        assert_eq!(text, r#"{"count":0,"p50":0.0,"p90":0.0,"p99":0.0,"p999":0.0,"max":0.0}"#);
    }

    #[test]
    fn counts_are_reported_as_they_are_and_a_huge_value_is_not_left_out() {
        let mut distribution = Distribution::of_counts();
        for value in [0, 3, u64::MAX] {
            distribution.record(value);
        }
        let figures = distribution.figures();
        assert_eq!((figures.count, figures.p50), (3, 3.0));
        assert_eq!(figures.max, u64::MAX as f64);
    }
}
