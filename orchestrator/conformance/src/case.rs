//! What a case is and how it can end.

use serde::{Deserialize, Serialize};

use super::suite::Suite;

pub(crate) use super::trouble::{Trouble, Verdict, failed, observed, passed_if, require, skipped};

/// One requirement and the function that finds out whether it is met.
#[derive(Clone, Copy)]
pub(crate) struct Case {
    /// Name, unique within the suite of a role.
    pub name: &'static str,
    /// Whether an implementation without it may be used.
    pub level: RequirementLevel,
    /// What is required, in one sentence.
    pub requirement: &'static str,
    /// What would happen to the robot or its user otherwise.
    pub why: &'static str,
    /// How often the case may be tried.
    pub tries: u32,
    /// Plays it.
    pub play: fn(&Suite) -> Verdict,
}

impl Case {
    /// A case in real time without which an implementation may not be used.
    ///
    /// It may be tried three times: a machine too busy to run a process within three periods spoils it.
    pub(crate) const fn required(name: &'static str, play: fn(&Suite) -> Verdict) -> Self {
        Self { name, level: RequirementLevel::Required, requirement: "", why: "", tries: 3, play }
    }

    /// A case in real time without which an implementation may be used.
    pub(crate) const fn recommended(name: &'static str, play: fn(&Suite) -> Verdict) -> Self {
        Self { level: RequirementLevel::Recommended, ..Self::required(name, play) }
    }

    /// The case in lock-step: it is tried once, because nothing depends on the machine.
    pub(crate) const fn in_lockstep(self) -> Self {
        Self { tries: 1, ..self }
    }

    /// The case with its requirement.
    pub(crate) const fn demands(self, requirement: &'static str) -> Self {
        Self { requirement, ..self }
    }

    /// The case with its reason.
    pub(crate) const fn because(self, why: &'static str) -> Self {
        Self { why, ..self }
    }
}

/// How much a requirement weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RequirementLevel {
    /// The loop is not safe or not complete without it.
    Required,
    /// The loop is better with it.
    Recommended,
}

/// How a case ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CaseOutcome {
    /// The requirement is met.
    Passed,
    /// It is not.
    Failed,
    /// What it is about did not happen, so nothing is known.
    NotObserved,
    /// It does not apply to this implementation.
    Skipped,
}

impl RequirementLevel {
    /// The name in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Required => "required",
            Self::Recommended => "recommended",
        }
    }
}

impl CaseOutcome {
    /// The name in reports.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "failed",
            Self::NotObserved => "not observed",
            Self::Skipped => "skipped",
        }
    }
}
