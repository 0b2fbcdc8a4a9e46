//! The families of a campaign by their names.

use courses::course::Family;
use courses::course::hostile::Hostile;

/// The name that chooses all hostile families.
const ALL_HOSTILE: &str = "hostile";
/// The name of [`Kind::Curved`].
const CURVED: &str = "curved";
/// The name of [`Kind::Reversing`].
const REVERSING: &str = "reversing";

/// A family of courses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    /// One of those that a campaign without `--family` mixes.
    Mixed(Family),
    /// A hostile one.
    Hostile(Hostile),
    /// Obstacles at rest along a way that bends.
    Curved,
    /// Turns in three, with obstacles beside the way.
    Reversing,
    /// The scenario of this argument.
    Given(usize),
}

/// Names that `--family` takes.
pub(super) fn family_names() -> Vec<&'static str> {
    let mixed = Family::ALL.iter().map(|family| family.name());
    mixed
        .chain(Hostile::ALL.iter().map(|family| family.name()))
        .chain([ALL_HOSTILE, CURVED, REVERSING])
        .collect()
}

/// The families of a name.
pub(super) fn named(name: &str) -> Vec<Kind> {
    let mixed = Family::ALL.iter().filter(|family| family.name() == name).map(|family| Kind::Mixed(*family));
    let hostile = Hostile::ALL.iter().filter(|family| family.name() == name || name == ALL_HOSTILE);
    let curved = (name == CURVED).then_some(Kind::Curved);
    let reversing = (name == REVERSING).then_some(Kind::Reversing);
    mixed.chain(hostile.map(|family| Kind::Hostile(*family))).chain(curved).chain(reversing).collect()
}

impl Kind {
    /// The name of the family, or of one of these scenarios.
    pub(super) fn name(self, scenarios: &[String]) -> &str {
        match self {
            Self::Mixed(family) => family.name(),
            Self::Hostile(family) => family.name(),
            Self::Curved => CURVED,
            Self::Reversing => REVERSING,
            Self::Given(index) => &scenarios[index],
        }
    }
}
