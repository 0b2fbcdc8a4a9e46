//! The exact bound of a probability from events that were counted.

/// Largest probability with which `events` or fewer of `trials` happen once in twenty times: the exact upper bound of
/// Clopper and Pearson with 95 % confidence, to 1e-9. One without a trial.
pub fn upper_bound_95(events: u64, trials: u64) -> f64 {
    if events >= trials {
        return 1.0;
    }
    let (mut low, mut high) = (events as f64 / trials as f64, 1.0);
    while high - low > 1e-10 {
        let middle = (low + high) / 2.0;
        if at_most(events, trials, middle) > 0.05 { low = middle } else { high = middle }
    }
    high
}

/// Probability of at most so many events; the terms follow from each other, in logarithms because they may be tiny.
fn at_most(events: u64, trials: u64, probability: f64) -> f64 {
    let odds = probability.ln() - (-probability).ln_1p();
    let mut term = trials as f64 * (-probability).ln_1p();
    let mut sum = term.exp();
    for event in 1..=events {
        term += ((trials - event + 1) as f64 / event as f64).ln() + odds;
        sum += term.exp();
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_an_event_the_bound_is_the_rule_of_three() {
        // 0.95 quantile: (1 - p)^n = 0.05.
        for trials in [10, 1000, 100_000] {
            let expected = 1.0 - 0.05_f64.powf(1.0 / trials as f64);
            assert!((upper_bound_95(0, trials) - expected).abs() < 1e-9, "{trials}");
        }
        assert!((upper_bound_95(0, 1000) - 0.002991).abs() < 1e-6);
    }

    #[test]
    fn bounds_agree_with_the_table_of_clopper_and_pearson() {
        // One-sided 95 % bounds from tables: 1 of 10, 3 of 20, 2 of 1000.
        for (events, trials, expected) in [(1, 10, 0.3942), (3, 20, 0.3437), (2, 1000, 0.006283)] {
            assert!((upper_bound_95(events, trials) - expected).abs() < 1e-4, "{events} of {trials}");
        }
        assert_eq!((upper_bound_95(0, 0), upper_bound_95(5, 5)), (1.0, 1.0));
    }
}
