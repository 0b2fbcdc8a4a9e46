//! Recomputes a recorded drive, stage by stage, and compares every output with the recorded one.
//!
//! Each stage gets the inputs that its recorded outputs answer, found by the stamps that every sample carries on from
//! its inputs: which pose and which scan a description of obstacles was made from, for example. So each stage is
//! checked alone, and a difference is reported where it arises. Time that a stage had read is in its samples too; what
//! is not is the moment at which the time budget of the solver ended, and a stage that can't be recomputed for this or
//! another reason is counted as skipped, with the reason.
//!
//! Compared are all bytes but those that depend on the clock and on the process: [`compare::NOT_COMPARED`].

pub mod compare;
mod drive;
mod stage;

use std::path::Path;

use console::exit::Failure;
use serde::Serialize;
use shared_types::Role;

use crate::compare::Difference;
pub use crate::drive::Drive;
use crate::stage::Findings;

/// This many differences are kept; all are counted.
pub const MAX_DIFFERENCES: usize = 20;

/// What is replayed.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The stages; all when empty.
    pub stages: Vec<Role>,
    /// The first scan.
    pub from: Option<u64>,
    /// The last scan.
    pub to: Option<u64>,
    /// Keys of the stages that are changed: `controller.horizon_s=2`.
    pub set: Vec<String>,
    /// Factor on the bounds of the agreement, with changed keys.
    pub tolerance: f64,
}

/// The result of a replay.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// Scans in the recording, within the limits.
    pub scans: u64,
    /// Outputs of the stages.
    pub samples: u64,
    /// Outputs that were recomputed.
    pub compared: u64,
    /// Outputs that could not be recomputed.
    pub skipped: u64,
    /// Outputs that are equal to the recorded ones.
    pub identical: u64,
    /// Outputs that are beyond the bounds of the agreement, with changed keys.
    pub beyond: u64,
    /// The first differences.
    pub differences: Vec<Difference>,
    /// Why outputs were skipped, and how many.
    pub reasons: Vec<Skipped>,
    /// Outputs of scans after the one that decided the outcome, in lock-step; they do not belong to the run.
    pub after_end: u64,
}

/// Outputs that could not be recomputed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// Their topic.
    pub topic: &'static str,
    /// The process that published them.
    pub incarnation: u32,
    /// Why.
    pub reason: String,
    /// How many.
    pub samples: u64,
}

impl Report {
    /// Whether every output that could be recomputed is equal to the recorded one.
    pub fn is_identical(&self) -> bool {
        self.compared > 0 && self.identical == self.compared
    }
}

/// Replays a recording.
///
/// # Errors
/// A file that can't be read, samples of another layout, keys that are not allowed; exit code 2.
pub fn replay(path: &Path, options: &Options) -> anyhow::Result<Report> {
    let mut drive = Drive::read(path)?;
    drive.set(&options.set).map_err(|reason| Failure::bad_input(format!("--set {reason}")))?;
    let stages: Vec<Role> = Role::ALL
        .iter()
        .copied()
        .filter(|role| options.stages.is_empty() || options.stages.contains(role))
        .collect();
    let drive = &drive;
    let found: Vec<anyhow::Result<Findings>> = std::thread::scope(|scope| {
        let threads: Vec<_> =
            stages.iter().map(|role| scope.spawn(move || stage::replay(*role, drive, options))).collect();
        let lost = || Err(anyhow::anyhow!("a stage ended with a panic"));
        threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| lost())).collect()
    });
    let mut report = Report { scans: drive.scans(options.from, options.to), ..Report::default() };
    for findings in found {
        findings?.add_to(&mut report);
    }
    report.differences.sort_by_key(|difference| difference.scan);
    report.differences.truncate(MAX_DIFFERENCES);
    if report.samples == 0 {
        let path = path.display();
        return Err(Failure::bad_input(format!("{path}: no output of these stages is in these scans")));
    }
    Ok(report)
}
