//! Maps the stamps of a device to CLOCK_MONOTONIC, with an error bound.
//!
//! A scanner or a robot stamps its data with a clock of its own. The stages need the stamps on CLOCK_MONOTONIC. All
//! drivers use [`DeviceClock`] for that: it gets a stamp and the time at which it arrived, and returns the time of the
//! stamp on CLOCK_MONOTONIC.
//!
//! ```
//! use device_clock::{ClockSettings, DeviceClock};
//!
//! // A counter of milliseconds with 24 bits, as Hokuyo scanners have.
//! let mut clock = DeviceClock::new(ClockSettings::milliseconds_of_24_bits());
//! // The device answered 136 to a question asked at 2.000 s whose answer arrived at 2.004 s.
//! clock.round_trip(136, 2_000_000_000, 2_004_000_000);
//! // Data stamped 236 arrive 70 ms later than they were stamped.
//! let mapped = clock.arrival(236, 2_172_000_000);
//! assert!(mapped.time_ns.abs_diff(2_102_000_000) <= mapped.error_ns);
//! assert!(mapped.error_ns < 4_000_000);
//! ```
//!
//! # Method
//! Data arrive later than they are stamped, never earlier. So arrival minus stamp is the offset between the clocks plus
//! a delay, and its smallest values have the smallest delay. The newest of them gives the mapping ([`Envelope`]). The
//! smallest delay itself is not seen in these values. A round trip, in which the device answers with its time, gives
//! the offset alone, with an error of half of the round trip; the difference of both is the smallest delay. Without
//! round trips it is a setting.
//!
//! The error bound is half of the round trip, plus the resolution of the stamps (1 ms), plus 200 ppm of the age of the
//! values that are used: that is more than the drift between two crystals. When even the fastest samples differ, as on
//! a busy machine, twice their mean difference is added.
//!
//! # Assumptions
//! * The smallest delay does not change while the device is in use.
//! * The clocks drift by at most [`ClockSettings::max_drift_ppm`]. The drift is estimated, so that older values remain
//!   useful.
//! * Some samples arrive without additional delay: at least one within some seconds at 10 Hz.
//!
//! Messages may overtake each other: one whose stamp is before the newest has the event [`ClockEvent::Overtaken`],
//! changes nothing, and is to be dropped. A stamp that is so old that no delay explains it
//! ([`ClockSettings::max_overtaken_ns`]), and one that differs from its
//! expected value, start the mapping anew ([`ClockEvent`]). So does a stamp that went back when all samples of half a
//! second after it are late by the same time, of more than 100 ms. A jump back by less than [`ClockSettings::jump_ns`] is not
//! seen as one; the mapping follows it within three minutes. Not seen either is a device that restarts within a second
//! of its start: its data seem overtaken until they reach the newest stamp, and late after that, until they count as a
//! jump.

mod clock;
mod counter;
mod envelope;
mod set_back;
mod settings;

pub use clock::{ClockEvent, DeviceClock, Mapped};
pub use envelope::{Envelope, Line};
pub use settings::ClockSettings;
