//! What a suite found: a table for people, JSON for programs.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::case::{Case, Level, Outcome, Trouble, Verdict};

/// The result of one suite.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
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
    pub level: Level,
    /// How it ended.
    pub outcome: Outcome,
    /// What was measured, or why it did not pass.
    pub reason: String,
    /// What is required.
    pub requirement: String,
}

impl Report {
    /// A report without cases.
    pub(crate) fn new(role: &str, command: &str) -> Self {
        let (role, command) = (role.to_owned(), command.to_owned());
        Self { role, command, passed: 0, failed: 0, not_recommended: 0, skipped: 0, cases: Vec::new() }
    }

    /// Adds a case.
    ///
    /// # Errors
    /// When the suite itself could not continue.
    pub(crate) fn add(&mut self, case: &Case, verdict: Verdict) -> anyhow::Result<&CaseReport> {
        let (outcome, reason) = match verdict {
            Ok(reason) => (Outcome::Passed, reason),
            Err(Trouble::Failed(reason)) => (Outcome::Failed, reason),
            Err(Trouble::Skipped(reason)) => (Outcome::Skipped, reason),
            Err(Trouble::Broken(error)) => return Err(error),
        };
        match (outcome, case.level) {
            (Outcome::Passed, _) => self.passed += 1,
            (Outcome::Skipped, _) => self.skipped += 1,
            (Outcome::Failed, Level::Required) => self.failed += 1,
            (Outcome::Failed, Level::Recommended) => self.not_recommended += 1,
        }
        self.cases.push(CaseReport {
            name: case.name.to_owned(),
            level: case.level,
            outcome,
            reason,
            requirement: case.requirement.to_owned(),
        });
        Ok(&self.cases[self.cases.len() - 1])
    }

    /// The last line: how many passed.
    pub(crate) fn summary(&self) -> String {
        let Self { role, passed, failed, not_recommended, skipped, .. } = self;
        let verdict =
            if *failed == 0 { "may fill the role" } else { "does not meet what is required of the role" };
        format!(
            "{passed} passed, {failed} required and {not_recommended} recommended failed, {skipped} skipped: it {verdict} {role}"
        )
    }
}

impl fmt::Display for CaseReport {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (outcome, level) = (self.outcome.name(), self.level.name());
        write!(formatter, "{outcome:<8}{:<28}{level:<13}{}", self.name, self.reason)?;
        if self.outcome == Outcome::Failed {
            write!(formatter, "\n{:<8}{level}: {}", "", self.requirement)?;
        }
        Ok(())
    }
}
