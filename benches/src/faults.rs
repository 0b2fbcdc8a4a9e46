//! `scanloop-lab faults`: injects each fault in each phase of a drive, and judges what the loop made of it.
//!
//! Faults of samples and of the robot are driven in simulated time on all cores. Then those with processes that die,
//! hang or flood run one after the other with real processes, in systems of their own.

mod fitted;
mod live;
mod observed;
mod page;
mod system;

use std::path::PathBuf;

use clap::Args;
use clap::builder::TypedValueParser;
use console::answer;
use console::exit::{Exit, Failure};
use console::out_folder::OutFolder;
use console::progress::Steps;
use console::user_file::{self, TEXT_BYTES};
use fault_matrix::course::{settings as settings_of_course, settings_of, stage_settings};
use fault_matrix::{Cell, CellVerdict, PipedStage, Simulation};
use faults::{DrivePhase, Exceptions, InjectedFault};
use pipeline::PipelineSettings;
use plan::{Choice, Plan};
use serde::{Deserialize, Serialize};
use shared_types::did_you_mean;
use vehicle::Description;

use crate::cores::on_all_cores;
use commands::print_json;
use commands::replay::program;
use fitted::fitted;
use live::Live;
pub(crate) use system::product;

/// Arguments of `faults`.
#[derive(Debug, Args, Default)]
pub(crate) struct FaultsArguments {
    /// Only the cells with this in their name, as in `pose-late` or `*/swap`; `*` stands for any text.
    #[arg(long, value_name = "PATTERN")]
    pub(crate) only: Option<String>,
    /// So many cells, spread evenly over the chosen ones.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000).map(|count| count as usize))]
    pub(crate) sample: Option<usize>,
    /// Only cells that are driven in simulated time: those with real processes take most of an hour.
    #[arg(long)]
    pub(crate) simulated: bool,
    /// A program with a stage of your own in place of that of its role, in simulated time only: `controller=./mine --fast`;
    /// may be repeated for other roles. It calls `runtime::stage::main`.
    #[arg(long, value_name = "ROLE=COMMAND")]
    pub(crate) with: Vec<String>,
    /// System file of another vehicle, in simulated time only.
    #[arg(long, value_name = "FILE")]
    pub(crate) system: Option<PathBuf>,
    /// Courses whose lengths are larger by this factor, with `--system`.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "system")]
    pub(crate) scale: f64,
    /// What is expected otherwise of the cells of this vehicle: a table `[FAULT.PHASE]` for each, with its reason as `because`.
    #[arg(long, value_name = "FILE", requires = "system")]
    pub(crate) expect: Option<PathBuf>,
    /// Print the names of the cells to standard output, and drive none.
    #[arg(long)]
    pub(crate) list: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub(crate) json: bool,
    /// Folder for `faults.html` and `faults.json`.
    #[arg(long, value_name = "DIR", default_value = "out/faults", value_parser = console::output::folder())]
    pub(crate) out: PathBuf,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub(crate) force: bool,
}

/// The result of the command.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Matrix {
    cells: Vec<Cell>,
    passed: usize,
    failed: usize,
    /// Names of cells that can't run here, with the reason.
    skipped: Vec<String>,
}

/// The files of the results.
const DATA: &str = "faults.json";
const PAGE: &str = "faults.html";
/// So many cells that were skipped are printed.
const SHOWN: usize = 5;

/// What one cell gave: its result, or why it can't run here.
type Driven = Result<Cell, String>;

/// Runs the cells; exit code 1 when one fails.
///
/// # Errors
/// A pattern that no cell has, exit code 2; a system that can't be started; errors of the file system.
pub(crate) fn faults(arguments: &FaultsArguments) -> anyhow::Result<Exit> {
    let courses = DrivePhase::ALL.into_iter().map(|phase| course(phase, arguments));
    let courses = courses.collect::<anyhow::Result<Vec<_>>>()?;
    let all = expected(arguments, &courses[0].1.tuning.vehicle)?;
    let chosen = chosen(&all, arguments)?;
    if arguments.list {
        let names: String =
            chosen.iter().map(|(fault, phase)| format!("{}\n", name(&fault.name, *phase))).collect();
        console::output::data(&names)?;
        return Ok(Exit::Done);
    }
    let results = OutFolder::claim(&arguments.out, &[DATA, PAGE], arguments.force)?;
    let matrix = drive(&chosen, &courses, arguments)?;
    answer!(arguments.json, "{}", text(&matrix))?;
    results.write(DATA, serde_json::to_string_pretty(&matrix)?.as_bytes())?;
    let page = results.write(PAGE, page::html(&matrix.cells).as_bytes())?;
    answer!(arguments.json, "page            {}", page.display())?;
    print_json(arguments.json, &matrix)?;
    Ok(if matrix.failed == 0 { Exit::Done } else { Exit::NotReached })
}

