//! When the messages of a topic were measured.
//!
//! The stamp of a message counts. One that is zero, goes back or is far ahead of the time that has passed is of no clock:
//! then the time counts at which the message was recorded, moved to the clock of the stamps.

use serde::Serialize;

/// A stamp may be so much further ahead of the one before than messages were recorded apart [ns].
const AHEAD_NS: u64 = 10_000_000_000;

/// What the stamps of a topic were.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct StampCounts {
    /// Messages without a stamp.
    pub zero: u64,
    /// Messages whose stamp was not later than the one before, or far ahead.
    pub wrong: u64,
    /// Of both, messages that were left out, because they were not recorded later than the one before either.
    pub left_out: u64,
}

/// The times of a topic.
#[derive(Debug, Clone, Default)]
pub(crate) struct Times {
    /// Time and log time of the newest message [ns].
    newest_ns: Option<[u64; 2]>,
    /// The log time minus the newest stamp [ns].
    offset_ns: i64,
    pub(crate) counts: StampCounts,
}

impl Times {
    /// When the next message was measured [ns]; `None` for one that is left out.
    pub(crate) fn next(&mut self, stamp_ns: u64, log_ns: u64) -> Option<u64> {
        let is_later = |ns: u64| self.newest_ns.is_none_or(|[newest_ns, _]| ns > newest_ns);
        let latest_ns = self.newest_ns.map_or(u64::MAX, |[newest_ns, logged_ns]| {
            newest_ns.saturating_add(log_ns.saturating_sub(logged_ns)).saturating_add(AHEAD_NS)
        });
        let is_stamp = stamp_ns > 0 && is_later(stamp_ns) && stamp_ns <= latest_ns;
        let time_ns = if is_stamp {
            self.offset_ns = log_ns.wrapping_sub(stamp_ns).cast_signed();
            stamp_ns
        } else {
            *(if stamp_ns == 0 { &mut self.counts.zero } else { &mut self.counts.wrong }) += 1;
            log_ns.wrapping_sub(self.offset_ns.cast_unsigned())
        };
        // Arithmetic on forged times may leave the years that a clock has.
        let is_time = is_stamp || is_later(time_ns) && time_ns <= latest_ns;
        if !is_time {
            self.counts.left_out += 1;
            return None;
        }
        self.newest_ns = Some([time_ns, log_ns]);
        Some(time_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_counts_and_where_there_is_none_the_log_time_on_its_clock() {
        let mut times = Times::default();
        // The robot's clock is 900 behind.
        assert_eq!(times.next(100, 1000), Some(100));
        assert_eq!(times.next(0, 1010), Some(110));
        assert_eq!(times.next(90, 1020), Some(120), "back");
        assert_eq!(times.next(120, 1020), None, "recorded at the same time");
        assert_eq!(times.next(100 + 2 * AHEAD_NS, 1030), Some(130), "far ahead");
        assert_eq!(times.next(140, 1041), Some(140));
        assert_eq!(times.counts, StampCounts { zero: 1, wrong: 3, left_out: 1 });
        let mut unstamped = Times::default();
        assert_eq!(
            [unstamped.next(0, 7), unstamped.next(0, 9), unstamped.next(0, 8)],
            [Some(7), Some(9), None]
        );
    }

    #[test]
    fn forged_times_are_left_out() {
        let mut times = Times::default();
        for (stamp_ns, log_ns) in [(u64::MAX, 0), (0, u64::MAX), (5, 1), (0, 0), (u64::MAX, u64::MAX)] {
            times.next(stamp_ns, log_ns);
        }
        assert!(times.counts.left_out > 0);
    }
}
