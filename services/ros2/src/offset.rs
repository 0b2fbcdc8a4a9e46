//! The clock of the robot, as its stamps show it: commands carry stamps of this clock, not of ours.

/// A change of the clock that is told [s].
const STEP_S: f64 = 1e-3;
/// Stamps that are further behind show that the clock was set back [s].
const JUMP_S: f64 = 0.5;
/// For so long, and up to twice as long, the largest counts [ns]: a stamp that was ahead once, and a clock that is slewed
/// back, are followed after it.
const WINDOW_NS: u64 = 10_000_000_000;

/// The clock of the robot minus CLOCK_MONOTONIC: the largest that a stamp has shown lately, as that message was delayed
/// least.
#[derive(Debug, Default)]
pub(crate) struct Offset {
    known_s: Option<f64>,
    /// The largest of the window before and of this one [s].
    largest_s: [f64; 2],
    /// When this window began [ns].
    since_ns: u64,
}

impl Offset {
    /// Takes a stamp and the arrival of its message; the offset when it has changed [s].
    pub(crate) fn note(&mut self, stamp_s: f64, arrived_ns: u64) -> Option<f64> {
        let shown_s = stamp_s - arrived_ns as f64 * 1e-9;
        if self.known_s.is_none_or(|known_s| shown_s < known_s - JUMP_S) {
            (self.largest_s, self.since_ns) = ([shown_s; 2], arrived_ns);
        } else if arrived_ns.saturating_sub(self.since_ns) >= WINDOW_NS {
            (self.largest_s, self.since_ns) = ([self.largest_s[1], shown_s], arrived_ns);
        }
        let [before_s, now_s] = &mut self.largest_s;
        *now_s = now_s.max(shown_s);
        let offset_s = now_s.max(*before_s);
        let is_news = self.known_s.is_none_or(|known_s| (offset_s - known_s).abs() > STEP_S);
        if is_news {
            self.known_s = Some(offset_s);
        }
        is_news.then_some(offset_s)
    }

    /// The offset [s].
    pub(crate) fn known_s(&self) -> Option<f64> {
        self.known_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    #[test]
    fn the_least_delayed_message_counts_and_a_jump_begins_anew() {
        let mut offset = Offset::default();
        assert_eq!(offset.note(1000.0, 10 * S), Some(990.0));
        // 20 ms later than the first one was.
        assert_eq!(offset.note(1001.0, 11 * S + S / 50), None);
        assert_eq!(offset.note(1002.25, 12 * S), Some(990.25));
        // A day back, and a day ahead.
        assert_eq!(offset.note(1003.0 - 86_400.0, 13 * S), Some(990.0 - 86_400.0));
        assert_eq!(offset.note(1004.0, 14 * S), Some(990.0));
        assert_eq!(offset.known_s(), Some(990.0));
    }
    #[test]
    fn a_stamp_that_was_ahead_once_and_a_clock_that_is_slewed_back_are_followed_within_two_windows() {
        let mut offset = Offset::default();
        let mut after = |from_s: u64, to_s: u64, ahead_s: f64| {
            for tenth in 10 * from_s..10 * to_s {
                offset.note(tenth as f64 / 10.0 + ahead_s, tenth * S / 10);
            }
            offset.known_s().unwrap()
        };
        assert!((after(0, 5, 0.0)).abs() < 1e-6);
        assert!((after(5, 6, 0.4) - 0.4).abs() < 1e-6);
        assert!((after(6, 27, 0.0)).abs() < 1e-6);
        // 0.3 s back, as by a time server.
        assert!((after(27, 48, -0.3) + 0.3).abs() < 1e-6);
    }
}
