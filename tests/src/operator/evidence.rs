//! What was observed of a trial from outside.

use std::path::{Path, PathBuf};

use report::Report;

use super::program::Ended;
use super::wheels::{Point, WheelsChange};

/// All that was observed of a trial.
#[derive(Debug, Default)]
pub struct TrialEvidence {
    /// The run has driven before anything was done to it.
    pub drove: bool,
    /// All programs that were started, in order.
    pub programs: Vec<Ended>,
    /// When signals were sent to a healthy orchestrator that stop its run [ns of CLOCK_MONOTONIC].
    pub ends_ns: Vec<u64>,
    /// Times in which no orchestrator lived or ran [ns of CLOCK_MONOTONIC].
    pub silences: Vec<OrchestratorOutage>,
    /// A robot was sent a signal that ends it at once.
    pub robot_killed: bool,
    /// A load had real-time priority.
    pub fifo: bool,
    /// What the robot of each run did, by the folder of its results.
    pub drives: Vec<DriveEvidence>,
    /// The truth of the first run.
    pub truth: Vec<Point>,
    /// Descriptions of what is left on the machine.
    pub left: Vec<String>,
    /// Text of all logs with a panic.
    pub panics: Vec<String>,
    /// Actions that were not possible, with the reason.
    pub skipped: Vec<String>,
    /// When the trial was over [ns of CLOCK_MONOTONIC].
    pub over_ns: u64,
}

/// A time without an orchestrator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OrchestratorOutage {
    /// It was killed or stopped.
    pub from_ns: u64,
    /// When another one started, or it continued; 0 while it lasts.
    pub to_ns: u64,
}

/// What is in a folder of results.
#[derive(Debug, Default)]
pub struct DriveEvidence {
    /// What the emulator wrote of its wheels.
    pub changes: Vec<WheelsChange>,
    /// The report.
    pub report: Option<Report>,
    /// The folder.
    pub folder: PathBuf,
}

impl DriveEvidence {
    /// Reads a folder of results.
    pub fn read(folder: &Path) -> Self {
        let log = std::fs::read(folder.join("logs/robot.log")).unwrap_or_default();
        Self {
            changes: super::wheels::changes(&String::from_utf8_lossy(&log)),
            report: Report::read(&folder.join("report.json")).ok(),
            folder: folder.to_path_buf(),
        }
    }
}

impl TrialEvidence {
    /// All calls of `scanloop stop`.
    pub fn stops(&self) -> impl Iterator<Item = &Ended> {
        self.programs.iter().filter(|program| program.name == "stop")
    }

    /// All orchestrators.
    pub fn orchestrators(&self) -> impl Iterator<Item = &Ended> {
        self.programs.iter().filter(|program| program.out.is_some())
    }
}
