//! Which numbers a sample may carry: those that a scan or a sample can have at all, and those that they can have now.
//!
//! Readers, orchestrator and tools use scan numbers and sequence numbers as sizes and remember the largest one. So one
//! wrong number could take all memory, or make each sample that follows look old. Three rules prevent that:
//!
//! * no number is above [`MAX_NUMBER`] and no stamp above [`MAX_STAMP_NS`]: [`Header::check`] refuses the sample, so
//!   sums of a few of them never overflow;
//! * a scan number is not beyond what the scanner can have reached since the last known scan: [`KnownScan`];
//! * a sequence number is not beyond what its publisher can have published since the last poll: [`highest_sequence`].

use crate::{Fault, Header};

/// Largest number of a scan or a sample: one per microsecond reaches it after eight years.
pub const MAX_NUMBER: u64 = 1 << 48;
/// Latest stamp: 146 years after the machine was started [ns].
pub const MAX_STAMP_NS: u64 = 1 << 62;

/// So many times faster than its period a scanner may be: irregular ones catch up.
const MAX_SPEED: u64 = 4;
/// Scans that may be skipped at any time: a loop that is restarted or held up has lost some.
const MAX_SKIPPED: u64 = 2;
/// Shortest time from one sample of a publisher to the next [ns].
const MIN_INTERVAL_NS: u64 = 1_000;
/// More samples than any queue holds: a poll that does not empty its queue leaves them for the next.
const MAX_LEFT: u64 = 4096;
/// Distance by which a late sample may be behind; the one after that is no late one.
pub const MAX_LATE: u64 = 16;

/// The newest scan that a process knows to exist, and when it came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct KnownScan {
    scan_id: u64,
    acquired_ns: u64,
    arrived_ns: u64,
}

impl KnownScan {
    /// The scan of a sample that was accepted at `now_ns`, unless this one is newer. A block that repeats the last command
    /// carries the number of an old scan.
    #[must_use]
    pub fn and(self, header: &Header, now_ns: u64) -> Self {
        if header.scan_id >= self.scan_id { Self::of(header, now_ns) } else { self }
    }

    /// Before the first scan of a loop that starts at `now_ns`.
    pub fn start(now_ns: u64) -> Self {
        Self { scan_id: 0, acquired_ns: now_ns, arrived_ns: now_ns }
    }

    /// The scan of a sample that was accepted at `now_ns`.
    pub fn of(header: &Header, now_ns: u64) -> Self {
        Self { scan_id: header.scan_id, acquired_ns: header.acquired_ns, arrived_ns: now_ns }
    }

    /// The largest number that a scan of a scanner with this period can have at `now_ns`, if its stamp is
    /// `acquired_ns` and may be ahead of the clock by `max_ahead_ns`.
    ///
    /// Samples that waited arrive together, so the time between stamps counts where it is longer than that between
    /// arrivals.
    pub fn highest(&self, acquired_ns: u64, now_ns: u64, max_ahead_ns: u64, period_ns: u64) -> u64 {
        let latest_ns = acquired_ns.min(now_ns.saturating_add(max_ahead_ns));
        let since_ns = latest_ns.saturating_sub(self.acquired_ns).max(now_ns.saturating_sub(self.arrived_ns));
        let scans = since_ns.saturating_mul(MAX_SPEED) / period_ns.max(1);
        self.scan_id.saturating_add(1 + MAX_SKIPPED).saturating_add(scans)
    }

    /// Passes when the scan of a sample that arrives at `now_ns` can exist.
    ///
    /// # Errors
    /// [`Fault::ImpossibleNumber`] with the largest number that it can have.
    pub fn judge(
        &self,
        header: &Header,
        now_ns: u64,
        max_ahead_ns: u64,
        period_ns: u64,
    ) -> Result<(), Fault> {
        let highest = self.highest(header.acquired_ns, now_ns, max_ahead_ns, period_ns);
        require("header.scan_id", header.scan_id, highest)
    }
}

/// The largest number that the next sample of a publisher can have, `elapsed_ns` after a poll found `newest`.
pub fn highest_sequence(newest: u64, elapsed_ns: u64) -> u64 {
    newest.saturating_add(MAX_LEFT).saturating_add(elapsed_ns / MIN_INTERVAL_NS)
}

/// Passes when the sequence number of a sample is possible, `elapsed_ns` after a poll found `newest` of its publisher.
///
/// # Errors
/// [`Fault::ImpossibleNumber`] with the largest number that it can have.
pub fn require_sequence(sequence: u64, newest: u64, elapsed_ns: u64) -> Result<(), Fault> {
    require("header.sequence", sequence, highest_sequence(newest, elapsed_ns))
}

