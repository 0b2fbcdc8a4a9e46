//! What a suite found: a table for people, JSON for programs.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::case::{CaseOutcome, Entry, RequirementLevel, Trouble, Verdict};

/// The result of one suite.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SuiteReport {
    /// Role that the implementation was tested in.
    pub role: String,
    /// The implementation: its command, or the name of a built-in one.
    pub command: String,
    /// Cases that were passed.
    pub passed: usize,
    /// Required cases that were not.
    pub failed: usize,
    /// Recommended cases that were not.
    pub not_recommended: usize,
    /// Cases, required and recommended, that did not see what they are about.
    pub not_observed: usize,
    /// Cases that do not apply.
    pub skipped: usize,
    /// All cases in the order in which they were played.
    pub cases: Vec<CaseReport>,
}

/// The result of one case.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaseReport {
    /// Its name.
    pub name: String,
    /// Whether it is required.
    pub level: RequirementLevel,
    /// How it ended.
    pub outcome: CaseOutcome,
    /// What was measured, or why it did not pass.
    pub reason: String,
    /// What is required.
    pub requirement: String,
}

impl SuiteReport {
    /// A report without cases.
    pub(crate) fn new(role: &str, command: &str) -> Self {
        Self { role: role.to_owned(), command: command.to_owned(), ..Self::default() }
    }

    /// Adds a case.
    ///
    /// # Errors
    /// When the suite itself could not continue.
    pub(crate) fn add(&mut self, entry: &Entry, verdict: Verdict) -> anyhow::Result<&CaseReport> {
        let (outcome, reason) = match verdict {
            Ok(reason) => (CaseOutcome::Passed, reason),
            Err(Trouble::Failed(reason)) => (CaseOutcome::Failed, reason),
            Err(Trouble::NotObserved(reason)) => (CaseOutcome::NotObserved, reason),
            Err(Trouble::Skipped(reason)) => (CaseOutcome::Skipped, reason),
            Err(Trouble::Broken(error)) => return Err(error),
        };
        match (outcome, entry.level) {
            (CaseOutcome::Passed, _) => self.passed += 1,
            (CaseOutcome::Skipped, _) => self.skipped += 1,
            (CaseOutcome::NotObserved, _) => self.not_observed += 1,
            (CaseOutcome::Failed, RequirementLevel::Required) => self.failed += 1,
            (CaseOutcome::Failed, RequirementLevel::Recommended) => self.not_recommended += 1,
        }
        let (name, requirement) = (entry.name.clone(), entry.requirement.clone());
        self.cases.push(CaseReport { name, level: entry.level, outcome, reason, requirement });
        Ok(&self.cases[self.cases.len() - 1])
    }

    /// The last line: how many passed.
    pub(crate) fn summary(&self) -> String {
        let Self { role, passed, failed, not_recommended, not_observed, skipped, .. } = self;
        let verdict = match (*failed, self.is_met()) {
            (_, true) => "may fill the role",
            (0, false) => "was not seen to meet all that is required of the role",
            (_, false) => "does not meet what is required of the role",
        };
        format!(
            "{passed} passed, {failed} required and {not_recommended} recommended failed, {not_observed} not observed, \
             {skipped} skipped: it {verdict} {role}"
        )
    }

    /// Whether all required cases that apply have passed.
    pub(crate) fn is_met(&self) -> bool {
        let is_missed = |case: &CaseReport| {
            case.level == RequirementLevel::Required
                && matches!(case.outcome, CaseOutcome::Failed | CaseOutcome::NotObserved)
        };
        !self.cases.iter().any(is_missed)
    }
}

impl fmt::Display for CaseReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (outcome, level) = (self.outcome.name(), self.level.name());
        write!(formatter, "{outcome:<14}{:<28}{level:<13}{}", self.name, self.reason)?;
        if matches!(self.outcome, CaseOutcome::Failed | CaseOutcome::NotObserved) {
            write!(formatter, "\n{:<14}{level}: {}", "", self.requirement)?;
        }
        Ok(())
    }
}
