//! `scanloop analyse`: the design analyses of the source, each with the definition it used and a picture.
//!
//! The answer goes to standard error as a table, with `--json` to standard output as data, and to an SVG file. The
//! exit code tells the verdict: 0 when the states are observable, the controls are not correlated, the tolerance is
//! kept; 1 when not.

mod arguments;
mod correlation;
mod drift;
mod intervals;
mod observability;

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

pub use arguments::{
    AnalyseCommand, CorrelationArguments, DriftArguments, IntervalsArguments, ObservabilityArguments,
    OutputArguments,
};

use console::exit::{Exit, Failure};
use console::note;
use console::output;
use report::picture::chart::{self, Chart};

/// Answers the question, prints the answer and draws it.
///
/// # Errors
/// Options that are not allowed, exit code 2; errors of the file system.
pub(crate) fn analyse(command: &AnalyseCommand) -> anyhow::Result<Exit> {
    match command {
        AnalyseCommand::Observability(arguments) => observability::analyse(arguments),
        AnalyseCommand::Correlation(arguments) => correlation::analyse(arguments),
        AnalyseCommand::Intervals(arguments) => intervals::analyse(arguments),
        AnalyseCommand::Drift(arguments) => drift::analyse(arguments),
    }
}

/// Writes the picture, prints the table and, if asked, the data.
fn publish(
    output: &OutputArguments,
    name: &str,
    table: &str,
    chart: &Chart,
    data: &impl Serialize,
) -> anyhow::Result<()> {
    let path = write(&output.out, name, &chart::draw(chart)?)?;
    note!("{table}");
    note!("picture         {}", path.display());
    if output.json {
        output::data(&serde_json::to_string_pretty(data)?)?;
    }
    Ok(())
}

fn write(folder: &Path, name: &str, svg: &str) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
    let path = folder.join(format!("{name}.svg"));
    std::fs::write(&path, svg).with_context(|| format!("{}", path.display()))?;
    Ok(path)
}

/// An option that is not allowed, as it was typed.
fn refuse(invalid: vehicle::Invalid) -> anyhow::Error {
    Failure::bad_input(format!("--{invalid}"))
}
