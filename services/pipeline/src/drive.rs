//! A whole run in one process.

use emulator::{Outcome, Referee};
use vehicle::Invalid;

use crate::{Pipeline, PipelineSettings, Step};

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveResult {
    /// How it ended.
    pub outcome: Outcome,
    /// Why, as text.
    pub reason: String,
    /// Scans until then.
    pub scans: u64,
}

/// Drives a scenario to its end; `observe` sees each scan.
///
/// # Errors
/// The first setting that is not allowed.
pub fn drive(settings: &PipelineSettings, mut observe: impl FnMut(&Step)) -> Result<DriveResult, Invalid> {
    let mut pipeline = Pipeline::new(settings)?;
    let mut referee = Referee::new(&settings.scenario);
    for scans in 1.. {
        let step = pipeline.step();
        observe(step);
        if let Some(outcome) = referee.observe(&step.truth, step.actuation.as_ref()) {
            return Ok(DriveResult { outcome, reason: referee.reason().to_owned(), scans });
        }
    }
    unreachable!("every scenario has a time-out that the referee keeps")
}
