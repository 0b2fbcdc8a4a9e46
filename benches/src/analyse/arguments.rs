//! Options of `scanloop analyse`.

use std::path::PathBuf;

use crate::analysis::intervals::{ControlFamily, ErrorMeasure, Grid};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use estimator::Measured;
use ocp::Scheme;

/// The design analyses.
#[derive(Debug, Subcommand)]
pub(crate) enum AnalyseCommand {
    /// Test whether the measured states determine yaw, x and y: the rank of (7.2).
    ///
    /// Exit code 1 if they do not.
    Observability(ObservabilityArguments),
    /// Test whether velocity and steering act in different directions, so that BFGS is admissible.
    ///
    /// Exit code 1 if an angle is below 10 degrees.
    Correlation(CorrelationArguments),
    /// Find the number of intervals that a horizon needs; with `--n`, the longest horizon for N intervals.
    ///
    /// The defaults are the definition that gives the source's N = 6. Exit code 1 if the tolerance is not kept.
    Intervals(IntervalsArguments),
    /// Show how much of an odometry error each form of the correction leaves.
    Drift(DriftArguments),
}

/// Where an answer goes.
#[derive(Debug, Args)]
pub(crate) struct OutputArguments {
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Folder for the picture.
    #[arg(long, value_name = "DIR", default_value = "out/analyse", value_parser = console::output::folder())]
    pub out: PathBuf,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
}

