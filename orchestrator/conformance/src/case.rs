//! What a case is and how it can end.

use serde::{Deserialize, Serialize};

use super::suite::{Setup, Suite};
use super::test_bench::TestBench;

pub(crate) use self::Play::{After, Own, Started};
pub(crate) use super::trouble::{Tried, Trouble, Verdict, failed, observed, passed_if, require};

/// One requirement and the function that finds out whether it is met.
pub(crate) struct Case {
    pub(crate) entry: Entry,
    pub(crate) play: Play,
}

/// Plays a case on a test bench.
type OnBench = fn(&mut TestBench<'_>) -> Verdict;

/// How a case is played.
#[derive(Clone, Copy)]
pub(crate) enum Play {
    /// On a test bench whose candidate was started with the setup of the case.
    Started(OnBench),
    /// The same, after something that must succeed before.
    After(fn(&mut TestBench<'_>) -> Tried, OnBench),
    /// On test benches of its own.
    Own(fn(&Suite) -> Verdict),
}

/// A case as `cases.toml` describes it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Entry {
    /// Name, unique within the suite of a role.
    pub(crate) name: String,
    /// Whether an implementation without it may be used.
    pub(crate) level: RequirementLevel,
    /// How its test bench is set up.
    #[serde(default)]
    pub(crate) setup: Setup,
    /// What is required, in one sentence.
    pub(crate) requirement: String,
    /// What would happen to the robot or its user otherwise.
    pub(crate) because: String,
}

impl Case {
    /// Plays it.
    pub(crate) fn play(&self, suite: &Suite) -> Verdict {
        let started = || suite.started(self.entry.setup);
        match self.play {
            Started(play) => play(&mut started()?),
            After(before, play) => started().and_then(|mut bench| {
                before(&mut bench)?;
                play(&mut bench)
            }),
            Own(play) => play(suite),
        }
    }

    /// How often it may be tried.
    ///
    /// A machine that is too busy to run a process within three periods spoils a case in real time. In lock-step
    /// nothing depends on the machine.
    pub(crate) fn tries(&self) -> u32 {
        if self.entry.setup.lockstep { 1 } else { 3 }
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
