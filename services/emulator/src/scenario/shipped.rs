//! The scenarios that come with the program.

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../scenarios/", $name, ".toml")))),*]
    };
}

/// Name and text of each shipped scenario, the default one first.
pub(super) const SHIPPED: &[(&str, &str)] = shipped![
    "corridor",
    "free",
    "two-obstacles",
    "slalom",
    "walls",
    "noisy",
    "imperfect-robot",
    "blocked",
    "sudden",
    "crossing",
    "long",
    "endless",
    "thesis",
    "s-curve",
    "bend",
    "slalom-arc",
    "figure-eight",
    "overtake",
    "intersection",
    "stations",
    "u-turn",
    "dead-end",
    "park-parallel",
    "park-perpendicular",
];
