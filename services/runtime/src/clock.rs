//! The clock of a process: monotonic, or simulated by the stamps of the samples in lock-step.

use std::cell::Cell;

use rustix::time::Timespec;

/// Nanoseconds of CLOCK_MONOTONIC.
pub fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// Nanoseconds of CLOCK_BOOTTIME, which also counts while the machine is suspended.
pub fn boottime_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// A time in nanoseconds as the kernel takes it.
pub(crate) fn timespec(time_ns: u64) -> Timespec {
    let (seconds, rest) = (time_ns / 1_000_000_000, time_ns % 1_000_000_000);
    Timespec { tv_sec: seconds.cast_signed(), tv_nsec: rest.cast_signed() }
}

/// Time as the loop sees it.
///
/// In lock-step no process reads the machine's clock. The time is the publication time of the newest scan, so a run is
/// the same on every machine.
#[derive(Debug)]
pub enum Clock {
    /// CLOCK_MONOTONIC.
    Monotonic,
    /// The publication time of the newest scan seen [ns].
    Simulated(Cell<u64>),
}

impl Clock {
    /// A simulated clock at zero.
    pub fn simulated() -> Self {
        Self::Simulated(Cell::new(0))
    }

    /// Whether time is simulated.
    pub fn is_simulated(&self) -> bool {
        matches!(self, Self::Simulated(_))
    }

    /// The time [ns].
    pub fn now_ns(&self) -> u64 {
        match self {
            Self::Monotonic => monotonic_ns(),
            Self::Simulated(now) => now.get(),
        }
    }

    /// Moves simulated time forward to `time_ns`, never back. Has no effect on the monotonic clock.
    pub fn advance_to(&self, time_ns: u64) {
        if let Self::Simulated(now) = self {
            now.set(now.get().max(time_ns));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulated_time_never_goes_back() {
        let clock = Clock::simulated();
        clock.advance_to(7);
        clock.advance_to(3);
        assert_eq!(clock.now_ns(), 7);
    }
}
