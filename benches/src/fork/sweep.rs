//! Values of one key: `KEY=a..b/n`.

use std::str::FromStr;

/// So many variants at most.
const MAX_VARIANTS: usize = 1000;

/// A key with evenly spaced values.
#[derive(Debug, PartialEq)]
pub(super) struct Sweep {
    key: String,
    from: f64,
    to: f64,
    count: usize,
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = || {
            let (key, values) = text.split_once('=')?;
            let (range, count) = values.rsplit_once('/')?;
            let (from, to) = range.split_once("..")?;
            let [from, to] = [from, to].map(|value| value.trim().parse::<f64>().ok());
            let (from, to, count) = (from?, to?, count.trim().parse::<usize>().ok()?);
            let is_allowed = (2..=MAX_VARIANTS).contains(&count) && from.is_finite() && to.is_finite();
            is_allowed.then(|| Self { key: key.to_owned(), from, to, count })
        };
        parse().ok_or_else(|| {
            format!("{text}: expected KEY=a..b/n with numbers a and b, and n from 2 to {MAX_VARIANTS}")
        })
    }
}

impl Sweep {
    /// `KEY=VALUE` for each value.
    pub(super) fn settings(&self) -> impl Iterator<Item = String> {
        let Self { key, from, to, count } = self;
        (0..*count).map(move |index| {
            let share = index as f64 / (count - 1) as f64;
            // Rounded to what a reader would write: 0.1 + 0.2 is 0.3.
            let value = ((from + (to - from) * share) * 1e9).round() / 1e9;
            format!("{key}={value}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_spread_evenly_with_both_ends() {
        let sweep: Sweep = "controller.cruise_mps=0.3..0.6/4".parse().unwrap();
        let expected = ["0.3", "0.4", "0.5", "0.6"].map(|value| format!("controller.cruise_mps={value}"));
        assert_eq!(sweep.settings().collect::<Vec<_>>(), expected);
        let whole: Sweep = "a=4..2/3".parse().unwrap();
        assert_eq!(whole.settings().collect::<Vec<_>>(), ["a=4", "a=3", "a=2"]);
    }

    #[test]
    fn what_is_no_sweep_is_refused_with_the_form_of_one() {
        for text in ["a", "a=1..2", "a=1/3", "a=1..2/1", "a=1..2/1001", "a=1..x/3", "a=nan..2/3"] {
            let refused = text.parse::<Sweep>().unwrap_err();
            assert!(refused.contains(text) && refused.contains("2 to 1000"), "{refused}");
        }
    }
}
