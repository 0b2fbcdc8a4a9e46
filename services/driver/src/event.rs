//! What a connection to a robot reports to its driver.

use shared_types::Device;

use crate::beams::SweepRanges;
use crate::guard::Orders;
use crate::motion::{BaseState, Convention};

/// What a connection reports.
#[derive(Debug)]
pub enum RobotEvent {
    /// Base and scanner are there; orders may be given.
    Connected(Orders),
    /// The state of the base.
    State {
        /// What it reports.
        state: BaseState,
        /// Time stamp of the robot [s].
        time_s: f64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// A sweep.
    Sweep {
        /// Its ranges, by beam of a scan [mm].
        ranges_mm: SweepRanges,
        /// Time stamp of the robot [s].
        time_s: f64,
        /// Duration of the sweep, where the robot reports it [ns].
        sweep_ns: Option<u64>,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// A scan of a scanner at this computer.
    Scan {
        /// Its ranges, by beam [mm].
        ranges_mm: SweepRanges,
        /// The ranges were damaged on the way, and are all zero.
        is_missing: bool,
        /// Time of the front beam, on CLOCK_MONOTONIC [ns].
        front_ns: u64,
        /// Duration of the sweep [ns].
        sweep_ns: u64,
        /// When it arrived, on CLOCK_MONOTONIC [ns].
        arrived_ns: u64,
    },
    /// The state of a scanner with a connection of its own has changed.
    Scanner(Device),
    /// There is no connection, and why.
    Lost(String),
}

/// A robot behind a connection.
pub trait ForeignRobot {
    /// The next event, if there is one; never waits.
    fn next(&mut self) -> Option<RobotEvent>;
}

/// What a driver has to know about a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotSettings {
    /// How it is commanded, and how it reports.
    pub convention: Convention,
    /// Smallest time from the stamp of a state of the base to its arrival here [s].
    pub delay_s: f64,
    /// A state so much older than a sweep is moved on to it; an older one is waited for [s].
    pub ahead_s: f64,
    /// Time stamp of a scan minus the time of its front beam [s].
    pub stamp_offset_s: f64,
    /// Duration of a sweep, where the robot does not report it [s].
    pub sweep_s: f64,
    /// Whether the scanner has a connection of its own.
    pub has_scanner: bool,
}
