//! Counters of a device that wrap.

/// Extends the stamps of a device to a count that does not wrap.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counter {
    /// Length of a tick [ns].
    tick_ns: i64,
    /// Ticks after which the counter is zero again.
    wrap_ticks: Option<i64>,
    /// The newest stamp, extended, and when it arrived [ticks, ns].
    last: Option<(i64, u64)>,
}

impl Counter {
    pub(crate) fn new(tick_ns: u64, wrap_ticks: Option<u64>) -> Self {
        Self { tick_ns: to_signed(tick_ns).max(1), wrap_ticks: wrap_ticks.map(to_signed), last: None }
    }

    /// The stamp that a device should have at `time_ns`, extended [ns].
    pub(crate) fn expected_ns(&self, time_ns: u64) -> Option<i64> {
        self.last.map(|(ticks, last_ns)| {
            ticks.saturating_mul(self.tick_ns).saturating_add(time_ns.wrapping_sub(last_ns).cast_signed())
        })
    }

    /// The stamp without wraps, nearest to what is expected at its arrival [ns].
    pub(crate) fn extend(&self, ticks: u64, arrived_ns: u64) -> i64 {
        let ticks = to_signed(ticks);
        let extended = match (self.wrap_ticks, self.expected_ns(arrived_ns)) {
            (Some(wrap), Some(expected_ns)) => {
                let expected = expected_ns / self.tick_ns;
                let ahead = ticks.saturating_sub(expected).rem_euclid(wrap);
                expected.saturating_add(if ahead > wrap / 2 { ahead - wrap } else { ahead })
            }
            _ => ticks,
        };
        extended.saturating_mul(self.tick_ns)
    }

    /// Keeps a stamp of [`Self::extend`] as the newest; true when it is before the one kept until now.
    pub(crate) fn keep(&mut self, stamp_ns: i64, arrived_ns: u64) -> bool {
        let ticks = stamp_ns / self.tick_ns;
        let is_before = self.last.is_some_and(|(last, _)| ticks < last);
        self.last = Some((ticks, arrived_ns));
        is_before
    }
}

/// A count or time that leaves room for sums.
fn to_signed(value: u64) -> i64 {
    value.min(1 << 61).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_wrap_continues_the_count() {
        let mut counter = Counter::new(MS, Some(1 << 24));
        let first = counter.extend((1 << 24) - 50, 5);
        assert!(!counter.keep(first, 5));
        let second = counter.extend(50, 5 + 100 * MS);
        assert_eq!(second - first, 100 * MS as i64);
        assert!(!counter.keep(second, 5 + 100 * MS));
    }

    #[test]
    fn a_gap_longer_than_the_counter_is_extended_by_the_time_that_passed() {
        let mut counter = Counter::new(MS, Some(1 << 24));
        let first = counter.extend(1000, 0);
        counter.keep(first, 0);
        let gap_ms = 2 * (1 << 24) + 7;
        assert_eq!(counter.extend(1007, gap_ms * MS), first + (gap_ms * MS) as i64);
    }

    #[test]
    fn a_restart_counts_backwards() {
        let mut counter = Counter::new(MS, Some(1 << 24));
        let first = counter.extend(5000, 0);
        counter.keep(first, 0);
        let second = counter.extend(0, 100 * MS);
        assert!(counter.keep(second, 100 * MS));
    }
}
