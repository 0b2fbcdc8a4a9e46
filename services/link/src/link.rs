//! What all threads of a link share: its table, the common clock, and what became of samples.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::thread::JoinHandle;

use runtime::{HUB, LinkTable, LinkedHost, link_version, monotonic_ns};

use crate::common_clock::CommonClock;
use crate::counters::Counters;
use crate::losses::Losses;

/// Processes of other hosts whose samples are remembered as not ours: all that live at a time, and some before.
const FOREIGN: usize = 64;

/// Time without an answer after which something is wrong, if there is a connection [ms].
const LOST_MS: u64 = 2_500;

/// The state of a link.
pub(crate) struct Link {
    pub(crate) table: LinkTable,
    pub(crate) clock: CommonClock,
    pub(crate) counters: Counters,
    pub(crate) losses: Losses,
    running: AtomicBool,
    /// When this link was started, or the clock of the orchestrator was answered last [ns].
    answered_ns: AtomicU64,
    /// For how long this host stood still [ms].
    stood_still_ms: AtomicU64,
    /// Number of the newest directive that was published here.
    directive: AtomicU64,
    /// Incarnations whose samples came from other hosts, in the order of their first samples.
    foreign: [AtomicU32; FOREIGN],
    foreign_count: AtomicU64,
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
            answered_ns: AtomicU64::new(monotonic_ns()),
            stood_still_ms: AtomicU64::new(0),
            directive: AtomicU64::new(0),
            foreign: std::array::from_fn(|_| AtomicU32::new(0)),
            foreign_count: AtomicU64::new(0),
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

    /// Runs a thread whose error ends the link.
    pub(crate) fn spawn(
        self: &Arc<Self>,
        work: impl FnOnce() -> anyhow::Result<()> + Send + 'static,
    ) -> JoinHandle<()> {
        let link = Arc::clone(self);
        std::thread::spawn(move || {
            if let Err(error) = work() {
                runtime::print(runtime::Priority::Error, &format!("error: scanloop-link: {error:#}"));
                link.end();
            }
        })
    }

    /// This host stood still for so long until now.
    pub(crate) fn note_standstill(&self, lost_ms: u64) {
        self.stood_still_ms.store(lost_ms, Ordering::Relaxed);
    }

    /// For how long this host stood still [ms].
    pub(crate) fn stood_still_ms(&self) -> u64 {
        self.stood_still_ms.load(Ordering::Relaxed)
    }

    /// A directive of that number was published here.
    pub(crate) fn note_directive(&self, sequence: u64) {
        self.directive.store(sequence, Ordering::Relaxed);
    }

    /// A sample of a process on another host is about to be published here.
    pub(crate) fn note_foreign(&self, incarnation: u32) {
        if !self.is_foreign(incarnation) {
            let index = self.foreign_count.fetch_add(1, Ordering::Relaxed) as usize % FOREIGN;
            self.foreign[index].store(incarnation, Ordering::Relaxed);
        }
    }

    /// Whether samples of a process come from another host, so that they are not sent from here: a topic crosses both
    /// ways while its writer moves.
    pub(crate) fn is_foreign(&self, incarnation: u32) -> bool {
        self.foreign.iter().any(|of| of.load(Ordering::Relaxed) == incarnation)
    }

    /// The clock of the orchestrator was answered.
    pub(crate) fn note_answer(&self, now_ns: u64) {
        self.answered_ns.store(now_ns, Ordering::Relaxed);
    }

    /// Whether the orchestrator does not answer for too long. Where it is connected all the same the link ends and is
    /// started anew: what this end listens to is told once only, in datagrams that may be lost.
    pub(crate) fn is_unanswered(&self) -> bool {
        self.silent_ms() > LOST_MS
    }

    /// Time since the last answer of the orchestrator's clock, or since the start [ms].
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
            refused: String::new(),
            is_locked: offset.is_some(),
            offset_ns: offset.map_or(0, |clock| clock.offset_ns),
            bound_ns: offset.map_or(0, |clock| clock.bound_ns),
            round_trip_ns: known.as_ref().and_then(|known| known.clock.round_trip_ns()).unwrap_or(0),
            clocks_lost: known.as_ref().map_or(0, |known| known.clock.lost()),
            stood_still_ms: self.stood_still_ms(),
            directive: self.directive.load(Ordering::Relaxed),
            counts: self.counters.get(),
            losses: self.losses.recent(monotonic_ns()),
        }
    }
}
