//! Copies of a sample against loss: sent again a little later, unless a newer one takes their place.

/// Copies after the first.
const COPIES: u32 = 2;
/// Time between two of them [ns].
const APART_NS: u64 = 2_000_000;
/// With a shorter scan period the next sample comes too soon for copies [ns].
const MIN_PERIOD_NS: u64 = 20_000_000;

/// When the newest sample of a topic is sent again.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Repeats {
    left: u32,
    next_ns: u64,
}

impl Repeats {
    /// A sample was sent at `now_ns`: its copies replace those of the one before.
    pub(crate) fn sent(&mut self, now_ns: u64, period_ns: u64) {
        self.left = if period_ns >= MIN_PERIOD_NS { COPIES } else { 0 };
        self.next_ns = now_ns + APART_NS;
    }

    /// How long to wait for the next copy [ns]; `None` when there is none.
    pub(crate) fn wait_ns(&self, now_ns: u64) -> Option<u64> {
        (self.left > 0).then(|| self.next_ns.saturating_sub(now_ns))
    }

    /// Whether a copy is to be sent now.
    pub(crate) fn take(&mut self, now_ns: u64) -> bool {
        let is_due = self.left > 0 && now_ns >= self.next_ns;
        if is_due {
            self.left -= 1;
            self.next_ns = now_ns + APART_NS;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;

    #[test]
    fn a_sample_is_sent_three_times_two_milliseconds_apart() {
        let mut repeats = Repeats::default();
        assert!(!repeats.take(0) && repeats.wait_ns(0).is_none());
        repeats.sent(10_000_000, PERIOD_NS);
        assert_eq!(repeats.wait_ns(10_500_000), Some(1_500_000));
        let sent = (10_000_000..30_000_000).step_by(500_000).filter(|now_ns| repeats.take(*now_ns));
        assert_eq!(sent.collect::<Vec<_>>(), [12_000_000, 14_000_000]);
    }

    #[test]
    fn a_newer_sample_replaces_the_copies_of_the_one_before() {
        let mut repeats = Repeats::default();
        repeats.sent(0, PERIOD_NS);
        assert!(repeats.take(2_000_000));
        repeats.sent(3_000_000, PERIOD_NS);
        assert!(!repeats.take(4_000_000) && repeats.take(5_000_000));
    }

    #[test]
    fn at_short_periods_there_are_no_copies() {
        let mut repeats = Repeats::default();
        repeats.sent(0, MIN_PERIOD_NS - 1);
        assert_eq!(repeats.wait_ns(0), None);
    }
}
