//! What a process counts about its own samples.

use std::cell::Cell;

use shared_types::Heartbeat;

/// Counters of one process, shared by its inputs and outputs.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) activations: Cell<u64>,
    pub(crate) published: Cell<u64>,
    pub(crate) used: Cell<u64>,
    pub(crate) replaced: Cell<u64>,
    pub(crate) invalid: Cell<u64>,
    pub(crate) stale: Cell<u64>,
    pub(crate) duplicate: Cell<u64>,
    pub(crate) reordered: Cell<u64>,
    pub(crate) foreign: Cell<u64>,
    pub(crate) missing: Cell<u64>,
    pub(crate) undelivered: Cell<u64>,
    pub(crate) timeouts: Cell<u64>,
    pub(crate) last_scan: Cell<u64>,
}

/// Adds to one counter.
pub(crate) fn count(counter: &Cell<u64>, more: u64) {
    counter.set(counter.get() + more);
}

impl Counters {
    /// Copies all counters into a heartbeat.
    pub(crate) fn fill(&self, heartbeat: &mut Heartbeat) {
        heartbeat.activations = self.activations.get();
        heartbeat.published = self.published.get();
        heartbeat.used = self.used.get();
        heartbeat.replaced = self.replaced.get();
        heartbeat.invalid = self.invalid.get();
        heartbeat.stale = self.stale.get();
        heartbeat.duplicate = self.duplicate.get();
        heartbeat.reordered = self.reordered.get();
        heartbeat.foreign = self.foreign.get();
        heartbeat.missing = self.missing.get();
        heartbeat.undelivered = self.undelivered.get();
        heartbeat.timeouts = self.timeouts.get();
        heartbeat.header.scan_id = self.last_scan.get();
    }
}
