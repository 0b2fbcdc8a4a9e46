//! What a case is and how it can end.

use serde::{Deserialize, Serialize};

use super::suite::Suite;

pub(crate) use super::trouble::{Trouble, Verdict, failed, require, skipped};

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
