//! Arguments of `calibrate`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// What is calibrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CalibrationKind {
    /// The velocity factor kv, from straight runs with the columns sent_velocity_mps, distance_m, time_s.
    Velocity,
    /// The steering map and the play, from circle runs with the columns sent_steering_rad, approached_from, chord_m,
    /// height_m.
    Steering,
    /// The odometry coefficients df and dds and the play, from sine runs with the columns run, time_s, sent_steering_rad,
    /// reported_x_m, reported_y_m, reported_yaw_rad, speed_mps, measured_x_m, measured_y_m.
    Drift,
}

impl CalibrationKind {
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
    /// What to calibrate.
    #[arg(value_enum)]
    pub kind: CalibrationKind,
    /// Recorded runs as CSV tables; docs/calibration.md describes their columns.
    #[arg(value_name = "CSV", required_unless_present = "drive", conflicts_with = "drive")]
    pub files: Vec<PathBuf>,
    /// Let the emulated robot drive the runs on an empty floor without bounds; the fit does not read its true
    /// parameters.
    #[arg(long)]
    pub drive: bool,
    /// System file whose vehicle is calibrated; without it the SUMMIT.
    #[arg(long, value_name = "FILE")]
    pub system: Option<PathBuf>,
    /// Scenario whose robot drives: a file, or the name of a shipped scenario.
    #[arg(long, value_name = "SCENARIO", requires = "drive")]
    pub scenario: Option<String>,
    /// Seed of the measurement errors of stopwatch, tape measure and odometer.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drive")]
    pub seed: u64,
    /// Override a key of the scenario, for example `robot.velocity_factor=1.3`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "drive")]
    pub overrides: Vec<String>,
    /// Folder for the picture of the residuals and the table of driven runs.
    #[arg(long, value_name = "DIR", default_value = "out/calibration", value_parser = console::output::folder())]
    pub out: PathBuf,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
    /// Calibration file that receives the result; its other parts stay; default `DIR/calibration.toml`.
    #[arg(long, value_name = "FILE")]
    pub into: Option<PathBuf>,
    /// Note that is kept in the file, for example date, place and floor.
    #[arg(long, value_name = "TEXT", default_value = "")]
    pub note: String,
    /// Print the result as JSON to standard output.
    #[arg(long)]
    pub json: bool,
}
