//! The result of a comparison, as text and as JSON.

use figures::difference::{CONFIDENCE, DifferenceEstimate, MAX_ROUNDS};
use serde::Serialize;

/// The comparison of one figure; numbers have the unit that the name of the metric ends with.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Verdict {
    /// The figure, as a path of keys.
    pub metric: String,
    /// The figure of A.
    pub a: f64,
    /// The figure of B.
    pub b: f64,
    /// Best estimate of B minus A.
    pub difference: f64,
    /// Confidence interval of B minus A.
    pub interval: [f64; 2],
    /// Share of such intervals that hold the true difference.
    pub confidence: f64,
    /// `no difference`, or what B is: `slower`, `faster`; `higher`, `lower` for figures that are no times.
    pub verdict: &'static str,
    /// The smallest difference that is detected with 90 % probability.
    pub smallest_visible: f64,
    /// For `no difference`: how many rounds in turns would show a difference of the estimated size; null when it takes
    /// more than a thousand.
    pub rounds_to_settle: Option<usize>,
    /// For `no difference` between files: a figure that is part of this one and varies less.
    pub metric_to_settle: Option<String>,
    /// The result as a sentence.
    pub text: String,
}

impl Verdict {
    /// The verdict on a figure after so many rounds; two files count as one.
    pub(crate) fn new(
        metric: &str,
        [a, b]: [f64; 2],
        difference: &DifferenceEstimate,
        rounds: usize,
    ) -> Self {
        let (directions, unit) = match unit(metric) {
            "" => (["higher", "lower"], String::new()),
            unit => (["slower", "faster"], format!(" {unit}")),
        };
        let [low, high] = difference.interval.map(number);
        let interval = format!("({} % interval {low} to {high})", CONFIDENCE * 100.0);
        let (verdict, text, rounds_to_settle) = if difference.is_seen() {
            let verdict = directions[usize::from(difference.value < 0.0)];
            let size = number(difference.value.abs());
            (verdict, format!("B is {size}{unit} {verdict} {interval}"), None)
        } else {
            let smallest = number(difference.smallest_visible);
            let text = format!(
                "no difference seen {interval}; a difference below {smallest}{unit} may be missed; {}",
                settlement(difference, rounds, &unit)
            );
            ("no difference", text, difference.rounds_to_settle(rounds))
        };
        Self {
            metric: metric.to_owned(),
            a,
            b,
            difference: difference.value,
            interval: difference.interval,
            confidence: CONFIDENCE,
            verdict,
            smallest_visible: difference.smallest_visible,
            rounds_to_settle,
            metric_to_settle: None,
            text,
        }
    }

    /// Names a part of this figure that varies less: what was changed may show there.
    pub(crate) fn settle_with(&mut self, metric: &str, difference: &DifferenceEstimate) {
        let what = if difference.is_seen() { "shows one" } else { "would show a smaller one" };
        let (smallest, unit) = (number(difference.smallest_visible), unit(metric));
        self.text += &format!("; --metric {metric} {what}, from {smallest} {unit} on");
        self.metric_to_settle = Some(metric.to_owned());
    }
}

/// The number of rounds that would show whether the estimated difference is real.
fn settlement(difference: &DifferenceEstimate, rounds: usize, unit: &str) -> String {
    if difference.value == 0.0 {
        return "the two figures are equal".to_owned();
    }
    let size = number(difference.value.abs()) + unit;
    let turns = if rounds == 1 { "of `--ab` " } else { "" };
    match difference.rounds_to_settle(rounds) {
        Some(needed) => format!("{needed} rounds {turns}(--rounds {needed}) would settle one of {size}"),
        None => format!(
            "{MAX_ROUNDS} rounds {turns}would not settle one of {size}: take a figure that varies less"
        ),
    }
}

/// The unit of time that a key of the path ends with; empty for anything else.
fn unit(metric: &str) -> &'static str {
    let unit_of = |key: &str| {
        let (_, end) = key.rsplit_once('_')?;
        ["ns", "us", "ms", "s"].into_iter().find(|unit| *unit == end)
    };
    metric.rsplit('.').find_map(unit_of).unwrap_or_default()
}

/// A number with three significant digits.
fn number(value: f64) -> String {
    let magnitude = if value == 0.0 { 2.0 } else { value.abs().log10().floor() };
    let decimals = (2.0 - magnitude).clamp(0.0, 9.0) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_has_its_interval_and_none_has_the_smallest_visible_one() {
        let seen = DifferenceEstimate { value: 12.34, interval: [8.1, 16.44], smallest_visible: 6.2 };
        let verdict = Verdict::new("scan_to_actuation_us.p50", [100.0, 112.34], &seen, 12);
        assert_eq!(verdict.text, "B is 12.3 us slower (99 % interval 8.10 to 16.4)");
        let faster = DifferenceEstimate { value: -0.5, interval: [-0.75, -0.25], smallest_visible: 0.4 };
        let verdict = Verdict::new("wall_s", [1.5, 1.0], &faster, 12);
        assert_eq!(
            (verdict.verdict, verdict.text.as_str()),
            ("faster", "B is 0.500 s faster (99 % interval -0.750 to -0.250)")
        );
        let none = DifferenceEstimate { value: 1.0, interval: [-3.0, 5.0], smallest_visible: 5.99 };
        let verdict = Verdict::new("late", [0.0, 1.0], &none, 12);
        assert_eq!((verdict.verdict, verdict.rounds_to_settle), ("no difference", Some(431)));
        let end = "a difference below 5.99 may be missed; 431 rounds (--rounds 431) would settle one of 1.00";
        assert!(verdict.text.ends_with(end), "{}", verdict.text);
    }

    #[test]
    fn a_part_that_varies_less_is_named_where_rounds_would_not_do() {
        let none = DifferenceEstimate { value: 0.01, interval: [-3.0, 5.0], smallest_visible: 5.99 };
        let mut verdict = Verdict::new("scan_to_actuation_us.p50", [100.0, 100.0], &none, 1);
        assert_eq!(verdict.rounds_to_settle, None);
        assert!(
            verdict.text.contains("1000 rounds of `--ab` would not settle one of 0.0100 us"),
            "{}",
            verdict.text
        );
        let part = DifferenceEstimate { value: 1.0, interval: [0.5, 1.5], smallest_visible: 0.75 };
        verdict.settle_with("transport_us.p50", &part);
        assert!(
            verdict.text.ends_with("--metric transport_us.p50 shows one, from 0.750 us on"),
            "{}",
            verdict.text
        );
        assert_eq!(verdict.metric_to_settle.as_deref(), Some("transport_us.p50"));
    }

    #[test]
    fn units_are_those_of_the_key() {
        assert_eq!(unit("scan_to_actuation_us.p50"), "us");
        assert_eq!((unit("solvers.0.solve_us.p50"), unit("duration_s"), unit("published")), ("us", "s", ""));
    }
}
