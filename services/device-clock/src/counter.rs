//! Counters of a device that wrap.

use crate::settings::ClockSettings;

/// What a stamp is next to those before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// Not before the newest one.
    Newest,
    /// Before the newest one: its message was overtaken.
    Overtaken,
    /// So far before the newest one that no delay explains it.
    Restarted,
}

/// Extends the stamps of a device to a count that does not wrap.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counter {
    /// Length of a tick [ns].
    tick_ns: i64,
    /// Ticks after which the counter is zero again.
    wrap_ticks: Option<i64>,
    /// A stamp that is even older than the newest one is of a device that was restarted, or of a clock that was set back;
    /// 0 where messages keep their order [ns].
    max_overtaken_ns: i64,
    /// The newest stamp, extended, and when it arrived [ticks, ns].
    last: Option<(i64, u64)>,
}

impl Counter {
    pub(crate) fn new(settings: &ClockSettings) -> Self {
        Self {
            tick_ns: to_signed(settings.tick_ns).max(1),
            wrap_ticks: settings.wrap_ticks.map(to_signed),
            max_overtaken_ns: to_signed(settings.max_overtaken_ns),
            last: None,
        }
    }

    /// Takes a stamp as the newest one [ns].
    pub(crate) fn begin_at(&mut self, stamp_ns: i64, arrived_ns: u64) {
        self.last = Some((stamp_ns / self.tick_ns, arrived_ns));
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

    /// Keeps a stamp of [`Self::extend`], unless its message was overtaken.
    pub(crate) fn keep(&mut self, stamp_ns: i64, arrived_ns: u64) -> Order {
        let ticks = stamp_ns / self.tick_ns;
        let order = self.last.map_or(Order::Newest, |last| self.order(last, ticks, arrived_ns));
        if order != Order::Overtaken {
            self.last = Some((ticks, arrived_ns));
        }
        order
    }

    /// A restarted device has lost most of its count. One whose clock was set back has not; but messages are overtaken by
    /// others, and none has come since.
    fn order(&self, (last, last_ns): (i64, u64), ticks: i64, arrived_ns: u64) -> Order {
        if ticks >= last {
            return Order::Newest;
        }
        let since_ns = arrived_ns.wrapping_sub(last_ns).cast_signed();
        let late_ns = since_ns.saturating_add(last.saturating_sub(ticks).saturating_mul(self.tick_ns));
        let count = |ticks: i64| self.wrap_ticks.map_or(ticks, |wrap| ticks.rem_euclid(wrap));
        let has_lost_count = count(ticks) < count(last) / 2;
        let is_alone = since_ns > self.max_overtaken_ns;
        let is_restarted = late_ns > self.max_overtaken_ns && (has_lost_count || is_alone);
        if is_restarted || self.max_overtaken_ns == 0 { Order::Restarted } else { Order::Overtaken }
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

    /// A counter of milliseconds that does not wrap, on a line on which messages overtake each other.
    fn overtaking() -> ClockSettings {
        ClockSettings { tick_ns: MS, ..ClockSettings::nanoseconds() }
    }

    #[test]
    fn a_wrap_continues_the_count() {
        let mut counter = Counter::new(&ClockSettings::milliseconds_of_24_bits());
        let first = counter.extend((1 << 24) - 50, 5);
        assert_eq!(counter.keep(first, 5), Order::Newest);
        let second = counter.extend(50, 5 + 100 * MS);
        assert_eq!(second - first, 100 * MS as i64);
        assert_eq!(counter.keep(second, 5 + 100 * MS), Order::Newest);
    }

    #[test]
    fn a_gap_longer_than_the_counter_is_extended_by_the_time_that_passed() {
        let mut counter = Counter::new(&ClockSettings::milliseconds_of_24_bits());
        let first = counter.extend(1000, 0);
        counter.keep(first, 0);
        let gap_ms = 2 * (1 << 24) + 7;
        assert_eq!(counter.extend(1007, gap_ms * MS), first + (gap_ms * MS) as i64);
    }

    #[test]
    fn a_restart_counts_backwards() {
        let mut counter = Counter::new(&ClockSettings::milliseconds_of_24_bits());
        let first = counter.extend(5000, 0);
        counter.keep(first, 0);
        let second = counter.extend(0, 100 * MS);
        assert_eq!(counter.keep(second, 100 * MS), Order::Restarted);
    }

    #[test]
    fn a_message_that_was_overtaken_is_no_restart_however_old_it_is() {
        let mut counter = Counter::new(&overtaking());
        let mut at = |stamp_ms: i64, arrived_ms: u64| counter.keep(stamp_ms * MS as i64, arrived_ms * MS);
        assert_eq!(at(5000, 0), Order::Newest);
        // Stamped 60 ms and 2.4 s before, and overtaken.
        assert_eq!([at(4940, 1), at(2600, 2)], [Order::Overtaken; 2]);
        assert_eq!(at(5000, 3), Order::Newest);
        // 1 s is the largest delay: 1.1 s older, when others have come, is no restart of a clock that counts on.
        assert_eq!(at(3900, 4), Order::Overtaken);
        // Set back by 1.1 s: nothing newer comes for more than a second.
        assert_eq!([at(4900, 1003), at(4905, 1005)], [Order::Overtaken, Order::Restarted]);
    }

    #[test]
    fn a_device_that_starts_again_within_a_second_seems_late() {
        let mut counter = Counter::new(&overtaking());
        assert_eq!(counter.keep(400 * MS as i64, 0), Order::Newest);
        assert_eq!(counter.keep(0, 500 * MS), Order::Overtaken, "as one of 900 ms delay");
        assert_eq!(counter.keep(0, 601 * MS), Order::Restarted);
    }
}
