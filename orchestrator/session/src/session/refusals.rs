//! The part of a session that keeps the books: closes them every second, and says what is wrong at once.
//!
//! In lock-step a sample that is lost stops the loop. The books then say which it was, and the run ends for that,
//! long before the loop would be given up.

use audit::ledger::RefusedRow;
use report::Outcome;
use runtime::monotonic_ns;
use shared_types::{Phase, Rule};
use supervision::supervisor::Event;

use super::Session;

/// Time between two closings, of this computer and of the drive [ns].
const CLOSING_NS: u64 = 1_000_000_000;
/// Time between two closings when a lock-step stands still [ns].
const STANDSTILL_NS: u64 = 100_000_000;

/// Samples dropped this long before the end of a run have to do with it: heartbeats come ten times a second.
const LATELY_NS: u64 = 500_000_000;
/// The same in scans, for slow ones.
const LATELY_SCANS: u64 = 5;

impl Session {
    /// Closes the books when it is time to; ends a lock-step that can't go on.
    pub(super) fn audit(&mut self) {
        let now_ns = monotonic_ns();
        let stands_still = self.lockstep
            && self.conclusion.is_open()
            && self.supervisor.phase() == Phase::Driving
            && now_ns.saturating_sub(self.moved_ns) >= STANDSTILL_NS;
        let period_ns = if stands_still { STANDSTILL_NS } else { CLOSING_NS };
        if now_ns.saturating_sub(self.closed_ns) < period_ns {
            return;
        }
        self.closed_ns = now_ns;
        self.reconcile(false);
        if stands_still && self.sample_audit.is_something_missing() {
            let fault =
                self.sample_audit.report().faults.last().map_or_else(String::new, ToString::to_string);
            self.decide(Outcome::Failed, &format!("the loop stands still: {fault}"));
        }
    }

    /// Says whose samples were dropped or refused, and tells the supervisor, so that it does not blame the reader.
    pub(super) fn blame_writers(&mut self) -> anyhow::Result<()> {
        for (scan_id, rule) in self.samples.take_refused() {
            self.recorder.sample_refused(scan_id, rule);
        }
        for refusal in self.sample_audit.new_refusals() {
            let RefusedRow { topic, incarnation, reader, newest_scan, .. } = &refusal.row;
            let (role, incarnation) = (refusal.writer, *incarnation);
            let words = format!(
                "its {topic} for scan {newest_scan} was dropped by {reader}: {}",
                refusal.row.fault()
            );
            if refusal.is_first && refusal.rule.is_of_writer() && self.conclusion.is_open() {
                let is_current =
                    self.supervisor.process(role).is_some_and(|view| view.incarnation == incarnation);
                let name =
                    if is_current { self.fleet.label(role) } else { format!("incarnation {incarnation}") };
                self.progress.warn(&format!("{role} ({name}): {words}"));
            }
            if refusal.rule.is_of_content() {
                self.handle(Event::Refused { role, incarnation, reader: refusal.reader, words })?;
            }
        }
        Ok(())
    }

    /// What was dropped or refused lately, in words that follow the reason for the end of a run.
    pub(super) fn blame(&self) -> String {
        let lately = LATELY_SCANS + LATELY_NS / self.period_ns.max(1);
        let newest = self.samples.newest_scan();
        let of_writer = |name: &str| Rule::ALL.iter().any(|rule| rule.name() == name && rule.is_of_writer());
        let rows = self
            .sample_audit
            .refused()
            .iter()
            .filter(|row| row.newest_scan.saturating_add(lately) >= newest && of_writer(&row.rule));
        rows.map(|row| format!("; {row}")).collect()
    }

    /// Closes the books, and says what was found.
    pub(super) fn reconcile(&mut self, is_last: bool) {
        for fault in self.sample_audit.reconcile(is_last) {
            self.progress.warn(&format!("error: ledger: {fault}"));
        }
        for (scan_id, reason) in self.sample_audit.excused() {
            self.recorder.scan_excused(scan_id, reason);
        }
    }
}
