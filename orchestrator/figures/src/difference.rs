//! Confidence intervals of differences: they contain the true difference in 99 of 100 cases.
//!
//! **Runs in turns.** Each round gives one difference of B to A. If both are the same build, a difference is as likely
//! to be above zero as below, because the order within rounds alternates. So the true difference lies between the k-th
//! smallest and the k-th largest with a probability that is a sum of binomial coefficients, for any noise. With 12
//! rounds it lies between the second and the eleventh in 99.4 of 100 cases, and one disturbed round to either side
//! changes nothing. The estimate is the median. A confidence of 99 % needs at least eight rounds.
//!
//! **Two files.** Both runs are cut into stretches. Equal stretches are at the same place of the same drive, so the
//! drive itself is not part of their differences. The variance of these differences has two parts. The part that the
//! finite number of scans explains is averaged over the stretches. The rest is the machine: its noise grows with time,
//! and a second run is off by about as much as one stretch is from the next. So that part is not divided by the number
//! of stretches. Measured on a loaded machine with 24 runs of the same build, all 276 pairs: 1.4 % of these intervals
//! miss zero; with the usual division, 23 %. Limit: if the machine changed between two runs (a governor, a neighbour),
//! the difference is reported. Runs in turns do not have that weakness.

use hdrhistogram::Histogram;

use crate::student;

/// Share of intervals that contain the true difference.
pub const CONFIDENCE: f64 = 0.99;
/// Smallest number of rounds with that confidence.
pub const MIN_ROUNDS: usize = 8;
/// Largest number of rounds.
pub const MAX_ROUNDS: usize = 1000;
/// Largest and smallest number of groups of stretches of a run.
const GROUPS: usize = 12;
const MIN_GROUPS: usize = 6;
/// A group has at least this many scans beyond the percentile.
const BEYOND: f64 = 2.0;
/// Half the width of an interval times this is detected with 90 % probability: (2.576 + 1.282) / 2.576.
const NINE_IN_TEN: f64 = 1.498;

/// A difference with its confidence interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DifferenceEstimate {
    /// Best estimate.
    pub value: f64,
    /// The interval that contains the true difference in 99 of 100 cases.
    pub interval: [f64; 2],
    /// The smallest true difference that is detected with 90 % probability.
    pub smallest_visible: f64,
}

impl DifferenceEstimate {
    fn new(value: f64, interval: [f64; 2]) -> Self {
        Self { value, interval, smallest_visible: NINE_IN_TEN * 0.5 * (interval[1] - interval[0]) }
    }

    /// The same in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self {
            value: factor * self.value,
            interval: self.interval.map(|bound| factor * bound),
            smallest_visible: factor * self.smallest_visible,
        }
    }

    /// Number of rounds in turns that detect a true difference of this size with 90 % probability, when this estimate
    /// is from `rounds` rounds: the width of the interval falls with the square root of their number. `None` for an
    /// estimate of zero, and when it takes more than [`MAX_ROUNDS`]. Two files count as one round: their interval is
    /// that of one run of each, because the part of the machine is not divided by the number of stretches.
    pub fn rounds_to_settle(&self, rounds: usize) -> Option<usize> {
        let needed = (rounds as f64 * (self.smallest_visible / self.value).powi(2)).ceil();
        (needed <= MAX_ROUNDS as f64).then(|| (needed as usize).max(MIN_ROUNDS).max(rounds + 1))
    }

    /// Whether zero is outside the interval.
    pub fn is_seen(&self) -> bool {
        self.interval[0] > 0.0 || self.interval[1] < 0.0
    }
}

/// The difference of runs in turns, from one difference per round; `None` for too few rounds.
pub fn rounds(differences: &[f64]) -> Option<DifferenceEstimate> {
    let count = differences.len();
    if count < MIN_ROUNDS || differences.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let mut sorted = differences.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let outside = outside(count);
    let interval = [sorted[outside], sorted[count - 1 - outside]];
    Some(DifferenceEstimate::new(median(&sorted), interval))
}

/// How many of `count` sorted differences lie outside of each end of the interval: the most for which the median is
/// beyond them with at most half of the remaining probability.
fn outside(count: usize) -> usize {
    let mut probability = 0.5_f64.powi(count as i32);
    let mut sum = probability;
    let mut outside = 0;
    loop {
        probability *= (count - outside) as f64 / (outside + 1) as f64;
        sum += probability;
        if sum > 0.5 * (1.0 - CONFIDENCE) {
            return outside;
        }
        outside += 1;
    }
}

