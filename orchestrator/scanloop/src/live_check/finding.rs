//! The result of one check.

use std::fmt;

use serde::Serialize;

/// How a check ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Outcome {
    /// The value is allowed.
    Ok,
    /// The value is not allowed.
    Failed,
    /// It could not be measured, for the reason in `measured`.
    Skipped,
}

/// The result of one check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Finding {
    /// Name of the check.
    pub name: &'static str,
    /// How it ended.
    pub outcome: Outcome,
    /// What was measured, with its unit, or why it was not.
    pub measured: String,
    /// What is allowed; empty when it was skipped.
    pub allowed: String,
}

impl Finding {
    /// A measured value.
    pub(super) fn of(
        name: &'static str,
        is_allowed: bool,
        measured: impl Into<String>,
        allowed: impl Into<String>,
    ) -> Self {
        let outcome = if is_allowed { Outcome::Ok } else { Outcome::Failed };
        Self { name, outcome, measured: measured.into(), allowed: allowed.into() }
    }

    /// A check that was not made.
    pub(super) fn skipped(name: &'static str, reason: impl Into<String>) -> Self {
        Self { name, outcome: Outcome::Skipped, measured: reason.into(), allowed: String::new() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let outcome = match self.outcome {
            Outcome::Ok => "ok",
            Outcome::Failed => "failed",
            Outcome::Skipped => "skipped",
        };
        write!(formatter, "{outcome:<8} {:<9} {}", self.name, self.measured)?;
        if self.allowed.is_empty() { Ok(()) } else { write!(formatter, " (allowed: {})", self.allowed) }
    }
}
