//! What became of every scan: the ledger. For samples see [`SampleAudit`].
//!
//! Scans are numbered without gaps from the first on, so each number between the first and the newest seen is a
//! scan that was published. It is *commanded* when an actuation answered it, *late* too when that was published after
//! the next scan and more than a scan period after its own, else *lost* with a reason. A number without a scan and without an answer is *unaccounted*: the robot
//! skipped it, or the observer missed both. There must be none.
//!
//! Reasons are assigned by scan numbers, not by clocks. So they hold in lock-step too, where processes are restarted on
//! wall time. One misattribution is accepted: a scan without an answer when a process died counts as lost to that
//! death, even if it was lost for another reason.
//!
//! Only the newest [`WINDOW`] scans are stored one by one; older ones are only counted.

mod companions;
mod crossing;
mod fault;
mod refused;
mod rows;
mod sample_audit;
mod stream;
mod sweep;
mod topic;

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use shared_types::Role;

pub use self::companions::CompanionLedger;
pub use self::fault::{DeliveryFault, DeliveryFaultKind};
pub use self::refused::{NewRefusal, RefusedRow};
pub use self::rows::{DelayRow, LedgerReport, LedgerRow, ScanReport, StrangerRow};
pub use self::sample_audit::{AUDITED_TOPICS, SampleAudit};
pub use self::topic::{InputReport, TopicLedger};

/// After this long a sample that has not arrived is lost: four heartbeats, and four times the longest sleep of a
/// process [ns].
pub const TIMEOUT_NS: u64 = 400_000_000;

/// Reason of scans that needed a process that had died or hung.
pub const PROCESS_RESTARTED: &str = "process_restarted";
/// Reason of scans without a valid command although all processes were running.
pub const NO_COMMAND: &str = "no_command";
/// Reason of scans that the robot skipped because it was delayed.
pub const ROBOT_HELD_UP: &str = "robot_held_up";
/// Reason of scans that the orchestrator was too delayed to observe, with or without their answers.
pub const NOT_OBSERVED: &str = "not_observed";
/// Reason of scans in flight when the run ended.
pub const RUN_ENDED: &str = "run_ended";

/// Number of newest scans that are stored one by one: 8 s at 1 kHz, far longer than any answer takes.
pub const WINDOW: usize = 8192;

/// What became of every scan of one run.
#[derive(Debug, Clone, Default)]
pub struct Ledger {
    first: u64,
    period_ns: u64,
    newest: u64,
    newest_answered: u64,
    ended_at: Option<u64>,
    entries: BTreeMap<u64, Entry>,
    refusals: BTreeMap<u64, &'static str>,
    outages: Vec<Outage>,
    settled: ScanReport,
}

#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    published_ns: Option<u64>,
    answered_ns: Option<u64>,
    excuse: Option<&'static str>,
}

/// Unanswered scans from `from` up to `until` are lost for `reason`.
#[derive(Debug, Clone)]
struct Outage {
    role: Role,
    reason: String,
    from: u64,
    until: Option<u64>,
}

impl Ledger {
    /// A ledger that starts with the scan numbered `first`, of a scanner with this mean period; a whole run starts with 1.
    pub fn new(first: u64, period_ns: u64) -> Self {
        Self { first, period_ns, ..Self::default() }
    }

    /// Moves the start to the scan `first` and forgets earlier ones.
    pub fn begin_at(&mut self, first: u64) {
        self.first = first;
        self.entries = self.entries.split_off(&first);
        self.refusals = self.refusals.split_off(&first);
    }

    /// The first scan of the ledger.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// Notes that a scan was published at `published_ns`. A second call changes nothing.
    pub fn published(&mut self, scan_id: u64, published_ns: u64) {
        if let Some(entry) = self.entry(scan_id) {
            entry.published_ns.get_or_insert(published_ns);
        }
    }

    /// Notes the reason of scans in case they stay without an answer. It counts as soon as a later scan is published.
    pub fn excused(&mut self, scans: RangeInclusive<u64>, reason: &'static str) {
        // Of those to come, no more than fit.
        let last = (*scans.end()).min(self.newest.saturating_add(WINDOW as u64));
        for scan_id in (*scans.start()).max(self.oldest_stored())..=last {
            self.entries.entry(scan_id).or_default().excuse = Some(reason);
        }
    }

    /// Notes an actuation that answers a scan and was published at `answered_ns`. A second one is a duplicate.
    pub fn answered(&mut self, scan_id: u64, answered_ns: u64) {
        let Some(entry) = self.entry(scan_id) else { return };
        if entry.answered_ns.is_some() {
            self.settled.duplicates += 1;
        } else {
            entry.answered_ns = Some(answered_ns);
            self.newest_answered = self.newest_answered.max(scan_id);
        }
    }

