//! Hokuyo laser scanners: the protocol SCIP 2.0, and a source of scans for drivers.
//!
//! [`ScannerConnection`] connects to a scanner, starts it, and returns [`Scan`](shared_types::Scan)s whose stamps are
//! on CLOCK_MONOTONIC. It restarts a scanner that is silent, and connects again when the connection is lost:
//!
//! ```no_run
//! # fn now_ns() -> u64 { 0 }
//! # fn main() -> Result<(), urg::UrgError> {
//! let config = urg::ScannerConfig::new(urg::ScannerPlace::parse("/dev/ttyACM0")?);
//! let mut source = urg::ScannerConnection::open(config, now_ns);
//! let mut scan = shared_types::Scan::default();
//! loop {
//!     match source.next(50_000_000, &mut scan)? {
//!         Some(reading) => println!("{} mm ahead, +-{} ns", scan.ranges_mm[340], reading.error_ns),
//!         None => println!("{}: {}", source.state().name(), source.message()),
//!     }
//! }
//! # }
//! ```
//!
//! Below it, each part can be used alone: [`Parser`] reads replies, [`ScipCommand`] writes commands, [`Resampling`]
//! turns the ranges of any model into beams, and [`ScannerSession`] is the conversation with a scanner, without input,
//! output or clock. [`ScannerEmulator`] is a scanner with faults, for tests and for a first try without a scanner;
//! [`Port`] connects it.
//!
//! Source: Hokuyo, "URG series communication protocol specification SCIP 2.0", C-42-03320B.

mod coding;
mod command;
mod emulator;
mod identity;
mod link;
mod model;
mod parser;
mod place;
mod port;
mod resampling;
mod session;
mod source;
mod start;
mod state;
mod status;

pub use coding::{checksum, decode, encode, verified};
pub use command::{Coding, Measurement, ScipCommand};
pub use device_clock::ClockEvent;
pub use emulator::{DeviceFault, ScannerEmulator};
pub use identity::ScannerIdentity;
pub use model::{SensorParameters, fields};
pub use parser::{Completed, MAX_RANGES, Parser, ReplyFault};
pub use place::{ScannerConfig, ScannerPlace};
pub use port::Port;
pub use resampling::{NOT_MEASURED, Resampling};
pub use session::ScannerSession;
pub use source::ScannerConnection;
pub use state::{Counters, Reading, SourceState};
pub use status::ScipStatus;

/// Why a scanner can't be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UrgError {
    /// A parameter of the model is missing or impossible.
    #[error("PP of the scanner: {key} = {value} is not allowed: {allowed}")]
    Parameter {
        /// Its name in the reply.
        key: &'static str,
        /// Its value.
        value: String,
        /// What is allowed.
        allowed: String,
    },
    /// The scanner does not see all that the stages analyse.
    #[error(
        "{model} measures from {right_deg:.1} to {left_deg:.1} deg; at least {allowed_right_deg:.1} to \
         {allowed_left_deg:.1} deg are allowed"
    )]
    Coverage {
        /// Name of the model.
        model: String,
        /// Its first beam [deg].
        right_deg: f64,
        /// Its last beam [deg].
        left_deg: f64,
        /// Largest first beam [deg].
        allowed_right_deg: f64,
        /// Smallest last beam [deg].
        allowed_left_deg: f64,
    },
    /// The scanner is too fast or too slow.
    #[error(
        "{model} measures {scanner_hz:.2} scans a second; rate_hz = {rate_hz} allows {low_hz:.2} to {high_hz:.2}"
    )]
    Rate {
        /// Name of the model.
        model: String,
        /// Its rate [Hz].
        scanner_hz: f64,
        /// Smallest rate [Hz].
        low_hz: f64,
        /// Largest rate [Hz].
        high_hz: f64,
        /// Rate of the system [Hz].
        rate_hz: f64,
    },
    /// The place of the scanner is neither a device nor an address.
    #[error("scanner {0:?} is not allowed: a device as /dev/ttyACM0, or HOST:PORT as 192.168.0.10:10940")]
    Place(String),
}