/// The median of sorted values.
pub fn median(sorted: &[f64]) -> f64 {
    0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2])
}

/// The difference of a quantile between two runs, from the histograms of their stretches in order; in the unit of the
/// histograms. `None` when there are too few scans.
pub fn stretches(a: &[Histogram<u64>], b: &[Histogram<u64>], quantile: f64) -> Option<DifferenceEstimate> {
    let count = a.len().min(b.len());
    let [a, b] = groups(&a[..count], &b[..count], quantile)?;
    let mut differences: Vec<f64> = a
        .iter()
        .zip(&b)
        .map(|(a, b)| b.value_at_quantile(quantile) as f64 - a.value_at_quantile(quantile) as f64)
        .collect();
    let sampling = mean(a.iter().zip(&b).map(|(a, b)| variance_of(a, quantile) + variance_of(b, quantile)));
    let half = half_width(variance(&differences), sampling, differences.len());
    // One disturbed group at either end does not count.
    differences.sort_unstable_by(f64::total_cmp);
    let value = mean(differences[1..differences.len() - 1].iter().copied());
    Some(DifferenceEstimate::new(value, [value - half, value + half]))
}

/// The smallest difference to a like run that [`stretches`] detects with 90 % probability.
///
/// `steady` is a series of the same run that does not depend on the place of the drive, like transport: its change from
/// stretch to stretch estimates the noise of the machine. `None` when there are too few scans.
pub fn smallest_visible(series: &[Histogram<u64>], steady: &[Histogram<u64>], quantile: f64) -> Option<f64> {
    let [series, steady] = groups(series, steady, quantile)?;
    let machine: Vec<f64> = steady.iter().map(|group| group.value_at_quantile(quantile) as f64).collect();
    let explained = mean(steady.iter().map(|group| variance_of(group, quantile)));
    let drift = (variance(&machine) - explained).max(0.0);
    let sampling = mean(series.iter().map(|group| variance_of(group, quantile)));
    let half = half_width(2.0 * (drift + sampling), 2.0 * sampling, series.len());
    Some(NINE_IN_TEN * half)
}

/// Half the width of the interval of an average over groups. `variance` is that between groups; the number of scans in
/// a group explains the part `sampling` of it.
fn half_width(variance: f64, sampling: f64, groups: usize) -> f64 {
    let machine = (variance - sampling).max(0.0);
    let squared = (machine + sampling / groups as f64).max(variance / groups as f64);
    student(groups - 1) * squared.sqrt()
}

/// Neighbouring stretches of both runs merged into the largest number of groups with enough scans for the quantile.
fn groups(a: &[Histogram<u64>], b: &[Histogram<u64>], quantile: f64) -> Option<[Vec<Histogram<u64>>; 2]> {
    let needed = BEYOND / (1.0 - quantile).min(quantile);
    (MIN_GROUPS..=GROUPS.min(a.len()).min(b.len())).rev().find_map(|count| {
        let (a, b) = (grouped(a, count), grouped(b, count));
        let enough = |groups: &[Histogram<u64>]| groups.iter().all(|group| group.len() as f64 >= needed);
        (enough(&a) && enough(&b)).then_some([a, b])
    })
}

fn grouped(stretches: &[Histogram<u64>], count: usize) -> Vec<Histogram<u64>> {
    (0..count)
        .map(|group| {
            let (from, until) = (group * stretches.len() / count, (group + 1) * stretches.len() / count);
            let mut sum = stretches[from].clone();
            for stretch in &stretches[from + 1..until] {
                // All stretches have the same bounds, so one can always be added to another.
                let _ = sum.add(stretch);
            }
            sum
        })
        .collect()
}

/// Variance of a quantile because of the finite number of values, from the values around it.
fn variance_of(histogram: &Histogram<u64>, quantile: f64) -> f64 {
    let around = (quantile * (1.0 - quantile) / histogram.len().max(1) as f64).sqrt();
    let value = |share: f64| histogram.value_at_quantile(share.clamp(0.0, 1.0)) as f64;
    (0.5 * (value(quantile + around) - value(quantile - around))).powi(2)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

fn variance(values: &[f64]) -> f64 {
    let mean = mean(values.iter().copied());
    values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64
}

#[cfg(test)]
mod tests;
