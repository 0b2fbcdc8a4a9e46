//! Arguments of `calibrate`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// What is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// The velocity factor kv, from straight runs: sent_velocity_mps, distance_m, time_s.
    Velocity,
    /// The steering map and the play, from circle runs: sent_steering_rad, approached_from, chord_m, height_m.
    Steering,
    /// The odometry coefficients df and dds and the play, from sine runs: run, time_s, sent_steering_rad,
    /// reported_x_m, reported_y_m, reported_yaw_rad, speed_mps, measured_x_m, measured_y_m.
    Drift,
}

impl Kind {
    /// Its name on the command line and of its files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Velocity => "velocity",
            Self::Steering => "steering",
            Self::Drift => "drift",
        }
    }
}

/// Arguments of `calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArguments {
    /// What is calibrated.
    #[arg(value_enum)]
    pub kind: Kind,
    /// Tables of recorded runs; docs/calibration.md describes their columns.
    #[arg(value_name = "CSV", required_unless_present = "drive", conflicts_with = "drive")]
    pub files: Vec<PathBuf>,
    /// Let the emulated robot drive the runs on an endless empty floor; its true parameters stay hidden.
    #[arg(long)]
    pub drive: bool,
    /// The scenario whose robot drives: a TOML file, or the name of a shipped one.
    #[arg(long, value_name = "SCENARIO", requires = "drive")]
    pub scenario: Option<String>,
    /// Seed of the errors of stopwatch, tape measure and odometer.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drive")]
    pub seed: u64,
    /// Override a value of the scenario, for example `robot.velocity_factor=1.3`.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "drive")]
    pub overrides: Vec<String>,
    /// Where the picture of the residuals and the table of driven runs are written.
    #[arg(long, value_name = "DIR", default_value = "out/calibration", value_parser = console::output::folder())]
    pub out: PathBuf,
    /// The calibration file that takes the result; the other parts in it stay. Default: DIR/calibration.toml.
    #[arg(long, value_name = "FILE")]
    pub into: Option<PathBuf>,
    /// Date, place, floor: a note that is kept in the file.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub note: String,
    /// Print the result as JSON to standard output.
    #[arg(long)]
    pub json: bool,
}
