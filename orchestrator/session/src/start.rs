//! Starts a run: its files, its bus, and the session that drives it.

use agent::link::HubLink;
use console::exit::Failure;
use plan::{Plan, hosts};
use runtime::{Bus, Domain, Shutdown, StopWord, latch_on_crash};
use shared_types::Directive;
use supervision::fleet::Fleet;
use supervision::lock::SystemLock;
use supervision::supervisor::Event;

use crate::own_processes::OwnProcesses;
use crate::process_registry::RunFile;
use crate::session::Session;
use crate::startup::{RunOptions, Startup};

/// The session of a new run, without processes yet. Logs go to `logs` below `options.out`.
///
/// # Errors
/// Errors of the bus and of the file system.
pub fn start(
    domain: &Domain,
    plan: &Plan,
    options: &RunOptions,
    lock: SystemLock,
    shutdown: Shutdown,
) -> anyhow::Result<Session> {
    require_supported_hosts(domain, plan, options.lockstep)?;
    let stop_word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
    latch_on_crash(&stop_word);
    plan.write_settings(domain, options.lockstep)?;
    let RunOptions { out, lockstep, duration_s, .. } = options.clone();
    let Plan { scenario, system, .. } = plan.clone();
    RunFile { out, lockstep, duration_s, system, scenario }.write(domain)?;
    let bus = Bus::create(domain, plan.system.period_ns())?;
    let logs = options.out.join("logs");
    let fleet = Fleet::new(
        domain.clone(),
        lock,
        stop_word.clone(),
        &plan.system.realtime,
        &plan.system.roles().cloned().collect::<Vec<_>>(),
        logs,
        false,
    )?;
    let link = start_link(domain, plan, &fleet, options)?;
    let companions = OwnProcesses::new(&bus, domain, &stop_word, plan, options.lockstep, 1, &options.out)?;
    let mut directive = Directive::default();
    directive.header.incarnation = 1;
    let events = vec![Event::Start];
    let startup = Startup {
        bus,
        stop_word,
        fleet,
        companions,
        shutdown,
        events,
        directive,
        first_scan: 1,
        judged_by: None,
        link,
    };
    Session::new(domain, plan, options, startup)
}

/// Starts the link to the other hosts of a system, for the places of its roles in `fleet`.
///
/// # Errors
/// As [`HubLink::start`].
pub(crate) fn start_link(
    domain: &Domain,
    plan: &Plan,
    fleet: &Fleet,
    options: &RunOptions,
) -> anyhow::Result<Option<HubLink>> {
    // In lock-step nothing crosses, so that a host of which nothing is used changes nothing.
    if options.lockstep {
        return Ok(None);
    }
    HubLink::start(domain, &plan.system, &fleet.places().collect::<Vec<_>>(), &options.out.join("logs"))
}

/// Refuses what does not work across hosts, before anything is made.
fn require_supported_hosts(domain: &Domain, plan: &Plan, lockstep: bool) -> anyhow::Result<()> {
    hosts::require_short_ids(&plan.system, domain.system_id()).map_err(Failure::bad_input)?;
    match hosts::hosts(&plan.system).flatten().next() {
        Some(host) if lockstep => Err(Failure::bad_input(format!(
            "process.host = {host} is not allowed: with --lockstep all processes run on one host"
        ))),
        _ => Ok(()),
    }
}