/// Passes when a number is not above `highest`, else names `field`.
///
/// # Errors
/// [`Fault::ImpossibleNumber`].
pub(crate) fn require(field: &'static str, value: u64, highest: u64) -> Result<(), Fault> {
    if value <= highest { Ok(()) } else { Err(Fault::ImpossibleNumber { field, value, highest }) }
}

impl Header {
    /// Passes when numbers and stamps are such as a scan can have at all.
    ///
    /// # Errors
    /// [`Fault::ImpossibleNumber`] with the field.
    pub fn check_numbers(&self) -> Result<(), Fault> {
        require("header.sequence", self.sequence, MAX_NUMBER)?;
        require("header.scan_id", self.scan_id, MAX_NUMBER)?;
        require("header.acquired_ns", self.acquired_ns, MAX_STAMP_NS)?;
        self.chain.iter().try_for_each(|stage| {
            [stage.woken_ns, stage.taken_ns, stage.computed_ns, stage.published_ns]
                .iter()
                .try_for_each(|stamp_ns| require("header.chain", *stamp_ns, MAX_STAMP_NS))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;

    const PERIOD: u64 = 100_000_000;

    fn header(scan_id: u64, acquired_ns: u64) -> Header {
        Header { scan_id, acquired_ns, ..Header::default() }
    }

    #[test]
    fn a_scan_can_be_as_far_ahead_as_the_scanner_can_have_come() {
        let known = KnownScan::of(&header(25, 10 * PERIOD), 10 * PERIOD + 40_000_000);
        let judge = |scan_id, periods: u64| {
            let (acquired_ns, now_ns) = ((10 + periods) * PERIOD, (10 + periods) * PERIOD + 40_000_000);
            known.judge(&header(scan_id, acquired_ns), now_ns, 0, PERIOD)
        };
        // One period later: four scans, two that were skipped, and the next.
        assert_eq!(judge(32, 1), Ok(()));
        let fault = Fault::ImpossibleNumber { field: "header.scan_id", value: 33, highest: 32 };
        assert_eq!(judge(33, 1), Err(fault));
        assert_eq!((judge(1025, 1).is_err(), judge(26, 1), judge(0, 1)), (true, Ok(()), Ok(())));
        assert_eq!((judge(1025, 250), judge(1025, 249).is_err()), (Ok(()), true), "it takes its time");
    }

    #[test]
    fn scans_that_waited_together_are_possible_and_a_stamp_of_the_future_earns_nothing() {
        let known = KnownScan::of(&header(25, 10 * PERIOD), 20 * PERIOD);
        assert_eq!(known.judge(&header(35, 20 * PERIOD), 20 * PERIOD, 0, PERIOD), Ok(()));
        let far = header(35, 1_000 * PERIOD);
        assert!(known.judge(&far, 10 * PERIOD, 0, PERIOD).is_err());
    }

    #[test]
    fn the_first_scans_follow_the_start() {
        let known = KnownScan::start(7 * PERIOD);
        assert_eq!(known.judge(&header(1, 7 * PERIOD), 7 * PERIOD, 0, PERIOD), Ok(()));
        assert!(known.judge(&header(1001, 7 * PERIOD), 8 * PERIOD, 0, PERIOD).is_err());
    }

    #[test]
    fn no_number_overflows() {
        for scan_id in [0, 1, 1 << 63, u64::MAX - 1, u64::MAX] {
            for time_ns in [0, 1 << 63, u64::MAX] {
                let known = KnownScan::of(&header(scan_id, time_ns), time_ns);
                assert!(known.highest(u64::MAX, u64::MAX, u64::MAX, 0) >= scan_id);
                assert!(highest_sequence(scan_id, time_ns) >= scan_id);
            }
        }
    }

    #[test]
    fn a_publisher_can_have_used_a_number_per_microsecond() {
        assert_eq!(require_sequence(5 + 4096 + 100_000, 5, 100_000_000), Ok(()));
        assert!(require_sequence(6 + 4096 + 100_000, 5, 100_000_000).is_err());
    }

    #[test]
    fn numbers_that_no_scan_can_have_are_named() {
        let mut header = header(MAX_NUMBER, MAX_STAMP_NS);
        header.sequence = MAX_NUMBER;
        assert_eq!(header.check_numbers(), Ok(()));
        let field = |header: &Header| match header.check_numbers() {
            Err(Fault::ImpossibleNumber { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(field(&Header { sequence: MAX_NUMBER + 1, ..header }), "header.sequence");
        assert_eq!(field(&Header { scan_id: 1 << 63, ..header }), "header.scan_id");
        assert_eq!(field(&Header { acquired_ns: u64::MAX, ..header }), "header.acquired_ns");
        header.stage_mut(Role::Actuator).published_ns = 1 << 63;
        assert_eq!(field(&header), "header.chain");
    }
}
