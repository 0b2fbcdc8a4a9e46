//! Counters of all samples at this link; several threads add to them.

use std::sync::atomic::{AtomicU64, Ordering};

use runtime::LinkCounts;

/// [`LinkCounts`] that are still counted.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) sent: Count,
    pub(crate) replaced: Count,
    pub(crate) held: Count,
    pub(crate) received: Count,
    pub(crate) repeated: Count,
    pub(crate) missing: Count,
    pub(crate) old: Count,
    pub(crate) clock: Count,
    pub(crate) damaged: Count,
}

/// One counter.
#[derive(Debug, Default)]
pub(crate) struct Count(AtomicU64);

impl Count {
    pub(crate) fn add(&self, count: u64) {
        self.0.fetch_add(count, Ordering::Relaxed);
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Counters {
    /// The counts so far.
    pub(crate) fn get(&self) -> LinkCounts {
        LinkCounts {
            sent: self.sent.get(),
            replaced: self.replaced.get(),
            held: self.held.get(),
            received: self.received.get(),
            repeated: self.repeated.get(),
            missing: self.missing.get(),
            old: self.old.get(),
            clock: self.clock.get(),
            damaged: self.damaged.get(),
        }
    }
}