/// Options of `analyse drift`.
#[derive(Debug, Args)]
pub(crate) struct DriftArguments {
    /// Where the answer goes.
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Options of `analyse observability`.
#[derive(Debug, Args)]
pub(crate) struct ObservabilityArguments {
    /// Measured states, separated by commas.
    #[arg(long, value_name = "STATES", value_delimiter = ',', default_value = "yaw,x,y", value_parser = one_of(&STATES))]
    pub measure: Vec<Measured>,
    /// Assume that the robot moves (the default).
    #[arg(long, conflicts_with = "standing")]
    pub moving: bool,
    /// Assume that the robot stands.
    #[arg(long)]
    pub standing: bool,
    /// Velocity of the moving robot [m/s], 0.1 to 1.
    #[arg(long, value_name = "V", default_value_t = 1.0, allow_negative_numbers = true)]
    pub velocity: f64,
    /// Steering angle of the moving robot [rad], -0.06 to 0.06.
    #[arg(long, value_name = "ANGLE", default_value_t = 0.0, allow_negative_numbers = true)]
    pub steering: f64,
    /// Drive a scenario instead, and say which errors of the robot its way shows to the estimator.
    #[arg(long, value_name = "SCENARIO", num_args = 0..=1, default_missing_value = "corridor")]
    #[arg(conflicts_with_all = ["measure", "moving", "standing", "velocity", "steering"])]
    pub states: Option<String>,
    /// Override a key of that scenario or of the system, for example `robot.preset=worn`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "states")]
    pub overrides: Vec<String>,
    /// Where the answer goes.
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Options of `analyse correlation`.
#[derive(Debug, Args)]
pub(crate) struct CorrelationArguments {
    /// Velocity at the operating point, u1 [m/s], 0.1 to 1.
    #[arg(long, value_name = "V", default_value_t = 0.5, allow_negative_numbers = true)]
    pub velocity: f64,
    /// Steering angle at the operating point, u2 [rad], -0.06 to 0.06; the default gives the angle of the source.
    #[arg(long, value_name = "ANGLE", default_value_t = -0.0074, allow_negative_numbers = true)]
    pub steering: f64,
    /// Length of the horizon [s], 0.05 to 60.
    #[arg(long, value_name = "S", default_value_t = 2.72, allow_negative_numbers = true)]
    pub tf: f64,
    /// Number of intervals, 1 to 100.
    #[arg(long, value_name = "N", default_value_t = 6)]
    pub n: usize,
    /// Collocation scheme whose own angles are printed together with those of the model.
    #[arg(long, value_name = "SCHEME", default_value = "radau-3", value_parser = one_of(&SCHEMES))]
    pub scheme: Scheme,
    /// Where the answer goes.
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Options of `analyse intervals`.
#[derive(Debug, Args)]
pub(crate) struct IntervalsArguments {
    /// Length of the horizon [s], 0.05 to 60.
    #[arg(long, value_name = "S", default_value_t = 2.72, allow_negative_numbers = true)]
    pub tf: f64,
    /// Largest allowed error, 1e-9 to 1.
    #[arg(long, value_name = "ERROR", default_value_t = 2.5e-4, allow_negative_numbers = true)]
    pub tol: f64,
    /// Collocation scheme.
    #[arg(long, value_name = "SCHEME", default_value = "gauss-2", value_parser = one_of(&SCHEMES))]
    pub scheme: Scheme,
    /// Error measure: position or all states at the ends of the intervals, or position also inside the intervals.
    #[arg(long, value_name = "ERROR", default_value = "position-ends", value_parser = one_of(&ERRORS))]
    pub error: ErrorMeasure,
    /// Admissible controls: constant over the horizon, or one value per interval.
    #[arg(long, value_name = "FAMILY", default_value = "constant", value_parser = one_of(&FAMILIES))]
    pub controls: ControlFamily,
    /// Find the longest horizon for this number of intervals instead, 1 to 40 (10 if piecewise or free).
    #[arg(long, value_name = "N")]
    pub n: Option<usize>,
    /// Lengths of the intervals: equal, or chosen for a small error.
    #[arg(long, value_name = "GRID", default_value = "uniform", value_parser = one_of(&GRIDS))]
    pub grid: Grid,
    /// Largest number of intervals that is tried, 1 to 40 (10 if piecewise or free); default 24 (10).
    #[arg(long, value_name = "N", conflicts_with = "n")]
    pub limit: Option<usize>,
    /// Where the answer goes.
    #[command(flatten)]
    pub output: OutputArguments,
}

/// Names of schemes.
pub(super) const SCHEMES: [(&str, Scheme); 8] = [
    ("radau-1", Scheme::Radau1),
    ("radau-2", Scheme::Radau2),
    ("radau-3", Scheme::Radau3),
    ("radau-4", Scheme::Radau4),
    ("gauss-1", Scheme::Gauss1),
    ("gauss-2", Scheme::Gauss2),
    ("gauss-3", Scheme::Gauss3),
    ("gauss-4", Scheme::Gauss4),
];

/// Names of error measures.
pub(super) const ERRORS: [(&str, ErrorMeasure); 3] = [
    ("position-ends", ErrorMeasure::PositionEnds),
    ("all-states-ends", ErrorMeasure::AllStatesEnds),
    ("position-dense", ErrorMeasure::PositionDense),
];

/// Names of families of controls.
pub(super) const FAMILIES: [(&str, ControlFamily); 2] =
    [("constant", ControlFamily::Constant), ("piecewise", ControlFamily::Piecewise)];

/// Names of grids.
pub(super) const GRIDS: [(&str, Grid); 2] = [("uniform", Grid::Uniform), ("free", Grid::Free)];

const STATES: [(&str, Measured); 3] = [("yaw", Measured::Yaw), ("x", Measured::X), ("y", Measured::Y)];

/// The name of a value in one of the lists above.
pub(super) fn name_of<T: PartialEq>(names: &[(&'static str, T)], value: T) -> &'static str {
    names.iter().find(|(_, other)| *other == value).map_or("", |(name, _)| name)
}

/// A parser that knows the names of a list and says so when it meets another.
fn one_of<T: Copy + Send + Sync + 'static>(
    names: &'static [(&'static str, T)],
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(names.iter().map(|(name, _)| *name)).try_map(move |text| {
        names.iter().find(|(name, _)| *name == text).map(|(_, value)| *value).ok_or("not a name of the list")
    })
}