    /// Notes why a sample of a scan was dropped or refused: the reason if the scan stays without an answer.
    pub fn refused(&mut self, scan_id: u64, reason: &'static str) {
        let newest = self.newest.saturating_add(WINDOW as u64);
        if (self.oldest_stored()..=newest).contains(&scan_id) {
            self.refusals.insert(scan_id, reason);
        }
        while self.refusals.len() > WINDOW {
            self.refusals.pop_first();
        }
    }

    /// Notes that the process of `role` is gone: scans in flight and those to come may be lost for `reason`.
    pub fn outage_began(&mut self, role: Role, reason: &str) {
        // A process that hung before it was killed answered no scan since the last answer.
        let from = self.newest_answered.saturating_add(1);
        self.outages.push(Outage { role, reason: reason.to_owned(), from, until: None });
    }

    /// Notes that `role` is filled again. It may still lack inputs for the first scan after that.
    pub fn outage_ended(&mut self, role: Role) {
        let until = self.newest.saturating_add(1);
        for outage in self.outages.iter_mut().filter(|outage| outage.role == role && outage.until.is_none()) {
            outage.until = Some(until);
        }
    }

    /// Notes that the end of the run was decided now: scans in flight or published later need no answer.
    pub fn run_ended(&mut self) {
        self.ended_at.get_or_insert(self.newest);
    }

    /// The counts as if the run had ended now, or when [`Ledger::run_ended`] was called.
    pub fn report(&self) -> ScanReport {
        let mut report = self.settled.clone();
        for (&scan_id, &entry) in self.entries.range(..=self.newest) {
            self.settle(scan_id, entry, &mut report);
        }
        report.published = if self.newest >= self.first.max(1) { self.newest - self.first + 1 } else { 0 };
        report.unaccounted = report.published.saturating_sub(report.commanded + report.lost);
        report
    }

    /// The entry of a scan, created when it is new; `None` for scans before the first or older than the window.
    fn entry(&mut self, scan_id: u64) -> Option<&mut Entry> {
        if scan_id < self.oldest_stored() {
            return None;
        }
        self.newest = self.newest.max(scan_id);
        self.entries.entry(scan_id).or_default();
        while self.entries.first_key_value().is_some_and(|(&oldest, _)| oldest < self.oldest_stored()) {
            self.settle_oldest();
        }
        self.entries.get_mut(&scan_id)
    }

    fn oldest_stored(&self) -> u64 {
        self.first.max(self.newest.saturating_sub(WINDOW as u64 - 1))
    }

    fn settle_oldest(&mut self) {
        let Some((&scan_id, &entry)) = self.entries.first_key_value() else { return };
        let mut settled = std::mem::take(&mut self.settled);
        self.settle(scan_id, entry, &mut settled);
        self.settled = settled;
        self.entries.remove(&scan_id);
        self.refusals = self.refusals.split_off(&scan_id);
        self.outages.retain(|outage| outage.until.is_none_or(|until| until > scan_id));
    }

    fn settle(&self, scan_id: u64, entry: Entry, report: &mut ScanReport) {
        let Some(answered_ns) = entry.answered_ns else {
            let reason = entry.excuse.map_or_else(|| self.reason(scan_id), ToOwned::to_owned);
            report.lost += 1;
            *report.lost_reasons.entry(reason).or_default() += 1;
            return;
        };
        report.commanded += 1;
        let published_ns = |scan_id: u64| self.entries.get(&scan_id).and_then(|entry| entry.published_ns);
        // Scans of an irregular scanner may follow each other faster than any answer comes.
        let due_ns = published_ns(scan_id).unwrap_or(0).saturating_add(self.period_ns);
        let next_ns = published_ns(scan_id.saturating_add(1));
        if next_ns.is_some_and(|next_ns| answered_ns > next_ns && answered_ns > due_ns) {
            report.late += 1;
        }
    }

