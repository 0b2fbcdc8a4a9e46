//! `status` of a system whose orchestrator died while its processes go on.

use std::time::Duration;

use audit::ledger::SampleAudit;
use runtime::{Bus, Domain, monotonic_ns};
use shared_types::{ProcessState, Role};
use supervision::child::usage_of;
use supervision::runs::LivingRun;
use supervision::supervisor::Event;

use crate::control::{ProcessStatus, Status};
use crate::process_registry::RunFile;
use crate::survivors::Survivors;
use crate::vitals::Vitals;

/// State of a system whose orchestrator died, in `status`.
pub const ORPHANED: &str = "driverless";
/// State of one that was stopped as well, and is about to end.
const STOPPED: &str = "stopped";

/// Heartbeats are listened to for this long: five of each process that lives [ns].
const RECEIVE_NS: u64 = 500_000_000;

/// The state of a system without an orchestrator; `None` when nothing of it lives.
pub fn status(domain: &Domain) -> Option<Status> {
    let survivors = Survivors::find(domain);
    if survivors.is_empty() {
        return None;
    }
    let cpu = |pid: u32| usage_of(pid).map_or(0.0, |usage| usage.cpu_s);
    let before: Vec<f64> = survivors.listed.iter().map(|(_, process)| cpu(process.pid())).collect();
    let began_ns = monotonic_ns();
    let received = listen(domain);
    let elapsed_s = (monotonic_ns() - began_ns) as f64 * 1e-9;
    let mut scan = 0;
    let rows = survivors.listed.iter().zip(before).map(|((row, process), before_s)| {
        let incarnation = row.identity.incarnation;
        let (state, rate_hz, last_sample_age_ms) = match &received {
            Some((vitals, states)) => {
                scan = scan.max(vitals.scan_of(incarnation));
                let (rate_hz, age_ms) = vitals.rate_and_age(incarnation);
                let ready = states.contains(&(incarnation, ProcessState::Ready));
                let received = states.iter().any(|(of, _)| *of == incarnation);
                (
                    if ready {
                        "ready"
                    } else if received {
                        "starting"
                    } else {
                        "hung"
                    },
                    rate_hz,
                    age_ms,
                )
            }
            None => ("ready", 0.0, 0.0),
        };
        let usage = usage_of(process.pid());
        ProcessStatus {
            role: row.role.clone(),
            implementation: row.entry.label(),
            pid: process.pid().cast_signed(),
            state: state.to_owned(),
            restarts: row
                .role
                .parse()
                .ok()
                .and_then(|role| survivors.process_registry.of(role))
                .map_or(0, |row| row.restarts),
            rate_hz,
            last_sample_age_ms,
            cpu_percent: 100.0 * (cpu(process.pid()) - before_s).max(0.0) / elapsed_s.max(1e-3),
            memory_kib: usage.map_or(0, |usage| usage.memory_kib),
            obeys_stop: received.as_ref().is_some_and(|(vitals, _)| vitals.obeys_stop(incarnation)),
            last_words: Vec::new(),
        }
    });
    let mut processes: Vec<_> = rows.collect();
    processes.sort_by_key(|process| process.role.parse::<Role>().map_or(usize::MAX, Role::index));
    Some(Status {
        system_id: domain.system_id().to_owned(),
        state: if is_stopped(domain) { STOPPED } else { ORPHANED }.to_owned(),
        scenario: RunFile::read(domain).map_or_else(|_| String::new(), |(_, plan)| plan.scenario.name),
        scan,
        // In lock-step nothing moves without an orchestrator.
        lockstep: false,
        processes,
        refused: Vec::new(),
    })
}

/// Whether the run was stopped, so that it can only end.
fn is_stopped(domain: &Domain) -> bool {
    LivingRun::of(domain.run_id()).and_then(|run| run.word).is_some_and(|word| !word.is_armed())
}

/// What processes say of themselves in half a second; `None` when the bus cannot be joined.
fn listen(domain: &Domain) -> Option<(Vitals, Vec<(u32, ProcessState)>)> {
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