/// The name of a cell.
fn name(fault: &str, phase: DrivePhase) -> String {
    format!("{fault}/{phase}")
}

/// The cells that were asked for, in the order of their names.
fn chosen<'a>(
    all: &'a [InjectedFault],
    arguments: &FaultsArguments,
) -> anyhow::Result<Vec<(&'a InjectedFault, DrivePhase)>> {
    let pattern = arguments.only.as_deref().unwrap_or("*");
    let cells = all.iter().flat_map(|fault| fault.phases().map(move |phase| (fault, phase)));
    let mut chosen: Vec<(&InjectedFault, DrivePhase)> =
        cells.filter(|(fault, phase)| matches(pattern, &name(&fault.name, *phase))).collect();
    let is_simulated = arguments.simulated || !arguments.with.is_empty() || arguments.system.is_some();
    chosen.retain(|(fault, _)| !(is_simulated && fault.is_live()));
    // A program of a stage has the settings of one course.
    chosen.retain(|(_, phase)| arguments.with.is_empty() || !phase.has_own_course());
    if chosen.is_empty() {
        let meant = did_you_mean(pattern, all.iter().map(|fault| fault.name.as_str()));
        return Err(Failure::bad_input(format!(
            "--only {pattern}: no cell has such a name.{meant} `scanloop faults --list` prints them"
        )));
    }
    if let Some(count) = arguments.sample.filter(|count| *count < chosen.len()) {
        let total = chosen.len();
        chosen = (0..count).map(|index| chosen[index * total / count]).collect();
    }
    Ok(chosen)
}

/// Whether a name has a pattern, in which `*` stands for any text. Without a `*`, a part of the name is enough.
fn matches(pattern: &str, name: &str) -> bool {
    if !pattern.contains('*') {
        return name.contains(pattern);
    }
    let mut parts = pattern.split('*');
    let Some(mut rest) = parts.next().and_then(|first| name.strip_prefix(first)) else { return false };
    let mut parts: Vec<&str> = parts.collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        let Some(place) = rest.find(part) else { return false };
        rest = &rest[place + part.len()..];
    }
    rest.ends_with(last)
}

/// Starts the programs of stages.
fn programs(with: &[String]) -> anyhow::Result<Vec<PipedStage>> {
    let product = match with.is_empty() {
        true => PathBuf::new(),
        false => system::product()?,
    };
    let start = |text: &String| {
        let (role, command) = program(text, &product)?;
        let settings = stage_settings(role).ok_or(format!("{text}: the robot is emulated"))?;
        PipedStage::start(&command, role, settings, settings_of_course().period_ns)
            .map_err(|reason| format!("{text}: {reason}"))
    };
    let started: Result<_, String> = with.iter().map(start).collect();
    started.map_err(|reason| Failure::bad_input(format!("--with {reason}")))
}

/// The course of a phase, with the chosen vehicle.
fn course(phase: DrivePhase, arguments: &FaultsArguments) -> anyhow::Result<(DrivePhase, PipelineSettings)> {
    let settings = settings_of(phase);
    let Some(system) = &arguments.system else { return Ok((phase, settings)) };
    let scale = arguments.scale;
    let scenario = settings
        .scenario
        .scaled(scale)
        .map_err(|error| Failure::bad_input(format!("--scale {scale}: {error}")))?;
    let choice = Choice { system: Some(system.clone()), ..Choice::default() };
    Ok((phase, Plan::of(&scenario, &choice)?.simulated()))
}

/// All faults, as they are for the chosen vehicle.
fn expected(arguments: &FaultsArguments, vehicle: &Description) -> anyhow::Result<Vec<InjectedFault>> {
    let mut all = faults::all()?;
    if arguments.system.is_some() {
        all.iter_mut().for_each(|fault| *fault = fitted(fault, vehicle, arguments.scale));
    }
    let Some(file) = &arguments.expect else { return Ok(all) };
    let text = user_file::read(file, TEXT_BYTES).map_err(|error| error.to_string());
    let applied = text.and_then(|text| Exceptions::parse(&text)?.applied(all));
    applied.map_err(|reason| Failure::bad_input(format!("{}: {reason}", file.display())))
}

