//! What is left of a run whose orchestrator died: its processes, opened and known to be its own.
//!
//! They are found by the roster of the run, and by their environment: between the start of a process and the moment
//! it is written down its orchestrator may die too. Finding them changes nothing, and neither does dropping them.

use runtime::{Domain, Identified, NotOurs, identify, processes_of};
use supervision::entry::ProcessRow;

use crate::process_registry::ProcessRegistry;

/// Processes without an orchestrator.
#[derive(Debug, Default)]
pub(crate) struct Survivors {
    /// What the run wrote down last.
    pub process_registry: ProcessRegistry,
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
        let mut found =
            Self { process_registry: ProcessRegistry::read(domain).unwrap_or_default(), ..Self::default() };
        for row in found.process_registry.process.clone() {
            match identify(&row.identity) {
                Ok(process) => found.listed.push((row, process)),
                Err(NotOurs::Ended(_)) => {}
                Err(stranger) => found.strangers.push(format!("{}: {stranger}", row.role)),
            }
        }
        let known = |pid: u32| found.listed.iter().any(|(_, process)| process.pid() == pid);
        let others = processes_of(domain.run_id()).into_iter();
        let others = others.filter(|seen| !known(seen.group) && seen.group != own_group());
        found.unlisted = others.filter_map(|seen| identify(&seen.identity).ok()).collect();
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
}

fn own_group() -> u32 {
    rustix::process::getpgrp().as_raw_nonzero().get().cast_unsigned()
}
