//! `scanloop run`: from the command line to the summary.

use std::path::{Path, PathBuf};

use console::exit::{Exit, Failure};
use console::new_file::require_apart;
use console::output::require_writable;
use faults::PERMIT_FILE;
use plan::{Plan, difference};
use runtime::{Domain, RuntimeError, Shutdown};
use shared_types::Role;
use supervision::lock::{Claim, clear};
use supervision::replaceable;
use supervision::runs::strays_of;

use crate::adopt;
use crate::arguments::{CommonArguments, RunArguments, check_duration, out_folder};
use crate::results::{claim, conclude};
use crate::start::start;
use crate::startup::RunOptions;
use crate::survivors::Survivors;
use crate::top_view::TopView;

/// The recording of a run that names no other file.
const RECORDING: &str = "recording.mcap";

/// Drives a scenario and writes its report.
///
/// # Errors
/// Bad input, a process that could not be kept running, and errors of the bus or the file system.
pub fn run(system_id: &str, arguments: &RunArguments) -> anyhow::Result<Exit> {
    let CommonArguments { out, force, duration, quiet } = &arguments.common;
    if arguments.top {
        TopView::require_terminal()?;
    }
    if arguments.adopt {
        return adopt::adopt(system_id, &arguments.common);
    }
    // Before anything is made: a run that a signal ends removes it again.
    let shutdown = Shutdown::of_orchestrator()?;
    let plan = Plan::read(arguments.scenario.as_deref(), &arguments.choice)?;
    check_duration(*duration)?;
    if Domain::take_stopped_mark(system_id)? && arguments.adopt_or_start {
        return Err(RuntimeError::Stopped(system_id.to_owned()).into());
    }
    for stray in strays_of(system_id) {
        let text = format!("warning: an earlier run has left {}: it is left alone", stray.description());
        runtime::print(runtime::Priority::Warning, &text);
    }
    if let Claim::Left(domain, lock) = Claim::take(system_id)? {
        let survivors = Survivors::find(&domain);
        if arguments.adopt_or_start && !survivors.is_empty() {
            return adopt::take_over(&domain, lock, shutdown, survivors, &arguments.common);
        }
        if !survivors.is_empty() {
            let processes = survivors.labels();
            runtime::print(
                runtime::Priority::Warning,
                &format!("an earlier run lost its orchestrator: blocking its wheels and ending {processes}"),
            );
        }
        clear(&domain, lock)?;
    }
    let out = out_folder(out.clone().unwrap_or_else(|| PathBuf::from("out").join(&plan.scenario.name)))?;
    let results = claim(&out, *force)?;
    let inputs: Vec<&Path> =
        arguments.choice.files().chain(arguments.scenario.as_deref().map(Path::new)).collect();
    results.require_apart(&inputs)?;
    let recording = match &arguments.record {
        Some(Some(file)) => {
            results.require_other(file)?;
            Some(new_file(file)?)
        }
        Some(None) => {
            require_apart(&out.join(RECORDING), &inputs)?;
            results.claim_growing(RECORDING)?;
            Some(out.join(RECORDING))
        }
        None => None,
    };
    let (domain, lock) = Claim::take_new(system_id)?;
    let _held = results.hold()?;
    if arguments.allow_inject {
        allow_inject(&plan, &domain)?;
    }
    let options = RunOptions { lockstep: arguments.lockstep, duration_s: *duration, quiet: *quiet, out };
    if shutdown.requested() {
        runtime::print(runtime::Priority::Warning, "interrupted before anything was started");
        return Ok(Exit::NotReached);
    }
    announce(&plan, *quiet);
    // Dropped after the run: the terminal is free again for its summary.
    let _view = arguments.top.then(|| TopView::start(system_id)).transpose()?;
    let mut session = start(&domain, &plan, &options, lock, shutdown)?;
    if let Some(file) = recording {
        // Only that of an earlier run is replaced.
        session.record_to(&file, &options.out.join("logs"), arguments.record == Some(None))?;
    } else if !options.lockstep && plan.system.recording.ring_s > 0.0 {
        session.keep_ring(&options.out, plan.system.recording.ring_s);
    }
    conclude(session, &plan, &results)
}

/// Lets the processes of a run take faults.
fn allow_inject(plan: &Plan, domain: &Domain) -> anyhow::Result<()> {
    let robot = plan.system.roles().find(|entry| entry.role() == Role::Robot);
    if robot.and_then(|entry| entry.implementation.as_deref()) != Some("emulator") {
        return Err(Failure::bad_input("--allow-inject needs the emulated robot"));
    }
    Ok(domain.folder().write(PERMIT_FILE, b"")?)
}

/// A file of `--record` that does not exist yet, as an absolute path.
fn new_file(file: &Path) -> anyhow::Result<PathBuf> {
    let refuse =
        |reason: &dyn std::fmt::Display| Failure::bad_input(format!("--record {}: {reason}", file.display()));
    if file.symlink_metadata().is_ok() {
        return Err(refuse(&"the file exists; name another one"));
    }
    let path = std::path::absolute(file).map_err(|error| refuse(&error))?;
    // It stands in the report.
    if path.to_str().is_none() {
        return Err(refuse(&"the path of the file is not UTF-8; name another one"));
    }
    if let Some(Err(reason)) = path.parent().map(require_writable) {
        return Err(refuse(&reason));
    }
    Ok(path)
}

/// Prints what a user should know before the drive: warnings always; unless `quiet`, differences to the description, and
/// whether the surroundings limit the speed.
fn announce(plan: &Plan, quiet: bool) {
    let warn = |text: &str| runtime::print(runtime::Priority::Warning, &format!("warning: {text}"));
    plan.warnings.iter().for_each(|warning| warn(warning));
    let commands = plan.system.processes.iter().filter_map(|entry| entry.command.as_deref());
    commands.filter_map(replaceable::command).for_each(|reason| warn(&reason));
    if !quiet {
        let lines = difference::summary(&plan.differences_of_truth()).into_iter().chain(plan.careful());
        lines.for_each(|line| runtime::print(runtime::Priority::Notice, &line));
    }
}