fn drive(
    chosen: &[(&InjectedFault, DrivePhase)],
    courses: &[(DrivePhase, PipelineSettings)],
    arguments: &FaultsArguments,
) -> anyhow::Result<Matrix> {
    let (live, simulated): (Vec<_>, Vec<_>) = chosen.iter().copied().partition(|(fault, _)| fault.is_live());
    // Before the simulated cells, whose results an error would lose.
    if !live.is_empty() {
        system::product()?;
    }
    let mut steps = Steps::new(chosen.len() as u64, "cells");
    let mut driven = Vec::new();
    if !simulated.is_empty() {
        let simulation = Simulation::new(programs(&arguments.with)?, courses, arguments.scale)?;
        let cell = |index: usize| {
            let (fault, phase): (&InjectedFault, DrivePhase) = simulated[index];
            simulation.cell(fault, phase).ok_or_else(|| {
                format!("{}: not possible on this course with this robot", name(&fault.name, phase))
            })
        };
        driven = on_all_cores(simulated.len(), cell, || steps.step(""))?;
        if let Some((role, reason)) = simulation.failure() {
            return Err(Failure::process(format!("{role}: {reason}")));
        }
    }
    let mut systems = Live::default();
    for (fault, phase) in live {
        driven.push(systems.cell(fault, phase)?);
        steps.step(&name(&fault.name, phase));
    }
    Ok(summary(driven))
}

fn summary(driven: Vec<Driven>) -> Matrix {
    let mut matrix = Matrix::default();
    for cell in driven {
        match cell {
            Ok(cell) => matrix.cells.push(cell),
            Err(reason) => matrix.skipped.push(reason),
        }
    }
    matrix.cells.sort_by(|one, two| (&one.fault, one.phase).cmp(&(&two.fault, two.phase)));
    matrix.failed = matrix.cells.iter().filter(|cell| cell.verdict == CellVerdict::Fail).count();
    matrix.passed = matrix.cells.len() - matrix.failed;
    matrix
}

fn text(matrix: &Matrix) -> String {
    let Matrix { cells, passed, failed, skipped } = matrix;
    let live = cells.iter().filter(|cell| cell.live).count();
    let nearest = cells.iter().map(|cell| cell.min_clearance_m).fold(f64::INFINITY, f64::min);
    let mut text = format!(
        "cells           {}: {passed} passed, {failed} failed; {live} with real processes\n\
         clearance       smallest {nearest:.3} m\n",
        cells.len()
    );
    for cell in cells.iter().filter(|cell| cell.verdict == CellVerdict::Fail) {
        text += &format!("failed          {}: {}\n", name(&cell.fault, cell.phase), cell.reason);
    }
    skipped.iter().take(SHOWN).for_each(|reason| text += &format!("skipped         {reason}\n"));
    if let Some(more) = skipped.len().checked_sub(SHOWN).filter(|more| *more > 0) {
        text += &format!("                and {more} more ({DATA})\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_whole_names_with_stars_and_parts_without() {
        for (pattern, name, expected) in [
            ("*", "pose-late-50ms/start", true),
            ("pose-*/start", "pose-late-50ms/start", true),
            ("pose-*/start", "pose-late-50ms/swap", false),
            ("*-late-*", "pose-late-50ms/swap", true),
            ("late", "pose-late-50ms/swap", true),
            ("*late", "pose-late-50ms/swap", false),
            ("a*a", "a", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn there_are_at_least_five_hundred_cells_and_a_sample_is_spread_over_them() {
        let all = faults::all().unwrap();
        let arguments = FaultsArguments { sample: None, ..FaultsArguments::default() };
        assert!(chosen(&all, &arguments).unwrap().len() >= 500);
        let sample = chosen(&all, &FaultsArguments { sample: Some(60), ..arguments }).unwrap();
        assert_eq!(sample.len(), 60);
        assert!(DrivePhase::ALL.iter().all(|phase| sample.iter().any(|(_, of)| of == phase)));
        assert!(sample.iter().any(|(fault, _)| fault.is_live()));
        let none = FaultsArguments { only: Some("nothing".to_owned()), ..FaultsArguments::default() };
        assert!(chosen(&all, &none).unwrap_err().to_string().contains("--only nothing"));
    }
}
