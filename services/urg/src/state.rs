//! What a source of scans reports.

use device_clock::ClockEvent;

/// What a scanner and its connection do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SourceState {
    /// There is no connection.
    #[default]
    Connecting,
    /// The scanner is asked for its parameters and started.
    Starting,
    /// Scans come.
    Measuring,
    /// Scans came, and do not come any more.
    Stalled,
}

impl SourceState {
    /// Its name, as in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Connecting => "connecting",
            Self::Starting => "starting",
            Self::Measuring => "measuring",
            Self::Stalled => "stalled",
        }
    }
}

/// What has come about so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Scans with ranges.
    pub scans: u64,
    /// Scans that were dropped for a wrong checksum or number of ranges.
    pub broken: u64,
    /// Pieces of other bytes.
    pub garbage: u64,
    /// Starts of the scanner after the first one.
    pub restarts: u64,
    /// Stamps that counted backwards or jumped.
    pub clock_jumps: u64,
}

/// A scan was filled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// Error bound of the stamp [ns].
    pub error_ns: u64,
    /// When the last byte arrived [ns].
    pub arrived_ns: u64,
    /// The stamp of the scanner [ms, 24 bits].
    pub stamp_ms: u32,
    /// What the stamp shows about the clock of the scanner.
    pub event: ClockEvent,
    /// The ranges were damaged on the way: the scan is marked as missing and has none.
    pub is_missing: bool,
}
