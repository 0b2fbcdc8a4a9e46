//! The true robot of a study.

use clap::ValueEnum;

/// A set of values for the true robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub(crate) enum RobotPreset {
    /// Follows every command at once.
    Ideal,
    /// A believable robot, with delays, lags and slipping tyres.
    #[default]
    Summit,
}

impl RobotPreset {
    /// Its name as value of `robot.preset`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Ideal => "ideal",
            Self::Summit => "summit",
        }
    }
}
