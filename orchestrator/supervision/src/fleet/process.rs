//! One running process of a fleet, and what it uses of the machine.

use std::ffi::OsString;

use runtime::{Domain, Identity, monotonic_ns};

use crate::child::{Child, this_program};
use crate::entry::{ProcessEntry, ProcessRow};

/// A share of a processor is measured over at least this long, however often it is asked for [ns].
const LOAD_WINDOW_NS: u64 = 200_000_000;

/// A running process.
pub(super) struct Process {
    pub(super) entry: ProcessEntry,
    pub(super) child: Child,
    pub(super) incarnation: u32,
    spent: Spent,
}

/// Time on a processor at the last measurement, and the share of it that was found then.
#[derive(Debug, Clone, Copy, Default)]
struct Spent {
    at_ns: u64,
    cpu_s: f64,
    percent: f64,
}

/// What a process uses of processor and memory.
#[derive(Debug, Clone, Copy, Default)]
pub struct Load {
    /// Share of a processor [%].
    pub cpu_percent: f64,
    /// Memory in use [KiB].
    pub memory_kib: u64,
}

impl Process {
    /// A process that was started here or adopted; its load is measured from now on.
    pub(super) fn new(entry: ProcessEntry, incarnation: u32, child: Child) -> Self {
        let cpu_s = child.usage().map_or(0.0, |usage| usage.cpu_s);
        Self { entry, child, incarnation, spent: Spent { at_ns: monotonic_ns(), cpu_s, percent: 0.0 } }
    }

    /// Its row in the process registry, while it lives.
    pub(super) fn row(&self, domain: &Domain) -> Option<ProcessRow> {
        let identity = Identity::of(domain, self.child.pid(), self.incarnation)?;
        Some(ProcessRow { role: self.entry.role(), identity, entry: self.entry.clone() })
    }

    pub(super) fn has_ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)))
    }

    /// Processor share since the measurement before, and memory.
    pub(super) fn load(&mut self) -> Load {
        let Some(usage) = self.child.usage() else { return Load::default() };
        let at_ns = monotonic_ns();
        let elapsed_ns = at_ns.saturating_sub(self.spent.at_ns);
        if elapsed_ns >= LOAD_WINDOW_NS {
            let percent = 100.0 * (usage.cpu_s - self.spent.cpu_s).max(0.0) / (elapsed_ns as f64 * 1e-9);
            self.spent = Spent { at_ns, cpu_s: usage.cpu_s, percent };
        }
        Load { cpu_percent: self.spent.percent, memory_kib: usage.memory_kib }
    }
}

/// The command line that starts a process; for one on another host, the proxy that stands for it here.
pub(super) fn command_of(entry: &ProcessEntry) -> Vec<OsString> {
    if let (Some(host), Some(implementation)) = (&entry.host, &entry.implementation) {
        return vec![this_program().into_os_string(), "remote".into(), host.into(), implementation.into()];
    }
    match (&entry.command, &entry.implementation) {
        (Some(command), _) => command.iter().map(OsString::from).collect(),
        (None, implementation) => {
            let name = implementation.clone().unwrap_or_default();
            vec![this_program().into_os_string(), "service".into(), name.into()]
        }
    }
}
