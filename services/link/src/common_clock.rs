//! The common clock at one host: the own one at the host of the orchestrator, a followed one everywhere else.
//!
//! The first sample of a scan that is mapped here, from or to other hosts, decides by which offset: all samples of the scan
//! are mapped by it. So the stamps of a scan that was there and back add up to the nanosecond, and one number says how
//! they were mapped.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::clock::{HostClock, Offset};

/// Scans whose offsets are remembered: those that samples on the way may belong to, and many before.
const SCANS: usize = 256;

/// The common clock.
#[derive(Debug)]
pub(crate) enum CommonClock {
    /// Ours is the common clock.
    Own,
    /// It is followed by probes of stamps.
    Followed(Box<Mutex<Followed>>),
}

/// A clock that is followed, and what was made of it.
#[derive(Debug)]
pub(crate) struct Followed {
    /// The clock.
    pub(crate) clock: HostClock,
    /// The offset of each scan, and how often the clock had been lost before.
    scans: [Option<(u64, i64, u64)>; SCANS],
}

impl CommonClock {
    /// The common clock of a host that is not the orchestrator's.
    pub(crate) fn followed() -> Self {
        Self::Followed(Box::new(Mutex::new(Followed { clock: HostClock::new(), scans: [None; SCANS] })))
    }

    /// What is to be added to our time; `None` while the clock is not locked.
    pub(crate) fn offset(&self, now_ns: u64) -> Option<Offset> {
        self.following().map_or(Some(Offset::default()), |followed| followed.clock.offset(now_ns))
    }

    /// What is to be added to the times of a sample of a scan; `None` while the clock is not locked.
    pub(crate) fn offset_of(&self, scan_id: u64, now_ns: u64) -> Option<Offset> {
        self.following().map_or(Some(Offset::default()), |mut followed| followed.offset_of(scan_id, now_ns))
    }

    /// The same for a scan of which a sample was mapped already; `None` for others.
    pub(crate) fn known(&self, scan_id: u64, now_ns: u64) -> Option<Offset> {
        self.following().map_or(Some(Offset::default()), |followed| {
            followed.with_bound(followed.of_scan(scan_id)?, now_ns)
        })
    }

    /// The clock that follows, unless ours is the common one.
    pub(crate) fn following(&self) -> Option<MutexGuard<'_, Followed>> {
        match self {
            Self::Own => None,
            Self::Followed(clock) => Some(clock.lock().unwrap_or_else(PoisonError::into_inner)),
        }
    }
}

impl Followed {
    fn of_scan(&self, scan_id: u64) -> Option<i64> {
        let known = self.scans[(scan_id % SCANS as u64) as usize];
        // One from before the clock was lost is of another clock.
        let (_, offset_ns, _) = known.filter(|(of, _, lost)| (*of, *lost) == (scan_id, self.clock.lost()))?;
        Some(offset_ns)
    }

    fn offset_of(&mut self, scan_id: u64, now_ns: u64) -> Option<Offset> {
        let offset_ns = match self.of_scan(scan_id) {
            Some(known) => known,
            None => self.clock.offset(now_ns)?.offset_ns,
        };
        self.scans[(scan_id % SCANS as u64) as usize] = Some((scan_id, offset_ns, self.clock.lost()));
        self.with_bound(offset_ns, now_ns)
    }

    /// An offset of before, with what it may be wrong by now: the clock in use has been slewed since.
    fn with_bound(&self, offset_ns: i64, now_ns: u64) -> Option<Offset> {
        let now = self.clock.offset(now_ns)?;
        Some(Offset { offset_ns, bound_ns: now.bound_ns + now.offset_ns.abs_diff(offset_ns) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{PROBES, Probe};

    const AHEAD_NS: u64 = 5_000_000_000;

    /// Probes of a clock that is ahead by so much, from a time on.
    fn probe(clock: &CommonClock, from_ns: u64, ahead_ns: u64) {
        for count in 0..PROBES as u64 {
            let sent_ns = from_ns + count * 10_000_000;
            let there_ns = sent_ns + ahead_ns + 10_000;
            clock.following().unwrap().clock.probe(Probe {
                sent_ns,
                received_ns: there_ns,
                answered_ns: there_ns,
                returned_ns: sent_ns + 20_000,
            });
        }
    }

    #[test]
    fn all_samples_of_a_scan_have_the_offset_of_its_first_one() {
        let clock = CommonClock::followed();
        assert_eq!((clock.offset_of(7, 1), clock.known(7, 1)), (None, None), "not locked");
        probe(&clock, 0, AHEAD_NS);
        let first = clock.offset_of(7, 400_000_000).unwrap();
        // The clock turns out to be half a millisecond apart from what was believed.
        probe(&clock, 1_000_000_000, AHEAD_NS + 500_000);
        let now_ns = 3_000_000_000;
        let (now, again) = (clock.offset(now_ns).unwrap(), clock.offset_of(7, now_ns).unwrap());
        assert_eq!((first.offset_ns, again.offset_ns), (AHEAD_NS as i64, AHEAD_NS as i64));
        assert!(now.offset_ns > again.offset_ns, "{now:?}");
        assert_eq!(again.bound_ns, now.bound_ns + now.offset_ns.abs_diff(again.offset_ns));
        assert_eq!(clock.offset_of(8, now_ns), Some(now));
        assert_eq!(clock.known(8, now_ns), Some(now));
        // It is forgotten for a scan in its place.
        clock.offset_of(7 + SCANS as u64, now_ns).unwrap();
        assert_eq!(clock.known(7, now_ns), None);
    }

    #[test]
    fn the_offset_of_a_clock_that_was_lost_is_not_used_again() {
        let clock = CommonClock::followed();
        probe(&clock, 0, AHEAD_NS);
        clock.offset_of(7, 400_000_000).unwrap();
        probe(&clock, 1_000_000_000, 2 * AHEAD_NS);
        assert_eq!(clock.known(7, 1_400_000_000), None);
        assert_eq!(clock.offset_of(7, 1_400_000_000).unwrap().offset_ns, 2 * AHEAD_NS as i64);
    }

    #[test]
    fn at_the_host_of_the_orchestrator_no_time_is_moved() {
        let clock = CommonClock::Own;
        assert_eq!(
            (clock.offset(5), clock.offset_of(7, 5)),
            (Some(Offset::default()), Some(Offset::default()))
        );
    }
}
