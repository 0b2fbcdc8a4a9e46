//! Where the emulated robot and its surroundings differ from the description that the stages read.

use std::cmp::Ordering;
use std::fmt;

use vehicle::Surroundings;

/// `run` lists this many differences, and counts them when there are more.
const MAX_LISTED: usize = 3;

/// A value of a property.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Property {
    /// Of the robot.
    Number(f64),
    /// Of the track.
    Surroundings(Surroundings),
}

/// A property that scenario and `[vehicle]` do not agree on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PropertyDifference {
    /// The scenario's table that has it: `robot`, `track` or `course`.
    pub table: &'static str,
    /// Its key in both tables.
    pub key: &'static str,
    /// Its value in the scenario.
    pub truth: Property,
    /// `vehicle.KEY`.
    pub believed: Property,
    /// The preset that gives the truth, where no key of the user does.
    pub preset: Option<&'static str>,
}

impl PropertyDifference {
    /// Difference as a share of the believed value; infinite if that is zero or no number.
    fn share(&self) -> f64 {
        match (self.truth, self.believed) {
            (Property::Number(truth), Property::Number(believed)) => (truth - believed) / believed.abs(),
            _ => f64::INFINITY,
        }
    }

    /// The order of a list: the largest share first.
    fn compare(&self, other: &Self) -> Ordering {
        other.share().abs().total_cmp(&self.share().abs()).then(self.key.cmp(other.key))
    }
}

impl fmt::Display for PropertyDifference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { table, key, truth, believed, .. } = self;
        write!(formatter, "{table}.{key} = {truth}, vehicle.{key} = {believed}")?;
        match self.share() {
            share if share.is_finite() => write!(formatter, " ({:+.0} %)", 100.0 * share),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Property {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => rounded(*value).fmt(formatter),
            Self::Surroundings(surroundings) => surroundings.fmt(formatter),
        }
    }
}

/// A value with four digits, which is enough for a list; drawn values have sixteen.
fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The differences in the order of a list, the largest share first.
pub(crate) fn sorted(
    found: impl IntoIterator<Item = (&'static str, f64, f64)>,
    [truth, believed]: [Surroundings; 2],
) -> Vec<PropertyDifference> {
    let of_robot = found.into_iter().map(|(key, truth, believed)| PropertyDifference {
        table: "robot",
        key,
        truth: Property::Number(truth),
        believed: Property::Number(believed),
        preset: None,
    });
    let of_track = (truth != believed).then_some(PropertyDifference {
        table: "track",
        key: "surroundings",
        truth: Property::Surroundings(truth),
        believed: Property::Surroundings(believed),
        preset: None,
    });
    let mut differences: Vec<_> = of_robot.chain(of_track).collect();
    differences.sort_by(PropertyDifference::compare);
    differences
}

/// All differences below a heading, one a line; nothing when there are none.
pub fn list(differences: &[PropertyDifference]) -> Vec<String> {
    let of_preset: Vec<&str> = differences.iter().filter_map(|difference| difference.preset).collect();
    let count = match differences.len() {
        0 => return Vec::new(),
        1 => "one property".to_owned(),
        count => format!("{count} properties"),
    };
    let heading = match of_preset.as_slice() {
        [] => format!("the scenario differs from [vehicle] in {count}:"),
        [preset, ..] if of_preset.len() == differences.len() => {
            format!(
                "robot.preset `{preset}` of the scenario differs from [vehicle] in {count}, as `summit` does not:"
            )
        }
        [preset, ..] => format!(
            "the scenario differs from [vehicle] in {count}, in {} of them by robot.preset `{preset}`:",
            of_preset.len()
        ),
    };
    let rows = differences.iter().map(|difference| format!("  {difference}"));
    std::iter::once(heading).chain(rows).collect()
}

/// [`list`], or one line when it would be long.
pub fn summary(differences: &[PropertyDifference]) -> Vec<String> {
    match differences {
        [largest, ..] if differences.len() > MAX_LISTED => {
            let presets = differences.iter().map(|difference| difference.preset);
            let whole = presets.reduce(|one, other| one.and(other)).flatten();
            let whose = whole.map_or("the scenario".to_owned(), |preset| format!("robot.preset `{preset}`"));
            vec![format!(
                "{} properties of {whose} differ from [vehicle], largest: {largest}; `scanloop check` lists them",
                differences.len()
            )]
        }
        few => list(few),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_share_comes_first_and_is_shown_in_percent() {
        let rows = [
            ("mass_kg", 13.2255, 14.695),
            ("width_m", 1.4, 0.4),
            ("scanner_x_m", 0.1, 0.0),
            ("velocity_lag_s", 0.123_456_78, 0.15),
        ];
        let found = sorted(rows, [Surroundings::Hall; 2]);
        let expected = [
            "the scenario differs from [vehicle] in 4 properties:",
            "  robot.scanner_x_m = 0.1, vehicle.scanner_x_m = 0",
            "  robot.width_m = 1.4, vehicle.width_m = 0.4 (+250 %)",
            "  robot.velocity_lag_s = 0.1235, vehicle.velocity_lag_s = 0.15 (-18 %)",
            "  robot.mass_kg = 13.23, vehicle.mass_kg = 14.7 (-10 %)",
        ];
        assert_eq!(list(&found), expected);
        let line = "4 properties of the scenario differ from [vehicle], largest: robot.scanner_x_m = 0.1, \
                    vehicle.scanner_x_m = 0; `scanloop check` lists them";
        assert_eq!(summary(&found), [line]);
        assert_eq!(summary(&found[..2]), list(&found[..2]));
        assert!(list(&[]).is_empty() && summary(&[]).is_empty());
    }

    #[test]
    fn what_only_the_preset_gives_is_told_as_its_property() {
        let mut found = sorted([("mass_kg", 1.0, 2.0), ("width_m", 1.4, 0.4)], [Surroundings::Hall; 2]);
        found[1].preset = Some("ideal");
        let mixed =
            "the scenario differs from [vehicle] in 2 properties, in 1 of them by robot.preset `ideal`:";
        assert_eq!(list(&found)[0], mixed);
        found[0].preset = Some("ideal");
        let all = "robot.preset `ideal` of the scenario differs from [vehicle] in 2 properties, as `summit` does not:";
        assert_eq!(list(&found)[0], all);
    }

    #[test]
    fn other_surroundings_than_described_are_a_difference_before_those_in_percent() {
        let found = sorted([("width_m", 1.4, 0.4)], [Surroundings::Open, Surroundings::Hall]);
        let rows = [
            "  track.surroundings = open, vehicle.surroundings = hall",
            "  robot.width_m = 1.4, vehicle.width_m = 0.4 (+250 %)",
        ];
        assert_eq!(list(&found)[1..], rows);
    }
}
