//! A kernel timer that is set before a process sleeps, so that the sleep itself is cheap.
//!
//! A sleep that ends before all other timers of a processor makes the kernel program the hardware timer. In a virtual
//! machine this takes longer than a hop. A robot falls asleep while its scan travels to the wheels, on a processor
//! that the next process needs. So it sets this timer when its work begins; the later sleep finds the hardware timer
//! programmed.
//!
//! Where the timer is missing, the sleep still ends in time; only the cost comes later.

use std::os::fd::OwnedFd;

use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create, timerfd_settime,
};

use crate::clock::timespec;

/// One timer of CLOCK_MONOTONIC that is never read.
pub(crate) struct Alarm(Option<OwnedFd>);

impl Alarm {
    pub(crate) fn new() -> Self {
        Self(timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK).ok())
    }

    /// Sets the timer to a time [ns] instead of the one before.
    pub(crate) fn set(&self, time_ns: u64) {
        let Some(timer) = &self.0 else { return };
        let value = Itimerspec { it_interval: timespec(0), it_value: timespec(time_ns) };
        let _ = timerfd_settime(timer, TimerfdTimerFlags::ABSTIME, &value);
    }
}

#[cfg(test)]
mod tests {
    use rustix::event::{PollFd, PollFlags, poll};

    use super::*;
    use crate::monotonic_ns;

    #[test]
    fn the_timer_ends_at_the_time_that_was_set_last() {
        let alarm = Alarm::new();
        let timer = alarm.0.as_ref().unwrap();
        let far = timespec(60_000_000_000);
        let first_ns = monotonic_ns() + 1_000_000;
        let second_ns = first_ns + 2_000_000;
        alarm.set(first_ns);
        alarm.set(second_ns);
        assert_eq!(poll(&mut [PollFd::new(timer, PollFlags::IN)], Some(&far)), Ok(1));
        assert!(monotonic_ns() >= second_ns);
    }
}
