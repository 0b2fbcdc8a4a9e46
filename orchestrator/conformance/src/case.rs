//! What a case is and how it can end.

use std::fmt::Display;

use runtime::RuntimeError;
use serde::{Deserialize, Serialize};

use super::suite::Suite;

/// In real time a machine that is too busy for a process to run within three periods spoils a case.
pub(crate) const LIVE: u32 = 3;
/// In lock-step nothing depends on the machine.
pub(crate) const LOCKSTEP: u32 = 1;

/// One requirement and the play that finds out whether it is met.
#[derive(Clone, Copy)]
pub(crate) struct Case {
    /// Name, unique within the suite of a role.
    pub name: &'static str,
    /// Whether an implementation without it may be used.
    pub level: Level,
    /// What is required, in one sentence.
    pub requirement: &'static str,
    /// What would happen to the robot or its user otherwise.
    pub why: &'static str,
    /// How often the case may be tried, [`LIVE`] or [`LOCKSTEP`].
    pub tries: u32,
    /// Plays it.
    pub play: fn(&Suite) -> Verdict,
}

/// How much a requirement weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// The loop is not safe or not complete without it.
    Required,
    /// The loop is better with it.
    Recommended,
}

/// How a case ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The requirement is met.
    Passed,
    /// It is not.
    Failed,
    /// It does not apply to this implementation.
    Skipped,
}

/// What was measured when the requirement is met, else why it is not.
pub(crate) type Verdict = Result<String, Trouble>;

/// Why a case did not pass.
#[derive(Debug)]
pub(crate) enum Trouble {
    /// The implementation does not meet the requirement.
    Failed(String),
    /// The requirement does not apply to it.
    Skipped(String),
    /// The suite itself could not go on.
    Broken(anyhow::Error),
}

impl Level {
    /// The name in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Required => "required",
            Self::Recommended => "recommended",
        }
    }
}

impl Outcome {
    /// The name in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
        }
    }
}

impl From<anyhow::Error> for Trouble {
    fn from(error: anyhow::Error) -> Self {
        Self::Broken(error)
    }
}

impl From<RuntimeError> for Trouble {
    fn from(error: RuntimeError) -> Self {
        Self::Broken(error.into())
    }
}

impl From<std::io::Error> for Trouble {
    fn from(error: std::io::Error) -> Self {
        Self::Broken(error.into())
    }
}

/// Fails the case with `reason` unless `holds`.
pub(crate) fn require(holds: bool, reason: impl FnOnce() -> String) -> Result<(), Trouble> {
    if holds { Ok(()) } else { Err(Trouble::Failed(reason())) }
}

/// Fails the case.
pub(crate) fn failed<T>(reason: impl Display) -> Result<T, Trouble> {
    Err(Trouble::Failed(reason.to_string()))
}

/// Leaves the case out.
pub(crate) fn skipped<T>(reason: impl Display) -> Result<T, Trouble> {
    Err(Trouble::Skipped(reason.to_string()))
}
