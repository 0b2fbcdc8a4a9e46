//! What a comparison says, in words and as JSON.

use figures::difference::{CONFIDENCE, Difference};
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
    /// Where B minus A lies.
    pub interval: [f64; 2],
    /// Share of such intervals that hold the true difference.
    pub confidence: f64,
    /// `no difference`, or what B is: `slower`, `faster`; `higher`, `lower` for figures that are no times.
    pub verdict: &'static str,
    /// A difference this large would have been seen nine times in ten.
    pub smallest_visible: f64,
    /// All of it as a sentence.
    pub text: String,
}

impl Verdict {
    /// The verdict on a figure.
    pub(crate) fn new(metric: &str, [a, b]: [f64; 2], difference: &Difference) -> Self {
        let unit = unit(metric);
        let words = if unit.is_empty() { ["higher", "lower"] } else { ["slower", "faster"] };
        let verdict = match difference.is_seen() {
            false => "no difference",
            true if difference.value > 0.0 => words[0],
            true => words[1],
        };
        let [low, high] = difference.interval;
        let percent = CONFIDENCE * 100.0;
        let space = if unit.is_empty() { "" } else { " " };
        let text = if difference.is_seen() {
            format!(
                "B is {}{space}{unit} {verdict} ({percent} % interval {} to {})",
                number(difference.value.abs()),
                number(low),
                number(high)
            )
        } else {
            format!(
                "no difference seen ({percent} % interval {} to {}); one below {}{space}{unit} could have stayed unseen",
                number(low),
                number(high),
                number(difference.smallest_visible)
            )
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
            text,
        }
    }
}

/// The unit of time that a key of the path ends with; empty for anything else.
fn unit(metric: &str) -> &'static str {
    let ends = |key: &str| match key.rsplit_once('_').map(|(_, unit)| unit) {
        Some("ns") => "ns",
        Some("us") => "us",
        Some("ms") => "ms",
        Some("s") => "s",
        _ => "",
    };
    metric.rsplit('.').map(ends).find(|unit| !unit.is_empty()).unwrap_or_default()
}

/// Three digits that count, and the sign of what is below zero.
fn number(value: f64) -> String {
    let size = value.abs();
    let decimals = if size >= 100.0 || size == 0.0 {
        0
    } else if size >= 10.0 {
        1
    } else if size >= 1.0 {
        2
    } else {
        (2 - size.log10().floor() as i32).clamp(3, 9)
    };
    format!("{value:.*}", decimals as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_told_with_its_interval_and_none_with_what_could_be_hidden() {
        let seen = Difference { value: 12.34, interval: [8.1, 16.44], smallest_visible: 6.2 };
        let verdict = Verdict::new("scan_to_actuation_us.p50", [100.0, 112.34], &seen);
        assert_eq!(verdict.text, "B is 12.3 us slower (99 % interval 8.10 to 16.4)");
        let faster = Difference { value: -0.5, interval: [-0.75, -0.25], smallest_visible: 0.4 };
        let verdict = Verdict::new("wall_s", [1.5, 1.0], &faster);
        assert_eq!(
            (verdict.verdict, verdict.text.as_str()),
            ("faster", "B is 0.500 s faster (99 % interval -0.750 to -0.250)")
        );
        let none = Difference { value: 1.0, interval: [-3.0, 5.0], smallest_visible: 5.99 };
        let verdict = Verdict::new("late", [0.0, 1.0], &none);
        assert_eq!(verdict.verdict, "no difference");
        assert!(verdict.text.ends_with("one below 5.99 could have stayed unseen"), "{}", verdict.text);
    }

    #[test]
    fn units_are_those_of_the_key() {
        assert_eq!(unit("scan_to_actuation_us.p50"), "us");
        assert_eq!((unit("solvers.0.solve_us.p50"), unit("duration_s"), unit("published")), ("us", "s", ""));
    }
}
