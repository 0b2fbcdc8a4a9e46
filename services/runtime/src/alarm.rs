//! A timer that is set before its time is slept for.
//!
//! Idea: who falls asleep until a time, earlier than any other that is waited for, has the kernel program the timer of
//! the processor, which in a virtual machine takes longer than a hop. A robot falls asleep while its scan is on the way
//! to the wheels, on the processor that the next process needs. So it sets this timer for the end of its sleep when its
//! work begins; the sleep itself then finds the processor's timer programmed.
//!
//! Where this fails: without the timer the sleep ends as well, only the processor is programmed later.

use std::os::fd::OwnedFd;

use rustix::time::{
    Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create, timerfd_settime,
};

use crate::clock::timespec;

/// One timer of CLOCK_MONOTONIC. Nobody reads it.
pub(crate) struct Alarm(Option<OwnedFd>);

impl Alarm {
    pub(crate) fn new() -> Self {
        Self(timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::CLOEXEC | TimerfdFlags::NONBLOCK).ok())
    }

    /// Sets the timer to a time [ns]; the one before is forgotten.
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
