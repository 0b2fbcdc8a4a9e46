//! How long another process has been silent, while this one could have heard it.
//!
//! A process that was suspended, frozen with its control group or kept from every processor hears nothing. When it runs
//! again, the others may have been suspended with it: that time is no evidence against them.
//!
//! A process that works longer than [`STOOD_STILL_NS`] between two polls looks the same. So each pause counts for that
//! long: such a process measures more slowly, but it measures.

use crate::monotonic_ns;

/// Loops poll ten times a second; one that did not for three times as long did not run [ns].
pub const STOOD_STILL_NS: u64 = 300_000_000;

/// The silence of one other process, as one that polls regularly measures it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Silence {
    heard_ns: u64,
    polled_ns: u64,
    /// Of the time since then, how long this process did not run [ns].
    absent_ns: u64,
}

impl Default for Silence {
    fn default() -> Self {
        let now_ns = monotonic_ns();
        Self { heard_ns: now_ns, polled_ns: now_ns, absent_ns: 0 }
    }
}

impl Silence {
    /// Time since the other process was heard at `heard_ns`, without the time in which this process did not run [ns]; to be
    /// called with each poll.
    pub fn since(&mut self, heard_ns: u64, now_ns: u64) -> u64 {
        let gap_ns = now_ns.saturating_sub(std::mem::replace(&mut self.polled_ns, now_ns));
        let silent_ns = now_ns.saturating_sub(heard_ns);
        if heard_ns != self.heard_ns {
            (self.heard_ns, self.absent_ns) = (heard_ns, 0);
        }
        self.absent_ns += gap_ns.min(silent_ns).saturating_sub(STOOD_STILL_NS);
        silent_ns.saturating_sub(self.absent_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const POLL: u64 = SECOND / 10;

    fn at(now_ns: u64) -> Silence {
        Silence { heard_ns: now_ns, polled_ns: now_ns, absent_ns: 0 }
    }

    #[test]
    fn a_process_that_polls_counts_all_of_the_silence() {
        let mut silence = at(SECOND);
        for poll in 1..=300 {
            assert_eq!(silence.since(SECOND, SECOND + poll * POLL), poll * POLL);
        }
    }

    #[test]
    fn the_time_in_which_it_did_not_run_is_left_out() {
        let mut silence = at(SECOND);
        assert_eq!(silence.since(SECOND, 2 * SECOND - POLL), 3 * POLL, "it did not run for 0.9 s");
        assert_eq!(silence.since(SECOND, 2 * SECOND), 4 * POLL);
        assert_eq!(silence.since(SECOND, 47 * SECOND), 7 * POLL, "nor for 45 s");
        assert_eq!(silence.since(SECOND, 47 * SECOND + POLL), 8 * POLL);
        // It hears something: the silence begins anew.
        assert_eq!(silence.since(47 * SECOND + 2 * POLL, 47 * SECOND + 2 * POLL), 0);
        assert_eq!(silence.since(47 * SECOND + 2 * POLL, 47 * SECOND + 3 * POLL), POLL);
    }

    #[test]
    fn what_was_said_before_the_pause_and_heard_after_it_is_no_silence() {
        let mut silence = at(SECOND);
        assert_eq!(silence.since(SECOND + POLL / 2, 46 * SECOND), STOOD_STILL_NS);
    }

    #[test]
    fn a_process_that_polls_rarely_notices_a_silence_later_but_it_does() {
        let mut silence = at(SECOND);
        let silent_ns: Vec<u64> =
            (1..=10).map(|poll| silence.since(SECOND, SECOND + poll * SECOND)).collect();
        assert_eq!((silent_ns[0], silent_ns[9]), (STOOD_STILL_NS, 10 * STOOD_STILL_NS));
    }
}
