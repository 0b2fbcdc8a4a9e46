//! A run that starts: its files, its bus, its processes, and the session that drives it.

use plan::Plan;
use runtime::{Bus, Domain, Shutdown, StopWord, latch_on_crash};
use shared_types::Directive;
use supervision::fleet::Fleet;
use supervision::lock::SystemLock;
use supervision::supervisor::Event;

use crate::process_registry::RunFile;
use crate::session::Session;
use crate::startup::{RunOptions, Startup};

/// A run with nothing behind it, which no process has joined yet. Logs go to `logs` below `manner.out`.
///
/// # Errors
/// Errors of the bus and of the file system.
pub fn start(
    domain: &Domain,
    plan: &Plan,
    manner: RunOptions,
    lock: SystemLock,
    shutdown: Shutdown,
) -> anyhow::Result<Session> {
    let word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
    latch_on_crash(&word);
    plan.write_settings(domain, manner.lockstep)?;
    let RunOptions { out, lockstep, duration_s, .. } = manner.clone();
    let Plan { scenario, system } = plan.clone();
    RunFile { out, lockstep, duration_s, system, scenario }.write(domain)?;
    let bus = Bus::create(domain)?;
    let logs = manner.out.join("logs");
    let fleet = Fleet::new(
        domain.clone(),
        lock,
        word.clone(),
        &plan.system.realtime,
        &plan.system.processes,
        logs,
        false,
    )?;
    let mut directive = Directive::default();
    directive.header.incarnation = 1;
    Session::new(
        domain,
        plan,
        manner,
        Startup { bus, word, fleet, shutdown, events: vec![Event::Start], directive, first_scan: 1 },
    )
}
