//! Starts a run: its files, its bus, and the session that drives it.

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
    if let Some(host) = hosts::hosts(&plan.system).flatten().next() {
        let message = format!("process.host = {host} is not allowed: `run` does not start processes on other hosts yet");
        return Err(Failure::bad_input(message));
    }
    let stop_word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
    latch_on_crash(&stop_word);
    plan.write_settings(domain, options.lockstep)?;
    let RunOptions { out, lockstep, duration_s, .. } = options.clone();
    let Plan { scenario, system, .. } = plan.clone();
    RunFile { out, lockstep, duration_s, system, scenario }.write(domain)?;
    let bus = Bus::create(domain)?;
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
    };
    Session::new(domain, plan, options, startup)
}
