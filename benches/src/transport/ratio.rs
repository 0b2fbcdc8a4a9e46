//! Ratios of percentiles with intervals, from chains that took turns.
//!
//! A round has one block of each contender, measured one after the other, so a disturbance of seconds affects all of
//! them. The intervals come from a bootstrap over rounds: rounds are drawn with replacement, the same for both
//! contenders, and the ratio of the percentiles of all drawn samples is computed. Its spread on the logarithmic scale
//! is the standard error, which Student's t for the number of rounds turns into the interval. Samples within a block
//! may depend on each other. Limits: disturbances common to all rounds are not seen. For percentiles beyond the
//! samples of a round the interval is wide, but its 99 % are not exact.

use figures::{bootstrap, student};

/// How often an interval of no difference contains 1.
pub(super) const CONFIDENCE: f64 = 0.99;
/// All samples of one contender, ordered, with the round that each is from.
#[derive(Debug)]
pub(super) struct Rounds {
    samples: Vec<(u64, usize)>,
    rounds: usize,
}

/// A ratio of percentiles, other to this bus, with its interval of [`CONFIDENCE`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ratio {
    /// The ratio; zero when one side has no samples.
    pub(super) value: f64,
    /// Lower end.
    pub(super) low: f64,
    /// Upper end.
    pub(super) high: f64,
}

/// The conclusion from a ratio.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Below 1.
    Faster,
    /// Above 1.
    Slower,
    /// The interval contains 1.
    NoDifference,
}

impl Verdict {
    /// As text.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Faster => "faster",
            Self::Slower => "slower",
            Self::NoDifference => "no difference seen",
        }
    }
}

impl Ratio {
    /// A ratio of something to itself.
    pub(super) const ONE: Self = Self { value: 1.0, low: 1.0, high: 1.0 };
    const NONE: Self = Self { value: 0.0, low: 0.0, high: 0.0 };

    /// The conclusion.
    pub(super) fn verdict(&self) -> Verdict {
        if self.high < 1.0 && self.value > 0.0 {
            Verdict::Faster
        } else if self.low > 1.0 {
            Verdict::Slower
        } else {
            Verdict::NoDifference
        }
    }
}

impl Rounds {
    /// The samples of each round [ns].
    pub(super) fn new(rounds: &[Vec<u64>]) -> Self {
        let each = rounds.iter().enumerate();
        let mut samples: Vec<(u64, usize)> =
            each.flat_map(|(round, samples)| samples.iter().map(move |sample| (*sample, round))).collect();
        samples.sort_unstable();
        Self { samples, rounds: rounds.len() }
    }

    /// The smallest sample that is not exceeded by `share` of all, each round counted `weights` times.
    fn quantile(&self, share: f64, weights: &[u64]) -> Option<u64> {
        let total: u64 = self.samples.iter().map(|(_, round)| weights[*round]).sum();
        let rank = ((share * total as f64).ceil() as u64).max(1);
        let mut passed = 0;
        self.samples.iter().find_map(|(sample, round)| {
            passed += weights[*round];
            (passed >= rank).then_some(*sample)
        })
    }
}

/// The ratio of a percentile of `other` to that of `ours`; both have the same rounds.
pub(super) fn ratio(ours: &Rounds, other: &Rounds, share: f64) -> Ratio {
    let log_ratio = |weights: &[u64]| -> Option<f64> {
        let (ours, other) = (ours.quantile(share, weights)?, other.quantile(share, weights)?);
        Some((other as f64 / ours as f64).ln())
    };
    let rounds = ours.rounds.min(other.rounds);
    let Some(value) = log_ratio(&vec![1; rounds]) else { return Ratio::NONE };
    let places: Vec<usize> = (0..rounds).collect();
    let drawn: Vec<f64> = bootstrap::resample(&places, 1, |drawn| {
        let mut weights = vec![0; rounds];
        drawn.iter().for_each(|round| weights[*round] += 1);
        log_ratio(&weights)
    })
    .into_iter()
    .flatten()
    .collect();
    let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
    let variance = drawn.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / drawn.len() as f64;
    // Drawing n of n rounds shows (n - 1) / n of the variance.
    let error = (variance * rounds as f64 / (rounds as f64 - 1.0)).sqrt() * student(rounds - 1);
    Ratio { value: value.exp(), low: (value - error).exp(), high: (value + error).exp() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use figures::bootstrap::SplitMix64;

    /// Latencies around 100 us with a tail, in rounds that differ by some percent, as chains started anew do.
    fn blocks(state: &mut SplitMix64, factor: f64) -> Rounds {
        let mut uniform = move || state.uniform();
        let mut rounds = Vec::new();
        for _ in 0..10 {
            let round = 1.0 + 0.1 * (uniform() + uniform() + uniform() - 1.5);
            let sample = |tail: f64| (100_000.0 * factor * round * (1.0 - 0.1 * (1.0 - tail).ln())) as u64;
            rounds.push((0..100).map(|_| sample(uniform())).collect());
        }
        Rounds::new(&rounds)
    }

    #[test]
    fn quantiles_are_ranks_and_a_round_counts_as_often_as_it_is_drawn() {
        let rounds = Rounds::new(&[vec![1, 2, 3], vec![10, 20, 30]]);
        assert_eq!(rounds.quantile(0.5, &[1, 1]), Some(3));
        assert_eq!(rounds.quantile(0.5, &[0, 2]), Some(20));
        assert_eq!(rounds.quantile(1.0, &[2, 0]), Some(3));
        assert_eq!(Rounds::new(&[vec![], vec![]]).quantile(0.5, &[1, 1]), None);
    }

    #[test]
    fn the_same_transport_twice_shows_no_difference_in_at_least_95_of_100() {
        let mut state = SplitMix64(1);
        for share in [0.5, 0.99] {
            let none = (0..200)
                .filter(|_| {
                    let (ours, other) = (blocks(&mut state, 1.0), blocks(&mut state, 1.0));
                    ratio(&ours, &other, share).verdict() == Verdict::NoDifference
                })
                .count();
            assert!(none >= 190, "{none} of 200 at {share}");
        }
    }

    #[test]
    fn one_that_takes_a_third_longer_is_seen_every_time_and_the_interval_holds_the_truth() {
        let mut state = SplitMix64(2);
        let mut holds = 0;
        for _ in 0..100 {
            let ratio = ratio(&blocks(&mut state, 1.0), &blocks(&mut state, 1.33), 0.5);
            assert_eq!(ratio.verdict(), Verdict::Slower, "{ratio:?}");
            holds += usize::from(ratio.low <= 1.33 && 1.33 <= ratio.high);
        }
        assert!(holds >= 95, "{holds} of 100");
    }

    #[test]
    fn the_verdict_names_who_is_faster() {
        let verdict = |value, low, high| Ratio { value, low, high }.verdict();
        assert_eq!(verdict(0.8, 0.7, 0.9), Verdict::Faster);
        assert_eq!(verdict(1.2, 1.1, 1.3), Verdict::Slower);
        assert_eq!(verdict(1.2, 0.9, 1.6), Verdict::NoDifference);
        assert_eq!(Ratio::ONE.verdict(), Verdict::NoDifference);
        let nothing = Rounds::new(&[vec![], vec![], vec![]]);
        assert_eq!(ratio(&nothing, &nothing, 0.5).verdict(), Verdict::NoDifference);
    }
}
