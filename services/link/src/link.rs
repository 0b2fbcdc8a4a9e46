//! What all threads of a link share: its table, the common clock, and what became of samples.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use runtime::{HUB, LinkTable, LinkedHost, link_version, monotonic_ns};

use crate::common_clock::CommonClock;
use crate::counters::Counters;
use crate::losses::Losses;

/// The state of a link.
pub(crate) struct Link {
    pub(crate) table: LinkTable,
    pub(crate) clock: CommonClock,
    pub(crate) counters: Counters,
    pub(crate) losses: Losses,
    running: AtomicBool,
    /// When the clock of the orchestrator was answered last [ns].
    answered_ns: AtomicU64,
}

impl Link {
    /// A running link of the host of the table.
    pub(crate) fn new(table: &LinkTable) -> Self {
        Self {
            table: table.clone(),
            clock: if table.here == HUB { CommonClock::Own } else { CommonClock::followed() },
            counters: Counters::default(),
            losses: Losses::default(),
            running: AtomicBool::new(true),
            answered_ns: AtomicU64::new(0),
        }
    }

    /// Whether its threads are to continue.
    pub(crate) fn is_running(&self) -> bool {
        self.running.load(Ordering::Relaxed)
    }

    /// Ends all threads. An error of one is an error of all: the link is started again.
    pub(crate) fn end(&self) {
        self.running.store(false, Ordering::Relaxed);
    }

    /// The clock of the orchestrator was answered.
    pub(crate) fn note_answer(&self, now_ns: u64) {
        self.answered_ns.store(now_ns, Ordering::Relaxed);
    }

    /// Time since the last answer of the orchestrator's clock [ms].
    pub(crate) fn silent_ms(&self) -> u64 {
        monotonic_ns().saturating_sub(self.answered_ns.load(Ordering::Relaxed)) / 1_000_000
    }

    /// This host as the orchestrator sees it.
    pub(crate) fn status(&self) -> LinkedHost {
        let offset = self.clock.offset(monotonic_ns());
        let known = self.clock.following();
        LinkedHost {
            name: self.table.here.clone(),
            version: link_version(),
            is_connected: true,
            is_locked: offset.is_some(),
            offset_ns: offset.map_or(0, |clock| clock.offset_ns),
            bound_ns: offset.map_or(0, |clock| clock.bound_ns),
            round_trip_ns: known.as_ref().and_then(|clock| clock.round_trip_ns()).unwrap_or(0),
            clocks_lost: known.as_ref().map_or(0, |clock| clock.lost()),
            counts: self.counters.get(),
            losses: self.losses.recent(monotonic_ns()),
        }
    }
}
