//! What is left of a run whose orchestrator died: its processes, opened and known to be its own.
//!
//! They are found by the roster of the run, and by their environment: between the start of a process and the moment
//! it is written down its orchestrator may die too. Finding them changes nothing, and neither does dropping them.

use std::time::Duration;

use runtime::{Domain, Identified, Identity, NotOurs, identify, monotonic_ns, processes_of};
use rustix::process::Signal;
use shared_types::Role;

use crate::lock::SystemLock;
use crate::roster::{ProcessRow, Roster};

/// From the last word of the actuator until the wheels rest: 2 m/s at 5 m/s^2, and something for a busy machine [ns].
const REST_NS: u64 = 600_000_000;
/// Time between two looks at processes that are to end.
const LOOK: Duration = Duration::from_millis(5);

/// Processes without an orchestrator.
#[derive(Debug, Default)]
pub(crate) struct Survivors {
    /// What the run wrote down last.
    pub roster: Roster,
    /// Processes that were written down and live.
    pub listed: Vec<(ProcessRow, Identified)>,
    /// Processes of the system that were not written down and belong to no group of one that was.
    pub unlisted: Vec<Identified>,
    /// Processes that were written down and are others now, each in words.
    pub strangers: Vec<String>,
}

impl Survivors {
    /// Looks for processes of a system. Only for the one who holds its lock, or just wants to know.
    pub(crate) fn find(domain: &Domain) -> Self {
        let mut found = Self { roster: Roster::read(domain).unwrap_or_default(), ..Self::default() };
        for row in found.roster.process.clone() {
            match identify(domain.system_id(), &row.identity) {
                Ok(process) => found.listed.push((row, process)),
                Err(NotOurs::Ended(_)) => {}
                Err(stranger) => found.strangers.push(format!("{}: {stranger}", row.role)),
            }
        }
        let known = |pid: u32| found.listed.iter().any(|(_, process)| process.pid() == pid);
        let others = processes_of(domain.system_id());
        let others = others.into_iter().filter(|(_, group)| !known(*group) && *group != own_group());
        found.unlisted = others.filter_map(|(other, _)| identify(domain.system_id(), &other).ok()).collect();
        found
    }

    /// Whether nothing is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.listed.is_empty() && self.unlisted.is_empty()
    }

    /// The roles that are filled, in words.
    pub(crate) fn words(&self) -> String {
        let words = self.listed.iter().map(|(row, process)| format!("{} {}", row.role, process.pid()));
        let others = self.unlisted.iter().map(|process| format!("unknown {}", process.pid()));
        words.chain(others).collect::<Vec<_>>().join(", ")
    }

    /// Ends them: the actuator first, whose last word blocks the wheels, the robot last and at rest.
    ///
    /// Needs neither the bus nor their answers, so it works for any program and any version.
    pub(crate) fn end(self, domain: &Domain) {
        let Self { listed, unlisted, .. } = self;
        let grace_ns = listed.iter().map(|(row, _)| row.entry.grace_ms).max().unwrap_or(1000) * 1_000_000;
        let mut waves: [Vec<Identified>; 3] = Default::default();
        for (row, process) in listed {
            let wave = match row.role.parse() {
                Ok(Role::Actuator) => 0,
                Ok(Role::Robot) => 2,
                _ => 1,
            };
            waves[wave].push(process);
        }
        waves[1].extend(unlisted);
        let [actuator, others, robot] = waves;
        let told_ns = monotonic_ns();
        end_all(domain, actuator, grace_ns);
        end_all(domain, others, grace_ns);
        while !robot.is_empty() && monotonic_ns() < told_ns + REST_NS {
            std::thread::sleep(LOOK);
        }
        end_all(domain, robot, grace_ns);
    }
}

/// Takes the lock of a system, ends what an earlier run left and removes its files.
///
/// # Errors
/// An orchestrator that lives, and errors of the file system.
pub(crate) fn clear(domain: &Domain) -> anyhow::Result<SystemLock> {
    let mut lock = SystemLock::take(domain)?;
    Survivors::find(domain).end(domain);
    lock.own();
    domain.remove_bus_files()?;
    Ok(lock)
}

/// TERM, grace, KILL; also for what they started.
fn end_all(domain: &Domain, mut processes: Vec<Identified>, grace_ns: u64) {
    let groups: Vec<u32> = processes.iter().map(Identified::pid).collect();
    processes.iter().for_each(|process| process.signal(Signal::TERM));
    wait(&mut processes, grace_ns);
    processes.iter().for_each(|process| process.signal(Signal::KILL));
    groups.into_iter().for_each(|group| signal_group(domain.system_id(), group, Signal::KILL));
    wait(&mut processes, 1_000_000_000);
}

fn wait(processes: &mut Vec<Identified>, longest_ns: u64) {
    let deadline_ns = monotonic_ns() + longest_ns;
    processes.retain(|process| !process.has_ended());
    while !processes.is_empty() && monotonic_ns() < deadline_ns {
        std::thread::sleep(LOOK);
        processes.retain(|process| !process.has_ended());
    }
}

/// Sends a signal to all processes of a system in the group that `leader` led, but not to `leader` itself.
///
/// The number of a group whose leader is not our child may be given to others, so each process is looked at.
pub(crate) fn signal_group(system_id: &str, leader: u32, signal: Signal) {
    let is_member = |(identity, group): &(Identity, u32)| *group == leader && identity.pid != leader;
    for (identity, _) in processes_of(system_id).iter().filter(|process| is_member(process)) {
        if let Ok(process) = identify(system_id, identity) {
            process.signal(signal);
        }
    }
}

fn own_group() -> u32 {
    rustix::process::getpgrp().as_raw_nonzero().get().cast_unsigned()
}
