//! What the ports of one process share.

use std::cell::{Cell, RefCell};

use shared_types::{Device, Directive, Header, JournalKind, KnownScan, Role, StageStamps, Topic, YOUNG_NS};

use crate::Clock;
use crate::counters::Counters;
use crate::guard::Guard;
use crate::journal::Notes;
use crate::tamper::Tamper;

/// Inputs older than this many scan periods are dropped when they arrive, unless they are younger than [`YOUNG_NS`].
const MAX_AGE_PERIODS: u64 = 3;

/// What ports of one process share.
pub(crate) struct Shared {
    pub(crate) role: Role,
    pub(crate) incarnation: u32,
    pub(crate) clock: Clock,
    pub(crate) counters: Counters,
    pub(crate) stamps: Cell<StageStamps>,
    pub(crate) directive: RefCell<Directive>,
    pub(crate) guard: Guard,
    /// For the journal.
    pub(crate) notes: Notes,
    /// Fault injection, where the run allows it.
    pub(crate) tamper: RefCell<Option<Box<dyn Tamper>>>,
    /// What the devices behind this process do, for the heartbeat.
    pub(crate) device: RefCell<Device>,
    /// Scan period [ns].
    pub(crate) period_ns: u64,
    pub(crate) produced: Cell<bool>,
    /// An output was published since the last sleep.
    pub(crate) worked: Cell<bool>,
    /// When the next input that the role answers is expected [ns].
    pub(crate) expected_ns: Cell<u64>,
    /// When the front beam of the last input that the role answers was taken [ns].
    pub(crate) acquired_ns: Cell<u64>,
    /// The newest scan that this process knows to exist: of what it has accepted, and of what a robot has published.
    pub(crate) known_scan: Cell<KnownScan>,
    /// How long the last two answers took, from their inputs to their publication; 0 before the first [ns].
    pub(crate) answered_in_ns: Cell<[u64; 2]>,
}

impl Shared {
    /// Whether the outputs of this process count, now or from an announced scan on.
    pub(crate) fn is_in_charge(&self) -> bool {
        self.directive.borrow().authority[self.role.index()].incarnation == self.incarnation
    }

    /// Notes that the process has begun to use a sample.
    pub(crate) fn taken(&self, topic: Topic, header: &Header) {
        self.clock.advance_to(header.scan_published_ns());
        let now = self.clock.now_ns();
        // Directives are not periodic.
        if topic.writer().is_some() && self.role.answers().is_none_or(|answered| answered == topic) {
            self.expected_ns.set(now + self.interval_after(header.acquired_ns));
        }
        let woken_ns = if self.clock.is_simulated() { now } else { self.stamps.get().woken_ns };
        self.stamps.set(StageStamps { woken_ns, taken_ns: now, ..StageStamps::default() });
        self.counters.take(self.role, topic, header);
        if topic.writer().is_some() {
            self.notes.note_sample(JournalKind::Taken, topic, header);
        }
    }

    /// Notes that the scan of a sample exists.
    pub(crate) fn note_scan(&self, header: &Header) {
        self.known_scan.set(self.known_scan.get().and(header, self.clock.now_ns()));
    }

    /// Time from an input to the next [ns]: as long as the last one when scans are regular, else the scan period.
    fn interval_after(&self, acquired_ns: u64) -> u64 {
        let interval_ns = acquired_ns.saturating_sub(self.acquired_ns.replace(acquired_ns));
        let is_regular = interval_ns.abs_diff(self.period_ns) < self.period_ns / 8;
        if is_regular { interval_ns } else { self.period_ns }
    }

    /// Notes that the process publishes its answer, and returns the time.
    pub(crate) fn answered(&self) -> u64 {
        let now = self.clock.now_ns();
        let taken_ns = self.stamps.get().taken_ns;
        if taken_ns > 0 {
            let (answer_ns, [_, last_ns]) = (now.saturating_sub(taken_ns), self.answered_in_ns.get());
            self.answered_in_ns.set([if last_ns == 0 { answer_ns } else { last_ns }, answer_ns]);
        }
        self.produced.set(true);
        self.worked.set(true);
        now
    }

    /// Age above which arriving inputs are dropped [ns].
    pub(crate) fn max_age_ns(&self) -> u64 {
        (MAX_AGE_PERIODS * self.period_ns).max(YOUNG_NS)
    }

    /// Whether so many scans can be answered before the newest is too old. The quicker of the last two answers counts,
    /// because a process that was suspended during one answer is not slow.
    pub(crate) fn catches_up(&self, scans: u64) -> bool {
        let [before_ns, last_ns] = self.answered_in_ns.get();
        let answer_ns = before_ns.min(last_ns);
        answer_ns < self.period_ns && MAX_AGE_PERIODS * scans * answer_ns < self.max_age_ns()
    }

    /// Whether a scan is still young enough after the time that the slower of the last two answers took.
    pub(crate) fn can_answer(&self, header: &Header) -> bool {
        let [before_ns, last_ns] = self.answered_in_ns.get();
        let age_ns = self.clock.now_ns().saturating_sub(header.acquired_ns);
        age_ns + before_ns.max(last_ns) < self.max_age_ns()
    }
}
