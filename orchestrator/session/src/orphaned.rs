//! `status` of a system whose orchestrator can't tell it: it died while its processes drive on, or it is suspended.

use std::time::Duration;

use audit::ledger::SampleAudit;
use runtime::{Bus, Domain, RuntimeError, monotonic_ns};
use shared_types::ProcessState;
use supervision::child::{is_suspended, usage_of};
use supervision::lock::suspended_orchestrator;
use supervision::runs::LivingRun;
use supervision::supervisor::{Event, VisibleState};

use crate::control::{ProcessStatus, Reply, Request, SystemStatus, ask};
use crate::process_registry::RunFile;
use crate::survivors::Survivors;
use crate::vitals::Vitals;

/// State of a system whose orchestrator died, in `status`.
pub const ORPHANED: &str = "driverless";
/// State of such a system that was stopped and is about to end.
const STOPPED: &str = "stopped";
/// State of a system whose orchestrator is suspended by a signal or frozen with its control group.
pub const SUSPENDED: &str = "suspended";

/// Heartbeats are received for this long: five of each process that lives [ns].
const RECEIVE_NS: u64 = 500_000_000;

/// The state of a system, with or without an orchestrator.
///
/// # Errors
/// A system that is not running, and an orchestrator that does not answer.
pub fn current_status(domain: &Domain) -> anyhow::Result<SystemStatus> {
    if suspended_orchestrator(domain).is_some()
        && let Some(status) = status(domain, SUSPENDED)
    {
        return Ok(status);
    }
    match ask(domain, &Request::Status) {
        Ok(Reply::Status(status)) => Ok(*status),
        Ok(_) => anyhow::bail!("the orchestrator did not answer with a status"),
        Err(error) if matches!(error.downcast_ref(), Some(RuntimeError::NotRunning(_))) => {
            status(domain, if is_stopped(domain) { STOPPED } else { ORPHANED }).ok_or(error)
        }
        Err(error) => Err(error),
    }
}

/// The `state` of a system by what is seen of its processes; `None` when none of it lives.
fn status(domain: &Domain, state: &str) -> Option<SystemStatus> {
    let survivors = Survivors::find(domain);
    if survivors.is_empty() {
        return None;
    }
    let cpu = |pid: u32| usage_of(pid).map_or(0.0, |usage| usage.cpu_s);
    let before: Vec<f64> = survivors.listed.iter().map(|(_, process)| cpu(process.pid())).collect();
    let began_ns = monotonic_ns();
    // Processes that do not run are not waited for; beside an orchestrator that does not, they may.
    let is_frozen = survivors.listed.iter().all(|(_, process)| is_suspended(process.pid()));
    let received = if is_frozen { None } else { receive(domain) };
    let elapsed_s = (monotonic_ns() - began_ns) as f64 * 1e-9;
    let mut scan = 0;
    let word = LivingRun::of(domain.run_id()).and_then(|run| run.word);
    let silent = |role, state, pid| {
        let obeys_stop = word.as_ref().is_some_and(|word| word.obeyed_by(role) == pid);
        ProcessStatus { obeys_stop, ..ProcessStatus::new(role, state) }
    };
    let rows = survivors.listed.iter().zip(before).map(|((row, process), before_s)| {
        let incarnation = row.identity.incarnation;
        let known = match &received {
            Some((vitals, states)) => {
                scan = scan.max(vitals.scan_of(incarnation));
                let reached =
                    states.iter().filter(|(of, _)| *of == incarnation).map(|(_, state)| *state).max();
                let state = match reached {
                    Some(ProcessState::Ready) => VisibleState::Ready,
                    Some(_) => VisibleState::Starting,
                    None => VisibleState::Hung,
                };
                vitals.row(row.role, state, incarnation)
            }
            None if is_suspended(process.pid()) => silent(row.role, VisibleState::Hung, process.pid()),
            None => silent(row.role, VisibleState::Ready, process.pid()),
        };
        ProcessStatus {
            implementation: row.entry.label(),
            host: row.entry.host.clone(),
            pid: process.pid().cast_signed(),
            restarts: survivors.registry.of(row.role).map_or(0, |row| row.restarts),
            cpu_percent: 100.0 * (cpu(process.pid()) - before_s).max(0.0) / elapsed_s.max(1e-3),
            memory_kib: usage_of(process.pid()).map_or(0, |usage| usage.memory_kib),
            ..known
        }
    });
    let mut processes: Vec<_> = rows.collect();
    processes.sort_by_key(|process| process.role.index());
    Some(SystemStatus {
        companions: Vec::new(),
        system_id: domain.system_id().to_owned(),
        state: state.to_owned(),
        scenario: RunFile::read(domain).map_or_else(|_| String::new(), |(_, plan)| plan.scenario.name),
        scan,
        judged_by: survivors.registry.judged_by,
        // A run in lock-step does not move without an orchestrator.
        lockstep: false,
        wheels: None,
        driven_by: None,
        // No process records the drive, so neither the obstacle of a stop nor the scanner is known.
        blocking: None,
        hindered: None,
        scanner: None,
        processes,
        refused: Vec::new(),
        hosts: Vec::new(),
        events: Vec::new(),
    })
}

/// Whether the run was stopped, so that it can only end.
fn is_stopped(domain: &Domain) -> bool {
    LivingRun::of(domain.run_id()).and_then(|run| run.word).is_some_and(|word| !word.is_armed())
}

/// The heartbeats of half a second, and the states in them; `None` when the bus cannot be joined.
fn receive(domain: &Domain) -> Option<(Vitals, Vec<(u32, ProcessState)>)> {
    let bus = Bus::open(domain, "status").ok()?;
    let mut vitals = Vitals::new(&bus).ok()?;
    let mut states = Vec::new();
    let mut sample_audit = SampleAudit::midway();
    let deadline_ns = monotonic_ns() + RECEIVE_NS;
    while monotonic_ns() < deadline_ns {
        let received = vitals.poll(&[], &mut sample_audit, |event| {
            if let Event::StateReported { incarnation, state, .. } = event
                && !states.contains(&(incarnation, state))
            {
                states.push((incarnation, state));
            }
        });
        received.ok()?;
        std::thread::sleep(Duration::from_millis(10));
    }
    Some((vitals, states))
}
