//! `scanloop bench latency`: where the time from scan to actuation goes, and the noise of the machine.
//!
//! One run: start the five processes, inspect the machine, measure its own wake-ups, drive (or answer at once), record
//! every scan, print the result. The processes are those of `run`, on the same bus, under the same supervisor, recorded
//! in the same way. The figures hold for this machine and this day only; to compare two builds use `bench compare`.

pub mod arguments;
mod collector;
pub mod echo;
mod files;
pub mod intervals;
pub(crate) mod machine;
pub(crate) mod noise;
mod pictures;
mod results;
mod text;
mod trace;

use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;

use figures::PROFILE;
use figures::difference::smallest_visible;
use runtime::Shutdown;

pub use self::arguments::{Compute, LatencyArguments};
use console::exit::{Exit, Failure};
use console::out_folder::OutFolder;
use console::{answer, note};
use plan::Choice;
use plan::Plan;
use report::{Outcome, Report};
use session::arguments::out_folder;
use session::start::start;
use session::startup::RunOptions;
use supervision::lock::Claim;
use supervision::realtime;

use self::collector::Collector;
use self::machine::{Machine, Ticks};
use self::results::{LatencyResults, SCHEMA, Smallest};
use super::scheduling::Scheduling;
use super::warn_of_profile;
use crate::laboratory::{self, Load};
use crate::print_json;

/// The scenario: 10 km, nearly three hours.
const SCENARIO: &str = "endless";

/// Runs the bench.
///
/// # Errors
/// Bad arguments, scheduling that the kernel refuses, and what `run` fails with.
pub(crate) fn latency(system_id: &str, arguments: &LatencyArguments) -> anyhow::Result<Exit> {
    arguments.check()?;
    let files = |out: &PathBuf| OutFolder::claim(out, &files::NAMES, arguments.force);
    let files = arguments.out.as_ref().map(files).transpose()?;
    let plan = plan(arguments, &Scheduling::read(&arguments.scheduling)?)?;
    warn_of_profile();
    let load = if arguments.load { Some(Load::start()?) } else { None };
    let (domain, lock) = Claim::take_new(system_id)?;
    // Without --out logs live as long as the system.
    let logs = match &arguments.out {
        Some(out) => out_folder(out.clone())?,
        None => domain.directory().to_owned(),
    };
    let shutdown = Shutdown::of_orchestrator()?;
    let options = RunOptions {
        lockstep: false,
        duration_s: Some(arguments.duration),
        quiet: arguments.quiet,
        out: logs,
    };
    // Before the processes run: meanwhile none of them would receive a directive.
    let stamps_us_per_stage = noise::stamp_cost_us();
    let (noise, granted) =
        noise::measure(plan.system.period_ns(), arguments.duration, &plan.system.realtime)?;
    let mut session = start(&domain, &plan, &options, lock, shutdown)?;
    let mut machine = Machine::inspect(&granted, load.as_ref().map_or(0, Load::count));

    let expected_scans = (arguments.rate * arguments.duration) as u64;
    let collector = Rc::new(RefCell::new(Collector::new(plan.system.period_ns(), expected_scans)));
    let shared = Rc::clone(&collector);
    session.observe_scans(Box::new(move |scan| shared.borrow_mut().scan(&scan.header, &scan.actuations)));
    let before = Ticks::now();
    let result = session.drive()?;
    machine.note_use(before, Ticks::now());
    let report = session.finish().0.report(&result);
    drop(load);

    let mut collector = collector.borrow_mut();
    let interval_scans = collector.interval_scans();
    let intervals = collector.take_lines();
    let results = LatencyResults {
        payload_bytes: arguments.payload,
        compute: arguments.compute.name(),
        rate_hz: arguments.rate,
        scan_to_actuation_corrected_us: collector.corrected.figures(),
        robot_lateness_us: collector.lateness.figures(),
        complete_chains: collector.complete,
        wake_up_noise_us: noise.figures(),
        stamps_us_per_stage,
        smallest_visible_us: smallest(&intervals),
        profile: PROFILE,
        machine,
        interval_scans,
        intervals,
        ..of_report(&report)
    };
    answer!(arguments.json, "{}", text::text(&results))?;
    if let Some(files) = &files {
        files::write(files, &results, &collector, &noise)?;
        answer!(arguments.json, "{:<18} {}", "files", files.folder().display())?;
    }
    print_json(arguments.json, &results)?;
    Ok(exit(&report))
}

