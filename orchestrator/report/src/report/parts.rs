//! Small parts of the report: margins, the scanner, the obstacle of a stop, differences between scenario and description.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use shared_types::{Blocking, ScannerHealth};

/// The recording of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordingReport {
    /// The file.
    pub file: PathBuf,
    /// Its length.
    pub bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// Samples of the drive that are missing in it.
    pub lost: u64,
    /// Why the recording ended before the drive; empty if it did not.
    pub error: String,
}

impl fmt::Display for RecordingReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, bytes, samples, lost, error } = self;
        let megabytes = *bytes as f64 * 1e-6;
        write!(formatter, "{}, {megabytes:.2} MB, {samples} samples, {lost} lost", file.display())?;
        if error.is_empty() { Ok(()) } else { write!(formatter, "; incomplete: {error}") }
    }
}

/// A goal that changed while the robot drove.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct GoalChange {
    /// The first scan for which it counted.
    pub from_scan: u64,
    /// Which goal of the drive, from 0.
    pub goal: usize,
    /// Where it is since [m].
    pub x_m: f64,
    /// Where it is since [m].
    pub y_m: f64,
}

/// From when on another drove.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DriverChange {
    /// The first scan that was answered so.
    pub from_scan: u64,
    /// Driven time then [s].
    pub from_s: f64,
    /// `controller`, `person` or `nobody`.
    pub driven_by: String,
}

/// The clearance that the driven plans kept, as the mean of each part over all commands that drive [m].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct MarginReport {
    /// Distance kept in any case [m].
    pub base: f64,
    /// Uncertainty of the pose [m].
    pub pose: f64,
    /// A share of speed times the age of the data [m].
    pub latency: f64,
    /// Difference between the robot and its description [m].
    pub model: f64,
    /// Uncertainty of the described obstacles [m].
    pub perception: f64,
}

impl MarginReport {
    /// The clearance [m].
    pub fn sum(&self) -> f64 {
        let Self { base, pose, latency, model, perception } = *self;
        base + pose + latency + model + perception
    }
}

impl fmt::Display for MarginReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { base, pose, latency, model, perception } = self;
        write!(formatter, "{:.1} cm: ", 100.0 * self.sum())?;
        let parts = [("base", base), ("pose", pose), ("latency", latency), ("model", model)];
        parts.iter().try_for_each(|(name, part)| write!(formatter, "{name} {:.1} + ", 100.0 * **part))?;
        write!(formatter, "perception {:.1}", 100.0 * perception)
    }
}

/// How the scanner was, by the evidence of the obstacle description (docs/obstacles.md).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ScannerReport {
    /// Mean share of the window's beams with a valid range; a missing scan has none.
    pub valid_share: f64,
    /// Scans in the state `degraded`.
    pub degraded_scans: u64,
    /// Scans in the state `blind`.
    pub blind_scans: u64,
    /// Scans in the state `stuck`.
    pub stuck_scans: u64,
    /// Scans in the state `contradictory`.
    pub contradictory_scans: u64,
}

impl fmt::Display for ScannerReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { valid_share, degraded_scans, blind_scans, stuck_scans, contradictory_scans } = *self;
        write!(formatter, "{:.1} % of beams valid", 100.0 * valid_share)?;
        let counts = [
            (degraded_scans, "degraded"),
            (blind_scans, "blind"),
            (stuck_scans, "stuck"),
            (contradictory_scans, "contradictory"),
        ];
        let mut seen = counts.iter().filter(|(count, _)| *count > 0);
        seen.try_for_each(|(count, state)| write!(formatter, ", {count} scans {state}"))
    }
}

/// The present state of the scanner.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScannerStatus {
    /// healthy, degraded, blind, stuck or contradictory.
    pub state: String,
    /// The state with the figures that explain it.
    pub explanation: String,
    /// Share of the window's beams with a valid range.
    pub valid_share: f64,
    /// Share of the returns that came where earlier scans predict them.
    pub returned_share: f64,
    /// Farthest distance ahead at which nothing that appears can be missed [m].
    pub seen_ahead_m: f64,
}

impl From<ScannerHealth> for ScannerStatus {
    fn from(health: ScannerHealth) -> Self {
        Self {
            state: health.state().name().to_owned(),
            explanation: health.to_string(),
            valid_share: health.valid_share,
            returned_share: health.returned_share,
            seen_ahead_m: health.seen_ahead_m,
        }
    }
}

/// The obstacle that the wheels were blocked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BlockingReport {
    /// Identity of the obstacle.
    pub id: u32,
    /// Position of its centre along the track [m].
    pub x_m: f64,
    /// Lateral position of its centre [m].
    pub y_m: f64,
    /// The widest gap past it, negative when there is none [m].
    pub gap_m: f64,
    /// The gap that the robot needs there [m].
    pub needed_m: f64,
}

impl From<Blocking> for BlockingReport {
    fn from(blocking: Blocking) -> Self {
        let Blocking { x_m, y_m, gap_m, needed_m, id, .. } = blocking;
        Self { id, x_m, y_m, gap_m, needed_m }
    }
}

impl fmt::Display for BlockingReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, x_m, y_m, gap_m, needed_m } = *self;
        Blocking { x_m, y_m, gap_m, needed_m, id, reserved: 0 }.fmt(formatter)
    }
}

/// A property in which the scenario differs from the description of the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DifferenceReport {
    /// Its key in both tables.
    pub key: String,
    /// `robot.KEY` of the scenario, a number; or `track.surroundings`, a name.
    pub truth: Value,
    /// `vehicle.KEY` of the system.
    pub believed: Value,
}

/// A process beside the loop.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct CompanionReport {
    /// Its name.
    pub name: String,
    /// Its command.
    pub command: String,
    /// Starts after the first.
    pub restarts: u32,
    /// What it did at the end.
    pub state: String,
    /// Samples of its first topic that its last process has taken.
    pub taken: u64,
    /// Of these, those that it was done with.
    pub answered: u64,
    /// Samples that it published.
    pub published: u64,
    /// Inputs dropped because of their content.
    pub invalid: u64,
    /// Inputs dropped because their writer was not in charge.
    pub foreign: u64,
    /// Inputs that never arrived.
    pub missed: u64,
    /// The scan from which on lock-step did not wait for it.
    pub left_lockstep_at_scan: Option<u64>,
}
