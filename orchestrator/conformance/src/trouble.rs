//! Why a case does not pass.

use std::fmt::Display;

use runtime::RuntimeError;

/// What was measured when the requirement is met, else why it is not.
pub(crate) type Verdict = Result<String, Trouble>;

/// Why a case did not pass.
#[derive(Debug)]
pub(crate) enum Trouble {
    /// The implementation does not meet the requirement.
    Failed(String),
    /// The case did not see what it is about, so it proves nothing.
    NotObserved(String),
    /// The requirement does not apply to it.
    Skipped(String),
    /// The suite itself could not continue.
    Broken(anyhow::Error),
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
    if holds { Ok(()) } else { failed(reason()) }
}

/// Proves nothing, for `reason`, unless the case has `seen` what it is about.
pub(crate) fn observed(seen: bool, reason: impl FnOnce() -> String) -> Result<(), Trouble> {
    if seen { Ok(()) } else { Err(Trouble::NotObserved(reason())) }
}

/// What was measured: the case passes with it if the requirement `holds`, else it fails with it.
pub(crate) fn passed_if(holds: bool, measured: String) -> Verdict {
    if holds { Ok(measured) } else { failed(measured) }
}

/// Fails the case.
pub(crate) fn failed<T>(reason: impl Display) -> Result<T, Trouble> {
    Err(Trouble::Failed(reason.to_string()))
}

/// Leaves the case out.
pub(crate) fn skipped<T>(reason: impl Display) -> Result<T, Trouble> {
    Err(Trouble::Skipped(reason.to_string()))
}
