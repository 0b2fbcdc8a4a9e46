//! `scanloop-lab ride`: how well scenarios and random courses are driven, compared with the optimum.
//!
//! Each course is driven through the pipeline in one process, in simulated time. [`report::ride`] measures the drive,
//! and `optimum` computes the best drive over the same course with what the robot saw. Courses are driven on all cores.

mod course;
mod problems;
mod results;
mod table;

use std::path::PathBuf;

use clap::Args;
use console::answer;
use console::exit::Exit;
use console::out_folder::OutFolder;
use console::progress::Steps;
use plan::Choice;

use self::results::{Results, Row};
use crate::cores::on_all_cores;
use crate::robot::RobotPreset;
use commands::print_json;

/// Arguments of `ride`.
#[derive(Debug, Args)]
pub(crate) struct RideArguments {
    /// Scenario files or names of shipped scenarios; without any, all shipped ones that lead to their goal.
    #[arg(value_name = "SCENARIO")]
    pub scenarios: Vec<String>,
    /// Drive this many random courses of `campaign` instead; those that can be passed count.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000), conflicts_with = "scenarios")]
    pub random: Option<u64>,
    /// Preset of the true robot.
    #[arg(long, value_enum, value_name = "PRESET", default_value = "ideal")]
    pub robot: RobotPreset,
    /// Folder for the problems of the optimum, one file per course (benches/peers/ride_optimum.py solves them).
    #[arg(long, value_name = "DIR", value_parser = console::output::folder())]
    pub problems: Option<PathBuf>,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// The choice of system; `--seed` is also the seed of the first random course (default 1).
    #[command(flatten)]
    pub choice: Choice,
}

/// Drives the courses and prints their figures; exit code 1 when an optimum is worse than its drive.
///
/// # Errors
/// Bad files and settings; exit code 2.
pub(crate) fn ride(arguments: &RideArguments) -> anyhow::Result<Exit> {
    let courses = course::all(arguments)?;
    let problems = |folder: &PathBuf| OutFolder::claim(folder, &[], arguments.force);
    let problems = arguments.problems.as_ref().map(problems).transpose()?;
    let mut steps = Steps::new(courses.len() as u64, "courses");
    let measured = on_all_cores(courses.len(), |index| courses[index].measure(), || steps.step(""))?;
    let (mut rows, mut optima): (Vec<Row>, Vec<_>) = (Vec::new(), Vec::new());
    for (course, measured) in courses.iter().zip(measured) {
        let (row, optimum) = measured?;
        optima.extend(optimum.map(|optimum| (row.name.clone(), optimum)));
        rows.push(Row { seed: course.seed(), ..row });
    }
    let results = Results::new(rows, arguments.random.is_some());
    // The results of hours are printed, whatever becomes of the files; and the other way round.
    let printed = answer!(arguments.json, "{}", table::text(&results))
        .and_then(|_| print_json(arguments.json, &results));
    if let Some(folder) = &problems {
        let write = |(name, optimum): &(String, _)| problems::write(folder, name, optimum);
        let saved: Vec<anyhow::Result<()>> = optima.iter().map(write).collect();
        saved.into_iter().collect::<anyhow::Result<()>>()?;
    }
    printed?;
    Ok(results.exit())
}
