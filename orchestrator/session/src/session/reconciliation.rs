//! The sample audit of a run: reconciled every second, and in lock-step when the loop stands still.
//!
//! In lock-step a lost sample stops the loop. The audit then names it and the run ends for that reason, long before
//! [`LOCKSTEP_TIMEOUT_NS`] is over.

use audit::ledger::{RefusedRow, SampleAudit};
use report::Outcome;
use runtime::{Silence, monotonic_ns};
use shared_types::{Role, Rule};
use supervision::supervisor::Event;

use super::Session;

/// In lock-step a scan that is not answered within this time of the machine's clock, in which this process ran, ends the
/// run [ns].
const LOCKSTEP_TIMEOUT_NS: u64 = 20_000_000_000;
/// Time between two reconciliations [ns].
const PERIOD_NS: u64 = 1_000_000_000;
/// The same when a lock-step makes no progress [ns].
const STALLED_NS: u64 = 100_000_000;

/// Samples dropped this long before the end of a run may be its cause: heartbeats come ten times a second.
const RECENT_NS: u64 = 500_000_000;
/// The same in scans, for long periods.
const RECENT_SCANS: u64 = 5;
/// So many late scans of one heartbeat are named, besides the newest.
const RECENT_LATE_SCANS: u64 = 1_000;

/// The sample audit, and when it is due.
pub(crate) struct Reconciliation {
    pub(crate) samples: SampleAudit,
    lockstep: bool,
    reconciled_ns: u64,
    /// When a scan was recorded last, or the loop began to drive.
    moved_ns: u64,
    /// How long it has made no progress since then.
    stillness: Silence,
}

/// What is due for the sample audit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Due {
    /// Nothing yet.
    Nothing,
    /// To reconcile it.
    Reconcile,
    /// To reconcile it, and to end the run when a sample is missing.
    FindStall,
    /// To end the run.
    TimedOut,
}

impl Reconciliation {
    pub(super) fn new(samples: SampleAudit, lockstep: bool) -> Self {
        let (moved_ns, stillness) = (monotonic_ns(), Silence::default());
        Self { samples, lockstep, reconciled_ns: 0, moved_ns, stillness }
    }

    /// The loop makes progress.
    pub(super) fn moved(&mut self, now_ns: u64) {
        self.moved_ns = now_ns;
    }

    /// What is due now; `drives` while the system drives and its end is open.
    fn due(&mut self, now_ns: u64, drives: bool) -> Due {
        let since_ns = self.stillness.since(self.moved_ns, now_ns);
        let still_ns = if self.lockstep && drives { since_ns } else { 0 };
        let is_stalled = still_ns >= STALLED_NS;
        let period_ns = if is_stalled { STALLED_NS } else { PERIOD_NS };
        if still_ns > LOCKSTEP_TIMEOUT_NS {
            return Due::TimedOut;
        }
        if now_ns.saturating_sub(self.reconciled_ns) < period_ns {
            return Due::Nothing;
        }
        self.reconciled_ns = now_ns;
        if is_stalled { Due::FindStall } else { Due::Reconcile }
    }
}

impl Session {
    /// Reconciles the sample audit when it is due; ends a lock-step that cannot continue.
    pub(super) fn advance_audit(&mut self) {
        let due = self.audit.due(monotonic_ns(), self.drives());
        if matches!(due, Due::Reconcile | Due::FindStall) {
            self.reconcile(false);
            self.reconcile_companions(self.drives());
        }
        if due == Due::FindStall {
            if self.audit.samples.is_something_missing() {
                let fault =
                    self.audit.samples.report().faults.last().map_or_else(String::new, ToString::to_string);
                self.decide(Outcome::Failed, &format!("the loop stands still: {fault}"));
            }
            self.require_truth(true);
        }
        if due == Due::TimedOut {
            let scan = self.samples.newest_scan();
            let reason = format!("scan {scan} was not answered within 20 s of the machine's time");
            self.decide(Outcome::Failed, &reason);
        }
    }

