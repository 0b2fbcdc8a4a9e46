//! `scanloop conformance`: whether a program, in whatever language, may fill a role.
//!
//! The program is started in a system of its own. The suite plays all other roles with the samples of a drive that
//! the pipeline makes in this process. Each requirement is a case with a test bench of its own, so it can be run alone
//! and no case affects the next. The loop relies on what is required; what is recommended makes it better, such as
//! lock-step and a state to resume from.
//!
//! Most of a case is waiting, so some are played at the same time.
//!
//! Where this fails: a case can show that a requirement is broken, never that it always holds. Cases in real time are
//! played again when they fail, because the machine may be busy; a program that breaks such a requirement only
//! sometimes can pass.

mod actuator;
mod answers;
mod case;
mod cases;
mod controller;
mod drive;
mod estimator;
mod intake;
mod lifecycle;
mod message;
mod obstacles;
mod person;
mod ports;
mod ranges;
mod report;
mod robot;
mod suite;
mod test_bench;
mod trouble;
mod vehicle;

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Context;
use clap::Args;
use shared_types::{Role, did_you_mean};

pub use case::{CaseOutcome, RequirementLevel};
pub use cases::list;
pub use report::{CaseReport, SuiteReport};

use console::answer;
use console::exit::{Exit, Failure};
use console::output::data;
use supervision::child::require_script;
use supervision::entry::IMPLEMENTATIONS;

use self::vehicle::SuiteVehicle;
use case::Case;
use cases::chosen;
use suite::Suite;
use trouble::{Trouble, Verdict};

/// Arguments of `conformance`.
#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("candidate"))]
pub struct ConformanceArguments {
    /// Role that the program fills: robot, estimator, obstacles, controller or actuator.
    #[arg(required_unless_present = "list")]
    pub role: Option<String>,
    /// Built-in implementation: emulator, player, ros2, ekf, ellipses, nmpc or actuation.
    #[arg(long, value_name = "IMPLEMENTATION", group = "candidate")]
    pub to: Option<String>,
    /// System file of another vehicle; a robot `player` or `ros2` gets its table of this name.
    #[arg(long, value_name = "FILE")]
    pub system: Option<PathBuf>,
    /// Courses whose lengths are larger by this factor, with `--system`.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, requires = "system")]
    pub scale: f64,
    /// Run only this case; may be repeated.
    #[arg(long, value_name = "NAME")]
    pub only: Vec<String>,
    /// Scans per second, 2 to 50.
    #[arg(long, value_name = "HZ", default_value_t = 10.0)]
    pub rate: f64,
    /// Number of cases that run at the same time, 1 to 16.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=16))]
    pub jobs: u8,
    /// Largest number of attempts for a case in real time, 1 to 3, because a busy machine can make a case fail.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
    pub tries: u8,
    /// Print the requirements of one role, or of all, as Markdown to standard output; no process is started.
    #[arg(long)]
    pub list: bool,
    /// Print the report as JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Program of your own that fills the role, with its arguments.
    #[arg(last = true, value_name = "COMMAND", group = "candidate")]
    pub command: Vec<OsString>,
}

/// Plays the suite of a role.
///
/// # Errors
/// Wrong usage, a program that could not be started, and errors of the bus.
pub fn conformance(arguments: &ConformanceArguments) -> anyhow::Result<Exit> {
    let role = arguments.role.as_deref().map(str::parse::<Role>).transpose().map_err(Failure::bad_input)?;
    if arguments.list {
        data(&list(role)?)?;
        return Ok(Exit::Done);
    }
    let role = role.context("a role")?;
    if !(2.0..=50.0).contains(&arguments.rate) {
        return Err(Failure::bad_input(format!("--rate {} is not allowed: 2 to 50 Hz", arguments.rate)));
    }
    let cases = chosen(role, &arguments.only)?;
    let (command, label) = candidate(role, arguments)?;
    let (vehicle, system) = SuiteVehicle::read(arguments.system.as_deref(), arguments.scale)?;
    let mut suite = Suite::new(role, command, (1e9 / arguments.rate).round() as u64, vehicle)?;
    if arguments.system.is_some() {
        suite.driver = arguments.to.as_deref().map_or(Ok(None), |name| system.driver_of(name))?;
    }
    let verdicts = play_all(&cases, &suite, arguments)?;
    let mut report = SuiteReport::new(role.name(), &label);
    for (case, verdict) in cases.iter().zip(verdicts) {
        answer!(arguments.json, "{}", report.add(&case.entry, verdict)?)?;
    }
    answer!(arguments.json, "{}", report.summary())?;
    if arguments.json {
        data(&serde_json::to_string_pretty(&report)?)?;
    }
    Ok(if report.is_met() { Exit::Done } else { Exit::NotReached })
}