/// The exit code: a drive that ended early, or unexplained samples, make no valid measurement.
fn exit(report: &Report) -> Exit {
    if report.outcome != Outcome::Timeout {
        note!("the drive ended early: {}: {}", report.outcome, report.reason);
    }
    let (samples, scans) = (report.ledger.residual, report.scans.unaccounted);
    if samples + scans > 0 {
        note!("{samples} samples and {scans} scans are unaccounted for");
    }
    match (report.outcome, report.outcome.exit_code()) {
        (Outcome::Timeout, _) if samples + scans == 0 => Exit::Done,
        (_, 3) => Exit::Collision,
        (_, 4) => Exit::ProcessFailed,
        _ => Exit::NotReached,
    }
}

/// The system to be measured, with the scheduling of the arguments: that of `run`, or stages that compute nothing.
fn plan(arguments: &LatencyArguments, scheduling: &Scheduling) -> anyhow::Result<Plan> {
    let mut choice: Choice = arguments.choice.clone();
    choice.overrides.push(format!("rate_hz={}", arguments.rate));
    let mut plan = Plan::read(Some(SCENARIO), &choice)?;
    scheduling.apply(&mut plan.system.realtime);
    realtime::validate(&plan.system.realtime)
        .map_err(|invalid| Failure::bad_input(format!("realtime.{invalid}")))?;
    if arguments.compute == Compute::Real {
        return Ok(plan);
    }
    let program = laboratory::find_current()?.to_string_lossy().into_owned();
    for entry in plan.system.processes.iter_mut().filter(|entry| !entry.is_companion()) {
        entry.implementation = None;
        entry.command =
            Some([vec![program.clone()], echo::arguments(entry.role(), arguments.payload).to_vec()].concat());
    }
    Ok(plan)
}

/// The results that come from the report of the run.
fn of_report(report: &Report) -> LatencyResults {
    let latency = &report.latency_us;
    LatencyResults {
        schema: SCHEMA,
        duration_s: report.duration_s,
        outcome: report.outcome.to_string(),
        reason: report.reason.clone(),
        scans: report.scans.clone(),
        residual: report.ledger.residual,
        faults: report.ledger.faults.iter().map(ToString::to_string).collect(),
        scan_to_actuation_us: latency.scan_to_actuation,
        data_age_us: latency.data_age,
        transport_us: latency.stages.transport,
        stages_us: latency.stages.compute.clone(),
        hops_us: latency.hops.clone(),
        publications_us: latency.publications.clone(),
        ..LatencyResults::default()
    }
}

/// The smallest visible differences, with transport as the series that hardly depends on the place of the drive.
fn smallest(lines: &[String]) -> Smallest {
    let read = |series| intervals::read(lines, series).unwrap_or_default();
    let (reaction, transport) = (read("scan_to_actuation"), read("transport"));
    let us = |quantile| smallest_visible(&reaction, &transport, quantile).map(|time_ns| time_ns * 1e-3);
    Smallest { p50: us(0.5), p99: us(0.99) }
}

/// A scan published at `start` whose stages were woken, took, computed and published at these times after it [ns].
#[cfg(test)]
fn chain(scan_id: u64, start: u64) -> shared_types::Header {
    use shared_types::{Header, Role, StageStamps};
    let mut header = Header { scan_id, acquired_ns: start - 1000, ..Header::default() };
    header.stage_mut(Role::Robot).published_ns = start;
    let stamps = [
        (Role::Estimator, [20, 30, 130, 135]),
        (Role::Obstacles, [25, 160, 460, 470]),
        (Role::Controller, [480, 490, 2490, 2500]),
        (Role::Actuator, [2520, 2530, 2545, 2550]),
    ];
    for (role, times) in stamps {
        let [woken_ns, taken_ns, computed_ns, published_ns] = times.map(|time| start + time);
        *header.stage_mut(role) = StageStamps { woken_ns, taken_ns, computed_ns, published_ns };
    }
    header
}
