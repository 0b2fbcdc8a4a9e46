//! Arguments of `campaign`.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum};
use emulator::scenario::{Preset, Robot};

use super::kind::family_names;

/// Arguments of `campaign`.
#[derive(Debug, Clone, Args, Default)]
pub(crate) struct CampaignArguments {
    /// Scenario files or names of shipped scenarios, each driven with `--runs` seeds; without any, random courses.
    #[arg(value_name = "SCENARIO")]
    pub scenarios: Vec<String>,
    /// Drive courses of this family only; may be repeated.
    #[arg(long = "family", conflicts_with = "scenarios", value_name = "NAME", value_parser = PossibleValuesParser::new(family_names()))]
    pub families: Vec<String>,
    /// The true robot; what is random is drawn from the seed of each course.
    #[arg(long, value_enum, value_name = "ROBOT", default_value_t)]
    pub robot: CampaignRobot,
    /// System file, for example of another vehicle; without it the built-in one.
    #[arg(long, value_name = "FILE")]
    pub system: Option<PathBuf>,
    /// Make all courses larger by this factor, for a vehicle of another size.
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
    /// Override a key of all scenarios or of the system, for example `robot.velocity_factor=1.45`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Number of courses; with `--family` of each family, with scenarios of each one.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub runs: u64,
    /// Seed of the first course; the following ones have the next numbers.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Folder for the scenario files of bad courses.
    #[arg(long, value_name = "DIR", default_value = "out/campaign", value_parser = console::output::folder())]
    pub out: PathBuf,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
}

/// The true robot of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub(crate) enum CampaignRobot {
    /// Follows every command at once.
    #[default]
    Ideal,
    /// A believable robot, as its description states it.
    Summit,
    /// Another robot on each course, with the preset `worn`.
    Worn,
    /// Another robot on each course: what the vehicle description states is within 20 %, the odometry scale within 1 %.
    Random,
}

impl CampaignRobot {
    /// Its name.
    pub(crate) fn name(self) -> String {
        self.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
    }

    /// The robot of a course; the seed of the course draws what is random.
    pub(super) fn of(self, robot: Robot) -> Robot {
        match self {
            Self::Ideal => Robot { preset: Preset::Ideal, ..robot },
            Self::Summit => Robot { preset: Preset::Summit, ..robot },
            Self::Worn => Robot { preset: Preset::Worn, ..robot },
            // What the description states within 20 %, the odometry scale within 1 %; what it does not state is exact.
            Self::Random => Robot {
                preset: Preset::Worn,
                velocity_factor: Some(1.4),
                steering_offset_rad: Some(0.0),
                ..robot
            },
        }
    }
}