    fn reason(&self, scan_id: u64) -> String {
        let covers =
            |outage: &&Outage| scan_id >= outage.from && outage.until.is_none_or(|until| scan_id <= until);
        if let Some(refusal) = self.refusals.get(&scan_id) {
            (*refusal).to_owned()
        } else if let Some(outage) = self.outages.iter().find(covers) {
            outage.reason.clone()
        } else if scan_id > self.newest_answered
            && scan_id.saturating_add(1) >= self.ended_at.unwrap_or(self.newest)
        {
            RUN_ENDED.to_owned()
        } else {
            NO_COMMAND.to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;

    /// A ledger of `count` scans published every 100 ms, each answered 5 ms later unless `lost` names it.
    fn ledger(count: u64, lost: &[u64]) -> Ledger {
        let mut ledger = Ledger::new(1, PERIOD_NS);
        for scan_id in 1..=count {
            ledger.published(scan_id, scan_id * PERIOD_NS);
            if !lost.contains(&scan_id) {
                ledger.answered(scan_id, scan_id * PERIOD_NS + 5_000_000);
            }
        }
        ledger
    }

    fn reasons(report: &ScanReport) -> Vec<(&str, u64)> {
        report.lost_reasons.iter().map(|(reason, count)| (reason.as_str(), *count)).collect()
    }

    #[test]
    fn an_answer_within_a_period_is_in_time_however_soon_the_next_scan_comes() {
        let mut ledger = Ledger::new(1, PERIOD_NS);
        for (scan_id, published_ns, answered_ns) in
            [(1, 0, 8), (2, 5, PERIOD_NS + 5), (3, 10, PERIOD_NS + 11), (4, 20, 21)]
        {
            ledger.published(scan_id, published_ns);
            ledger.answered(scan_id, answered_ns);
        }
        assert_eq!((ledger.report().commanded, ledger.report().late), (4, 1));
    }

    #[test]
    fn every_answered_scan_is_commanded() {
        let report = ledger(127, &[]).report();
        assert_eq!((report.published, report.commanded, report.late, report.lost), (127, 127, 0, 0));
        assert_eq!((report.unaccounted, report.duplicates), (0, 0));
    }

    #[test]
    fn a_scan_that_was_skipped_after_the_last_one_of_the_run_is_not_counted() {
        let mut ledger = ledger(3, &[]);
        ledger.excused(5..=5, ROBOT_HELD_UP);
        let report = ledger.report();
        assert_eq!((report.published, report.commanded, report.lost, report.unaccounted), (3, 3, 0, 0));
        ledger.published(6, 6 * PERIOD_NS);
        ledger.answered(6, 6 * PERIOD_NS);
        let report = ledger.report();
        assert_eq!((report.published, report.commanded, report.lost, report.unaccounted), (6, 4, 1, 1));
    }

    #[test]
    fn a_scan_answered_after_the_next_was_published_is_late_and_commanded() {
        let mut ledger = ledger(4, &[2]);
        ledger.answered(2, 3 * PERIOD_NS + 1);
        let report = ledger.report();
        assert_eq!((report.commanded, report.late, report.lost, report.unaccounted), (4, 1, 0, 0));
    }

    #[test]
    fn the_order_in_which_topics_are_read_does_not_matter() {
        let mut ledger = Ledger::new(1, PERIOD_NS);
        ledger.answered(2, 250_000_000);
        ledger.answered(1, 205_000_000);
        ledger.published(2, 200_000_000);
        ledger.published(1, 100_000_000);
        let report = ledger.report();
        assert_eq!((report.published, report.commanded, report.late), (2, 2, 1));
    }

    #[test]
    fn a_lost_scan_has_the_reason_that_is_known_of_it() {
        let mut ledger = ledger(3, &[2]);
        ledger.outage_began(Role::Controller, PROCESS_RESTARTED);
        for scan_id in 4..=6 {
            ledger.published(scan_id, scan_id * PERIOD_NS);
        }
        ledger.outage_ended(Role::Controller);
        for scan_id in 7..=9 {
            ledger.published(scan_id, scan_id * PERIOD_NS);
        }
        ledger.refused(8, "invalid_command");
        for scan_id in 10..=12 {
            ledger.published(scan_id, scan_id * PERIOD_NS);
            ledger.answered(scan_id, scan_id * PERIOD_NS + 1);
        }
        ledger.published(13, 13 * PERIOD_NS);
        let report = ledger.report();
        // The reason of 2 and 9 is not known; 3 was, so the outage covers 4 to 6 and one more.
        assert_eq!(
            reasons(&report),
            [("invalid_command", 1), (NO_COMMAND, 2), (PROCESS_RESTARTED, 4), (RUN_ENDED, 1)]
        );
        assert_eq!((report.published, report.commanded, report.lost, report.unaccounted), (13, 5, 8, 0));
    }

    #[test]
    fn scans_before_a_hung_process_was_ended_are_lost_to_it() {
        let mut ledger = ledger(8, &[6, 7, 8]);
        ledger.outage_began(Role::Controller, PROCESS_RESTARTED);
        ledger.outage_ended(Role::Controller);
        ledger.published(9, 9 * PERIOD_NS);
        ledger.answered(9, 9 * PERIOD_NS + 1);
        assert_eq!(reasons(&ledger.report()), [(PROCESS_RESTARTED, 3)]);
    }

    #[test]
    fn a_scan_with_an_excuse_is_lost_for_it_unless_it_was_answered() {
        let mut ledger = ledger(4, &[2, 3]);
        ledger.excused(2..=2, ROBOT_HELD_UP);
        ledger.excused(4..=4, NOT_OBSERVED);
        assert_eq!(reasons(&ledger.report()), [(NO_COMMAND, 1), (ROBOT_HELD_UP, 1)]);
    }

    #[test]
    fn scans_after_the_end_of_the_run_need_no_answer() {
        let mut ledger = ledger(10, &[10]);
        ledger.run_ended();
        ledger.published(11, 11 * PERIOD_NS);
        let report = ledger.report();
        assert_eq!(reasons(&report), [(RUN_ENDED, 2)]);
        assert_eq!((report.published, report.unaccounted), (11, 0));
    }

    #[test]
    fn a_number_without_scan_and_answer_is_unaccounted() {
        let mut ledger = ledger(5, &[]);
        ledger.published(8, 8 * PERIOD_NS);
        ledger.answered(8, 8 * PERIOD_NS + 1);
        let report = ledger.report();
        assert_eq!((report.published, report.commanded, report.lost, report.unaccounted), (8, 6, 0, 2));
        let mut ledger = Ledger::new(1, PERIOD_NS);
        ledger.answered(2, 1);
        assert_eq!(ledger.report().unaccounted, 1, "the first scan was missed");
    }

    #[test]
    fn a_second_answer_to_a_scan_is_a_duplicate_and_changes_nothing_else() {
        let mut ledger = ledger(5, &[]);
        ledger.answered(3, 9 * PERIOD_NS);
        let report = ledger.report();
        assert_eq!((report.commanded, report.late, report.duplicates, report.unaccounted), (5, 0, 1, 0));
    }

    #[test]
    fn old_scans_are_added_up_without_being_forgotten() {
        let count = 3 * WINDOW as u64;
        let ledger = ledger(count, &[2, 9000, count - 1]);
        assert_eq!(ledger.entries.len(), WINDOW);
        let report = ledger.report();
        assert_eq!(
            (report.published, report.commanded, report.lost, report.unaccounted),
            (count, count - 3, 3, 0)
        );
        assert_eq!(reasons(&report), [(NO_COMMAND, 3)]);
        assert_eq!(report.late, 0);
    }

    #[test]
    fn samples_from_before_the_first_scan_are_not_counted() {
        let mut ledger = Ledger::new(100, PERIOD_NS);
        ledger.published(99, 1);
        ledger.answered(99, 2);
        assert_eq!(ledger.report(), ScanReport::default());
        ledger.published(100, 3);
        ledger.answered(100, 4);
        assert_eq!(ledger.report().published, 1);
    }

    #[test]
    fn a_ledger_can_start_with_the_first_scan_that_is_seen() {
        let mut ledger = Ledger::new(0, PERIOD_NS);
        assert_eq!(ledger.report(), ScanReport::default());
        ledger.answered(499, 1);
        ledger.begin_at(500);
        ledger.published(500, 3);
        ledger.answered(500, 4);
        ledger.answered(499, 5);
        let report = ledger.report();
        assert_eq!((report.published, report.commanded, report.unaccounted), (1, 1, 0));
    }

    #[test]
    fn a_scan_that_was_skipped_after_the_end_is_no_scan_of_the_run() {
        let mut ledger = ledger(3, &[]);
        ledger.run_ended();
        ledger.excused(5..=5, ROBOT_HELD_UP);
        let report = ledger.report();
        assert_eq!((report.published, report.lost, report.unaccounted), (3, 0, 0));
    }

    #[test]
    fn the_ledger_takes_as_much_memory_as_its_window_whatever_the_numbers() {
        let mut ledger = ledger(3, &[]);
        for scan_id in [1 << 47, 1, 0, u64::MAX - 1, 1 << 63] {
            ledger.excused(0..=scan_id, ROBOT_HELD_UP);
            ledger.excused(scan_id..=u64::MAX, NOT_OBSERVED);
            ledger.refused(scan_id, "too_old");
            ledger.published(scan_id, 1);
            ledger.answered(scan_id, 2);
            assert!(ledger.entries.len() <= 2 * WINDOW + 2, "{}", ledger.entries.len());
            assert!(ledger.refusals.len() <= WINDOW);
        }
    }

    #[test]
    fn the_largest_scan_number_does_not_overflow() {
        let mut ledger = Ledger::new(1, PERIOD_NS);
        ledger.published(u64::MAX, 1);
        ledger.outage_began(Role::Robot, PROCESS_RESTARTED);
        ledger.outage_ended(Role::Robot);
        assert_eq!(ledger.report().published, u64::MAX);
    }
}
