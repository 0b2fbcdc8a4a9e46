//! `scanloop-lab analyse`: the design analyses of the source, each with the definition it used and a picture.
//!
//! The result is a table on standard error, an SVG file, and with `--json` data on standard output. The exit code is 0
//! when the states are observable, the controls are not correlated, or the tolerance is kept; else 1.

mod arguments;
mod correlation;
mod drift;
mod intervals;
mod observability;
mod states;

use console::out_folder::OutFolder;
use serde::Serialize;

pub(crate) use arguments::{
    AnalyseCommand, CorrelationArguments, DriftArguments, IntervalsArguments, ObservabilityArguments,
    OutputArguments,
};

use commands::print_json;
use console::answer;
use console::exit::{Exit, Failure};
use report::picture::chart::{self, Chart};
use vehicle::Control;

/// Runs an analysis, prints the result and draws it.
///
/// # Errors
/// Options that are not allowed, exit code 2; errors of the file system.
pub(crate) fn analyse(command: &AnalyseCommand) -> anyhow::Result<Exit> {
    match command {
        AnalyseCommand::Observability(arguments) => match &arguments.states {
            Some(scenario) => states::analyse(scenario, arguments),
            None => observability::analyse(arguments),
        },
        AnalyseCommand::Correlation(arguments) => correlation::analyse(arguments),
        AnalyseCommand::Intervals(arguments) => intervals::analyse(arguments),
        AnalyseCommand::Drift(arguments) => drift::analyse(arguments),
    }
}

/// A control in the JSON of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct OperatingPoint {
    velocity_mps: f64,
    steering_rad: f64,
}

impl From<&Control> for OperatingPoint {
    fn from(control: &Control) -> Self {
        Self { velocity_mps: control.velocity, steering_rad: control.steering }
    }
}

/// Writes the picture, prints the table and, if asked, the data; exit code 0 when the result is good.
fn publish(
    output: &OutputArguments,
    name: &str,
    table: &str,
    chart: &Chart,
    data: &impl Serialize,
    is_good: bool,
) -> anyhow::Result<Exit> {
    let name = format!("{name}.svg");
    let results = OutFolder::claim(&output.out, &[&name], output.force)?;
    let path = results.write(&name, chart::draw(chart)?.as_bytes())?;
    answer!(output.json, "{table}\npicture         {}", path.display())?;
    print_json(output.json, data)?;
    Ok(if is_good { Exit::Done } else { Exit::NotReached })
}

/// The error of an option that is not allowed.
fn refuse(invalid: vehicle::Invalid) -> anyhow::Error {
    Failure::bad_input(format!("--{invalid}"))
}
