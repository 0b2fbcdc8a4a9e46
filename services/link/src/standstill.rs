//! Whether a host stood still: suspended, a virtual machine that was stopped, or a link that got no processor.
//!
//! A thread that wakes often compares times of CLOCK_BOOTTIME, which also counts while a machine is suspended. A gap that is
//! much longer than its sleep is time in which nothing ran here. A clock that stood still meanwhile does not fit its bound
//! afterwards, and is lost; until it is locked again no sample crosses.

/// Shorter gaps are those of a busy machine [ns].
const GAP_NS: u64 = 500_000_000;

/// The time that was lost so far.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Standstill {
    before_ns: Option<u64>,
    lost_ns: u64,
}

impl Standstill {
    /// Takes in the time of a thread that has just slept for `slept_ns`; returns the length of a gap, if there was one [ns].
    pub(crate) fn wake(&mut self, boottime_ns: u64, slept_ns: u64) -> Option<u64> {
        let before_ns = self.before_ns.replace(boottime_ns)?;
        let gap_ns = boottime_ns.saturating_sub(before_ns).saturating_sub(slept_ns);
        self.lost_ns += if gap_ns > GAP_NS { gap_ns } else { 0 };
        (gap_ns > GAP_NS).then_some(gap_ns)
    }

    /// All gaps together [ms].
    pub(crate) fn lost_ms(&self) -> u64 {
        self.lost_ns / 1_000_000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_that_are_longer_than_those_of_a_busy_machine_add_up() {
        let mut standstill = Standstill::default();
        let times_s = [5.0, 5.1, 5.6, 7.7, 7.8, 9.0];
        let gaps = times_s.map(|time_s: f64| standstill.wake((time_s * 1e9) as u64, 100_000_000));
        let gap = |index: usize| gaps[index].map(|gap_ns| (gap_ns as f64 * 1e-8).round() as u64);
        assert_eq!([0, 1, 2, 3, 4, 5].map(gap), [None, None, None, Some(20), None, Some(11)]);
        assert_eq!(standstill.lost_ms() / 10, 310);
    }
}
