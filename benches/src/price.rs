//! `scanloop-lab price`: what latency, scan rate and pose uncertainty cost in centimetres, measured by driving.
//!
//! Each condition changes one thing around the chosen robot and system. Two courses are driven under each condition
//! through the pipeline in one process: a gap between two boxes, which is bisected, and a box that closes the track
//! suddenly. No formula predicts a figure; the only arithmetic afterwards is a least-squares line.

mod condition;
mod costs;
mod course;
mod measure;
mod picture;
mod search;
mod text;

use std::path::PathBuf;

use clap::Args;
use console::exit::Exit;
use console::out_folder::OutFolder;
use console::progress::Steps;
use console::{answer, note};
use plan::{Choice, Plan};
use serde::Serialize;

use crate::robot::RobotPreset;
use commands::print_json;
use condition::{Condition, Varied};
use costs::Costs;
use measure::{Figures, Measurement};

/// The file of the picture.
const PICTURE: &str = "price.svg";

/// Arguments of `price`.
#[derive(Debug, Args, Default)]
pub(crate) struct PriceArguments {
    /// Number of seeds under each condition; a gap counts as passed if the robot passes it with every seed.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub(crate) seeds: u64,
    /// Preset of the true robot.
    #[arg(long, value_enum, value_name = "PRESET", default_value_t)]
    pub(crate) robot: RobotPreset,
    /// Print JSON to standard output.
    #[arg(long)]
    pub(crate) json: bool,
    /// Folder for the picture.
    #[arg(long, value_name = "DIR", default_value = "out/price", value_parser = console::output::folder())]
    pub(crate) out: PathBuf,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub(crate) force: bool,
    /// The choice of robot and system.
    #[command(flatten)]
    pub(crate) choice: Choice,
}

/// The figures under one condition.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Row {
    /// What differs from the chosen robot and system in the rows of this group.
    varied: Varied,
    /// Delay added between actuator and wheels, in the true robot and in its description.
    latency_ms: f64,
    rate_hz: f64,
    /// White noise of the reported position.
    pose_sigma_m: f64,
    /// Radius of the bend in which the courses stand; nothing on a line.
    radius_m: Option<f64>,
    smallest_gap_m: Option<f64>,
    stopping_distance_m: Option<f64>,
    /// Speed of the robot when the box appeared, the largest of all drives.
    speed_mps: Option<f64>,
    /// Why a figure is missing, and every contact.
    notes: Vec<String>,
}

/// What the command prints as JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Price {
    rows: Vec<Row>,
    costs: Costs,
    /// Width of the robot's body, which is contained in every gap.
    body_width_m: f64,
    contacts: usize,
}

/// Drives all conditions, prints the table and writes the picture; exit code 3 when an obstacle was touched.
///
/// # Errors
/// Wrong arguments, exit code 2; errors of the file system.
pub(crate) fn price(arguments: &PriceArguments) -> anyhow::Result<Exit> {
    let results = OutFolder::claim(&arguments.out, &[PICTURE], arguments.force)?;
    let base = condition::base(arguments)?;
    base.warnings.iter().for_each(|warning| note!("{warning}"));
    let price = measured(arguments, &base)?;
    answer!(arguments.json, "{}", text::text(&price))?;
    let picture = results.write(PICTURE, picture::draw(&price)?.as_bytes())?;
    answer!(arguments.json, "picture         {}", picture.display())?;
    print_json(arguments.json, &price)?;
    Ok(if price.contacts == 0 { Exit::Done } else { Exit::Collision })
}

fn measured(arguments: &PriceArguments, base: &Plan) -> std::io::Result<Price> {
    let conditions = condition::all(base);
    let measurements = Measurement::of_conditions(arguments, &conditions);
    let mut steps = Steps::new(measurements.len() as u64, "conditions");
    let figures = measure::on_all_cores(&measurements, || steps.step(""))?;
    let of = |condition: &Condition| {
        let index = measurements.iter().position(|measurement| measurement.belongs_to(condition));
        index.map(|index| figures[index].clone()).unwrap_or_default()
    };
    let rows: Vec<Row> = conditions.iter().map(|condition| row(condition, of(condition))).collect();
    Ok(Price {
        costs: Costs::of(&rows, base.system.rate_hz),
        rows,
        body_width_m: base.scenario.robot.width_m,
        contacts: figures.iter().map(|figures| figures.contacts).sum(),
    })
}

fn row(condition: &Condition, figures: Figures) -> Row {
    let Condition { varied, latency_ms, rate_hz, pose_sigma_m, radius_m, .. } = *condition;
    let Figures { smallest_gap_m, stopping_distance_m, speed_mps, notes, .. } = figures;
    Row {
        varied,
        latency_ms,
        rate_hz,
        pose_sigma_m,
        radius_m,
        smallest_gap_m,
        stopping_distance_m,
        speed_mps,
        notes,
    }
}

#[cfg(test)]
mod tests;
