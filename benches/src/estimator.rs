//! `scanloop-lab estimator`: how far the estimated pose is from the true one, and whether its covariance says so.
//!
//! Robots drive courses through the pipeline in one process, in simulated time, once with each seed. Each scan compares
//! the pose with the truth at the acquisition of the scan. The odometer without a filter is measured in the same drives:
//! its pose is corrected as the estimator corrects it, and nothing else.

mod course;
mod drive;
mod picture;
mod results;
mod scans;
mod tally;
mod text;

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValuesParser;
use console::answer;
use console::exit::{Exit, Failure};
use console::new_file::{Existing, NewFile};
use console::progress::Steps;
use plan::Choice;
use vehicle::{Invalid, Surroundings};

use crate::cores::on_all_cores;
use commands::print_json;
use course::{Condition, Ground, ROBOTS};
use results::Results;

/// Arguments of `estimator`.
#[derive(Debug, Args)]
pub(crate) struct EstimatorArguments {
    /// Preset of the true robot; may be repeated. Without it all of them. The pose that the odometry of `ideal` reports
    /// has white noise of 20 mm and 10 mrad.
    #[arg(long = "robot", value_name = "PRESET", value_parser = PossibleValuesParser::new(ROBOTS.map(|(name, _)| name)))]
    pub robots: Vec<String>,
    /// What is driven; may be repeated.
    #[arg(long = "scenario", value_enum, value_name = "SCENARIO", default_value = "endless")]
    pub grounds: Vec<Ground>,
    /// Number of seeds; the first one is `--seed`.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub seeds: u64,
    /// Distance from start to goal [m], 10 to 9900.
    #[arg(long, value_name = "M", default_value_t = 60.0)]
    pub way: f64,
    /// End each drive after this driven time [s], 1 to 100000; without it at the goal.
    #[arg(long, value_name = "S")]
    pub duration: Option<f64>,
    /// Write a picture of error and NEES over time to this file.
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Replace the files that are written.
    #[arg(long)]
    pub force: bool,
    /// Write what the estimator got in each drive, and the truth, to a text file in this folder.
    #[arg(long, value_name = "FOLDER")]
    pub scans: Option<PathBuf>,
    /// Drive nothing: estimate the poses along such a file in surroundings that are not stated, and print for each scan x, y
    /// and yaw, how long it took [ns], and innovation, state and covariance of the filter.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["robots", "scans", "svg", "json"])]
    pub follow: Option<PathBuf>,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// The choice of system, and keys that are set under every condition.
    #[command(flatten)]
    pub choice: Choice,
}

/// Drives all conditions with all seeds and prints their figures.
///
/// # Errors
/// Bad options and settings, exit code 2; errors of the file system.
pub(crate) fn estimator(arguments: &EstimatorArguments) -> anyhow::Result<Exit> {
    require("way", arguments.way, 10.0, 9900.0)?;
    arguments.duration.map_or(Ok(()), |duration_s| require("duration", duration_s, 1.0, 1e5))?;
    if let Some(file) = &arguments.follow {
        let mut config = Condition::alone(arguments)?.system.tuning().estimator;
        (config.track.walls, config.track.surroundings) = (false, Surroundings::Open);
        answer!(false, "{}", scans::follow(file, &config)?)?;
        return Ok(Exit::Done);
    }
    let inputs: Vec<_> = arguments.choice.files().collect();
    let new_file = |path: &PathBuf| NewFile::create(path, Existing::forced(arguments.force), &inputs);
    let picture = arguments.svg.as_ref().map(new_file).transpose()?;
    let conditions = Condition::all(arguments);
    let first = arguments.choice.seed.unwrap_or(1);
    // What a run would refuse is refused before the first drive.
    conditions.iter().try_for_each(|condition| condition.plan(arguments, first).map(drop))?;
    let seeds = usize::try_from(arguments.seeds)?;
    let mut steps = Steps::new((conditions.len() * seeds) as u64, "drives");
    let drive = |index: usize| {
        let (condition, seed) = (&conditions[index / seeds], first.wrapping_add((index % seeds) as u64));
        let plan = condition.plan(arguments, seed)?;
        let name = format!("{}-{}-{}-{seed}.txt", condition.ground.name(), condition.robot, condition.laser);
        let scans = arguments.scans.as_ref().map(|folder| new_file(&folder.join(name)));
        drive::drive(&plan, scans.transpose()?)
    };
    let drives = on_all_cores(conditions.len() * seeds, drive, || steps.step(""))?;
    drop(steps);
    let drives = drives.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    let results = Results::of(&conditions, &drives, arguments);
    // The results of hours are printed, whatever becomes of the picture.
    let printed = answer!(arguments.json, "{}", text::text(&results))
        .and_then(|_| print_json(arguments.json, &results));
    if let Some(mut file) = picture {
        file.write_all(picture::draw(&results)?.as_bytes())?;
        file.finish()?;
    }
    printed?;
    Ok(Exit::Done)
}

/// Passes when the number of an option is within its range.
fn require(option: &str, value: f64, low: f64, high: f64) -> anyhow::Result<()> {
    // NaN is in no range.
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(Failure::bad_input(format!("--{}", Invalid::new(option, value, format!("{low} to {high}")))))
}
