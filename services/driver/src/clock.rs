//! The clock of the server, mapped to CLOCK_MONOTONIC.
//!
//! Drivers stamp with the time of day, Stage with its simulated time. Both are seconds as a number of 64 bits.

use device_clock::{ClockEvent, ClockSettings, DeviceClock};

/// Largest stamp that is used [s]: a hundred years.
const MAX_S: f64 = 3.2e9;
/// Times of day have microseconds. State and sweep of one stamp must not be told apart by a coarser tick.
const RESOLUTION_NS: u64 = 1_000;

/// The clock of one server.
#[derive(Debug)]
pub struct ServerClock(DeviceClock);

impl ServerClock {
    /// A clock of which nothing is known but the smallest time from a stamp to the arrival of its message [s].
    pub fn new(delay_s: f64) -> Self {
        let delay_ns = (delay_s * 1e9) as u64;
        Self(DeviceClock::new(ClockSettings {
            delay_ns,
            resolution_ns: RESOLUTION_NS,
            ..ClockSettings::nanoseconds()
        }))
    }

    /// Maps the stamp of a message that arrived at `arrived_ns`; `None` for one that was overtaken by others [ns].
    pub fn arrival(&mut self, time_s: f64, arrived_ns: u64) -> Option<u64> {
        let mapped = self.0.arrival(ticks(time_s), arrived_ns);
        (mapped.event != ClockEvent::Overtaken).then(|| mapped.time_ns.min(arrived_ns))
    }

    /// Maps the stamp of another message of the same server; `None` before the first [`Self::arrival`].
    pub fn map(&self, time_s: f64, arrived_ns: u64) -> Option<u64> {
        self.0.map(ticks(time_s), arrived_ns).map(|mapped| mapped.time_ns.min(arrived_ns))
    }
}

/// A stamp in nanoseconds; 0 for one that is no time.
fn ticks(time_s: f64) -> u64 {
    if (0.0..=MAX_S).contains(&time_s) { (time_s * 1e9) as u64 } else { 0 }
}
