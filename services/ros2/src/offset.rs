//! The clock of the robot, as its stamps show it: commands carry stamps of this clock, not of ours.

/// A change of the clock that is told [s].
const STEP_S: f64 = 1e-3;
/// Stamps that are further behind show that the clock was set back [s].
const JUMP_S: f64 = 0.5;

/// The clock of the robot minus CLOCK_MONOTONIC: the largest that a stamp has shown, as that message was delayed least.
#[derive(Debug, Default)]
pub(crate) struct Offset {
    known_s: Option<f64>,
}

impl Offset {
    /// Takes a stamp and the arrival of its message; the offset when it has changed [s].
    pub(crate) fn note(&mut self, stamp_s: f64, arrived_ns: u64) -> Option<f64> {
        let shown_s = stamp_s - arrived_ns as f64 * 1e-9;
        let is_news =
            self.known_s.is_none_or(|known_s| shown_s > known_s + STEP_S || shown_s < known_s - JUMP_S);
        if is_news {
            self.known_s = Some(shown_s);
        }
        is_news.then_some(shown_s)
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
}