/// Program and arguments of the candidate, and its name in reports.
fn candidate(role: Role, arguments: &ConformanceArguments) -> anyhow::Result<(Vec<OsString>, String)> {
    let Some(name) = &arguments.to else {
        let Some(program) = arguments.command.first() else {
            return Err(Failure::bad_input("expected `--to IMPLEMENTATION` or `-- COMMAND...`"));
        };
        require_script(Path::new(program)).map_err(Failure::bad_input)?;
        let label: Vec<_> = arguments.command.iter().map(|argument| argument.to_string_lossy()).collect();
        return Ok((arguments.command.clone(), label.join(" ")));
    };
    let of_role = IMPLEMENTATIONS.iter().filter(|(_, of)| *of == role);
    let known: Vec<&str> = of_role.map(|(name, _)| *name).collect();
    if !known.contains(&name.as_str()) {
        let allowed = known.join(", ");
        let meant = did_you_mean(name, known);
        return Err(Failure::bad_input(format!(
            "--to {name} is not allowed for role {role}: {allowed}.{meant}"
        )));
    }
    let this = std::env::current_exe().context("path of this executable")?;
    Ok((vec![this.into_os_string(), "service".into(), name.into()], name.clone()))
}

/// Plays all cases, some at a time; those that failed in real time again, alone.
///
/// When the suite itself cannot continue, no further case is started.
fn play_all(cases: &[Case], suite: &Suite, arguments: &ConformanceArguments) -> anyhow::Result<Vec<Verdict>> {
    let (jobs, tries) = (usize::from(arguments.jobs), u32::from(arguments.tries));
    let next = AtomicUsize::new(0);
    let played = std::thread::scope(|scope| -> std::io::Result<_> {
        let work = || {
            let mut mine = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(case) = cases.get(index) else { break mine };
                let verdict = case.play(suite);
                if matches!(verdict, Err(Trouble::Broken(_))) {
                    next.store(cases.len(), Ordering::Relaxed);
                }
                mine.push((index, verdict));
            }
        };
        let start = |_| std::thread::Builder::new().spawn_scoped(scope, work);
        let workers = (0..jobs.min(cases.len())).map(start).collect::<Result<Vec<_>, _>>();
        if workers.is_err() {
            next.store(cases.len(), Ordering::Relaxed);
        }
        let ended = workers?.into_iter().map(|worker| worker.join());
        Ok(ended.collect::<Result<Vec<_>, _>>().map(|each| each.into_iter().flatten().collect::<Vec<_>>()))
    })?;
    let mut played = played.map_err(|_| anyhow::anyhow!("a case panicked"))?;
    played.sort_by_key(|(index, _)| *index);
    let mut verdicts = Vec::new();
    for (index, verdict) in played {
        match play_again(&cases[index], suite, verdict, tries) {
            Err(Trouble::Broken(error)) => return Err(error),
            verdict => verdicts.push(verdict),
        }
    }
    Ok(verdicts)
}

/// Plays a case that failed or observed nothing again, as often as it may be tried.
fn play_again(case: &Case, suite: &Suite, mut verdict: Verdict, tries: u32) -> Verdict {
    for _ in 1..case.tries().min(tries) {
        if !matches!(verdict, Err(Trouble::Failed(_) | Trouble::NotObserved(_))) {
            break;
        }
        verdict = case.play(suite);
    }
    verdict
}
