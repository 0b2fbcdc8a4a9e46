//! Where the emulated robot differs from the description that the stages read.

use std::cmp::Ordering;
use std::fmt;

/// `run` lists this many differences, and counts them when there are more.
const MAX_LISTED: usize = 3;

/// A property that `[robot]` and `[vehicle]` do not agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// Its key in both tables.
    pub key: &'static str,
    /// `robot.KEY`.
    pub truth: f64,
    /// `vehicle.KEY`.
    pub believed: f64,
}

impl Difference {
    /// Difference as a share of the believed value; infinite if that is zero.
    fn share(&self) -> f64 {
        (self.truth - self.believed) / self.believed.abs()
    }

    /// The order of a list: the largest share first.
    fn compare(&self, other: &Self) -> Ordering {
        other.share().abs().total_cmp(&self.share().abs()).then(self.key.cmp(other.key))
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { key, truth, believed } = self;
        write!(formatter, "robot.{key} = {}, vehicle.{key} = {}", rounded(*truth), rounded(*believed))?;
        match self.share() {
            share if share.is_finite() => write!(formatter, " ({:+.0} %)", 100.0 * share),
            _ => Ok(()),
        }
    }
}

/// A value with four digits, which is enough for a list; drawn values have sixteen.
fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The differences in the order of a list, the largest share first.
pub(crate) fn sorted(found: impl IntoIterator<Item = (&'static str, f64, f64)>) -> Vec<Difference> {
    let differences = found.into_iter().map(|(key, truth, believed)| Difference { key, truth, believed });
    let mut differences: Vec<_> = differences.collect();
    differences.sort_by(Difference::compare);
    differences
}

/// All differences below a heading, one a line; nothing when there are none.
pub fn list(differences: &[Difference]) -> Vec<String> {
    let heading = match differences.len() {
        0 => return Vec::new(),
        1 => "the robot differs from [vehicle] in one property:".to_owned(),
        count => format!("the robot differs from [vehicle] in {count} properties:"),
    };
    let rows = differences.iter().map(|difference| format!("  {difference}"));
    std::iter::once(heading).chain(rows).collect()
}

/// [`list`], or one line when it would be long.
pub fn summary(differences: &[Difference]) -> Vec<String> {
    match differences {
        [largest, ..] if differences.len() > MAX_LISTED => vec![format!(
            "{} properties of the robot differ from [vehicle], largest: {largest}; `scanloop check` lists them",
            differences.len()
        )],
        few => list(few),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_share_comes_first_and_is_shown_in_percent() {
        let found = sorted([
            ("mass_kg", 13.2255, 14.695),
            ("width_m", 1.4, 0.4),
            ("scanner_x_m", 0.1, 0.0),
            ("velocity_lag_s", 0.123_456_78, 0.15),
        ]);
        let expected = [
            "the robot differs from [vehicle] in 4 properties:",
            "  robot.scanner_x_m = 0.1, vehicle.scanner_x_m = 0",
            "  robot.width_m = 1.4, vehicle.width_m = 0.4 (+250 %)",
            "  robot.velocity_lag_s = 0.1235, vehicle.velocity_lag_s = 0.15 (-18 %)",
            "  robot.mass_kg = 13.23, vehicle.mass_kg = 14.7 (-10 %)",
        ];
        assert_eq!(list(&found), expected);
        let line = "4 properties of the robot differ from [vehicle], largest: robot.scanner_x_m = 0.1, \
                    vehicle.scanner_x_m = 0; `scanloop check` lists them";
        assert_eq!(summary(&found), [line]);
        assert_eq!(summary(&found[..2]), list(&found[..2]));
        assert!(list(&[]).is_empty() && summary(&[]).is_empty());
    }
}
