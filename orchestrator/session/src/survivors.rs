//! The processes that are left of a run whose orchestrator died, opened and identified.
//!
//! They are found by the process registry of the run and by their environment, because an orchestrator may die between
//! the start of a process and its entry in the registry. Finding and dropping them does not affect them.

use runtime::{Domain, Identified, NotOurs, identify};
use supervision::entry::ProcessRow;
use supervision::runs::{LivingRun, RunProcess};

use crate::process_registry::ProcessRegistry;

/// Processes without an orchestrator.
#[derive(Debug, Default)]
pub(crate) struct Survivors {
    /// The newest registry of the run.
    pub registry: ProcessRegistry,
    /// Processes of the registry that live.
    pub listed: Vec<(ProcessRow, Identified)>,
    /// Processes of the system that are neither in the registry nor in the group of one that is.
    pub unlisted: Vec<Identified>,
    /// Descriptions of what processes of the system have started in groups of their own; the system does not live by it.
    pub strays: Vec<String>,
    /// Descriptions of unrelated processes that have the number of one in the registry.
    pub strangers: Vec<String>,
}

impl Survivors {
    /// Finds the processes of a system. To act on them, hold its lock.
    pub(crate) fn find(domain: &Domain) -> Self {
        let mut found =
            Self { registry: ProcessRegistry::read(domain).unwrap_or_default(), ..Self::default() };
        for row in found.registry.process.clone() {
            match identify(&row.identity) {
                Ok(process) => found.listed.push((row, process)),
                Err(NotOurs::Ended(_)) => {}
                Err(stranger) => found.strangers.push(format!("{}: {stranger}", row.role)),
            }
        }
        let known = |pid: u32| found.listed.iter().any(|(_, process)| process.pid() == pid);
        let Some(run) = LivingRun::seen(domain.run_id()) else { return found };
        let others =
            run.members().filter(|process| !known(process.group()) && process.group() != own_group());
        found.unlisted = others.filter_map(RunProcess::open).collect();
        found.strays = run.strays().map(RunProcess::description).collect();
        found
    }

    /// Whether no process is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.listed.is_empty() && self.unlisted.is_empty()
    }

    /// The processes, as `controller 812`.
    pub(crate) fn labels(&self) -> String {
        let listed = self.listed.iter().map(|(row, process)| format!("{} {}", row.role, process.pid()));
        let others = self.unlisted.iter().map(|process| format!("unknown {}", process.pid()));
        listed.chain(others).collect::<Vec<_>>().join(", ")
    }
}

fn own_group() -> u32 {
    rustix::process::getpgrp().as_raw_nonzero().get().cast_unsigned()
}
