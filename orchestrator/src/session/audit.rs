//! The part of a session that keeps the books: closes them every second, and says what is wrong at once.
//!
//! In lock-step a sample that is lost stops the loop. The books then say which it was, and the run ends for that,
//! long before the loop would be given up.

use runtime::monotonic_ns;
use shared_types::Phase;

use super::{End, Session};
use crate::report::Outcome;

/// Time between two closings, of this computer and of the drive [ns].
const CLOSING_NS: u64 = 1_000_000_000;
/// Time between two closings when a lock-step stands still [ns].
const STANDSTILL_NS: u64 = 100_000_000;

impl Session {
    /// Closes the books when it is time to; ends a lock-step that can't go on.
    pub(super) fn audit(&mut self) {
        let now_ns = monotonic_ns();
        let stands_still = self.lockstep
            && self.end == End::NotYet
            && self.supervisor.phase() == Phase::Driving
            && now_ns.saturating_sub(self.moved_ns) >= STANDSTILL_NS;
        let period_ns = if stands_still { STANDSTILL_NS } else { CLOSING_NS };
        if now_ns.saturating_sub(self.closed_ns) < period_ns {
            return;
        }
        self.closed_ns = now_ns;
        self.close_books(false);
        if stands_still && self.books.is_something_missing() {
            let fault = self.books.report().faults.last().map_or_else(String::new, ToString::to_string);
            self.decide(Outcome::Failed, &format!("the loop stands still: {fault}"));
        }
    }

    /// Closes the books, and says what was found.
    pub(super) fn close_books(&mut self, is_last: bool) {
        for fault in self.books.close(is_last) {
            self.progress.warn(&format!("error: ledger: {fault}"));
        }
        for (scan_id, reason) in self.books.excused() {
            self.recorder.scan_excused(scan_id, reason);
        }
    }
}