    /// Names the process whose samples were dropped or refused, and reports it to the supervisor, which must not blame
    /// the reader.
    pub(super) fn blame_writers(&mut self) -> anyhow::Result<()> {
        for (scan_id, rule) in self.samples.take_refused() {
            self.recording.recorder.sample_refused(scan_id, rule);
        }
        for refusal in self.audit.samples.new_refusals() {
            let RefusedRow { topic, incarnation, reader, newest_scan, count, .. } = &refusal.row;
            if refusal.writer == Role::Robot && refusal.rule == Rule::TooOld {
                // No stage takes a scan that comes too late, so its readers alone know why it has no command.
                let others = count.saturating_sub(1).min(RECENT_LATE_SCANS);
                for scan_id in newest_scan.saturating_sub(others)..=*newest_scan {
                    self.recording.recorder.sample_refused(scan_id, refusal.rule);
                }
                self.handle(Event::InputsLate { reader: refusal.reader })?;
            }
            let (role, incarnation) = (refusal.writer, *incarnation);
            let fault = refusal.row.fault();
            let reason = format!("its {topic} for scan {newest_scan} was dropped by {reader}: {fault}");
            if refusal.is_first && refusal.rule.is_of_writer() && self.conclusion.is_open() {
                let is_current =
                    self.supervisor.process(role).is_some_and(|view| view.incarnation == incarnation);
                let name =
                    if is_current { self.fleet.label(role) } else { format!("incarnation {incarnation}") };
                self.warn(&format!("{role} ({name}): {reason}"));
            }
            if refusal.rule.is_of_content() {
                self.handle(Event::Refused { role, incarnation, reader: refusal.reader, reason })?;
            }
        }
        Ok(())
    }

    /// The samples that were dropped or refused recently, as a continuation of the reason for the end of a run.
    pub(super) fn blame(&self) -> String {
        let recent = RECENT_SCANS + RECENT_NS / self.run.period_ns.max(1);
        let newest = self.samples.newest_scan();
        let of_writer = |name: &str| Rule::ALL.iter().any(|rule| rule.name() == name && rule.is_of_writer());
        let rows = self.audit.samples.refused().iter();
        // The robot is the first stage, so no other is to blame for the age of its samples.
        let is_late = |row: &RefusedRow| row.writer == Role::Robot.name() && row.rule == Rule::TooOld.name();
        rows.filter(|row| row.newest_scan.saturating_add(recent) >= newest)
            .filter(|row| of_writer(&row.rule) || is_late(row))
            .map(|row| format!("; {row}"))
            .collect()
    }

    /// Reconciles the sample audit and prints what it found.
    pub(super) fn reconcile(&mut self, is_last: bool) {
        for fault in self.audit.samples.reconcile(is_last) {
            self.warn(&format!("error: ledger: {fault}"));
        }
        for stranger in self.audit.samples.new_strangers(monotonic_ns(), is_last) {
            self.warn(&stranger.to_string());
        }
        for (scan_id, reason) in self.audit.samples.lost_scans() {
            self.recording.recorder.sample_lost(scan_id, reason.name());
        }
        for (scans, reason) in self.audit.samples.excused() {
            self.recording.recorder.scans_excused(scans, reason);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lockstep() -> Reconciliation {
        Reconciliation { moved_ns: 0, ..Reconciliation::new(SampleAudit::new(true), true) }
    }

    #[test]
    fn the_audit_is_reconciled_once_a_second() {
        let mut audit = Reconciliation { lockstep: false, ..lockstep() };
        assert_eq!(audit.due(PERIOD_NS - 1, true), Due::Nothing);
        assert_eq!(audit.due(PERIOD_NS, true), Due::Reconcile);
        assert_eq!(audit.due(2 * PERIOD_NS - 1, true), Due::Nothing, "in real time a loop never stalls");
        assert_eq!(audit.due(100 * PERIOD_NS, true), Due::Reconcile);
    }

    #[test]
    fn a_lock_step_without_progress_is_examined_soon_and_given_up_after_twenty_seconds() {
        let mut audit = lockstep();
        assert_eq!(audit.due(STALLED_NS - 1, true), Due::Nothing);
        assert_eq!(audit.due(STALLED_NS, true), Due::FindStall);
        // This process stands still, and all others with it.
        assert_eq!(audit.due(10 * LOCKSTEP_TIMEOUT_NS, true), Due::FindStall);
        let moved_ns = 10 * LOCKSTEP_TIMEOUT_NS;
        audit.moved(moved_ns);
        let polls = 1..=LOCKSTEP_TIMEOUT_NS / STALLED_NS;
        assert!(polls.clone().all(|poll| audit.due(moved_ns + poll * STALLED_NS, true) == Due::FindStall));
        assert_eq!(audit.due(moved_ns + LOCKSTEP_TIMEOUT_NS + 1, true), Due::TimedOut);
        assert_eq!(
            audit.due(moved_ns + 2 * LOCKSTEP_TIMEOUT_NS, false),
            Due::Reconcile,
            "the run ends already"
        );
    }
}
