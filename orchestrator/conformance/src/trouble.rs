//! Why a case does not pass.

use std::fmt::Display;

/// What was measured when the requirement is met, else why it is not.
pub(crate) type Verdict = Tried<String>;
/// The result of a step of a case.
pub(crate) type Tried<T = ()> = Result<T, Trouble>;

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

impl<E: Into<anyhow::Error>> From<E> for Trouble {
    fn from(error: E) -> Self {
        Self::Broken(error.into())
    }
}

/// Fails the case with `reason` unless `holds`.
pub(crate) fn require<R: Display>(holds: bool, reason: impl FnOnce() -> R) -> Tried {
    if holds { Ok(()) } else { failed(reason()) }
}

/// Proves nothing, for `reason`, unless the case has `seen` what it is about.
pub(crate) fn observed<R: Display>(seen: bool, reason: impl FnOnce() -> R) -> Tried {
    if seen { Ok(()) } else { Err(Trouble::NotObserved(reason().to_string())) }
}

/// What was measured: the case passes with it if the requirement `holds`, else it fails with it.
pub(crate) fn passed_if(holds: bool, measured: String) -> Verdict {
    if holds { Ok(measured) } else { failed(measured) }
}

/// Fails the case.
pub(crate) fn failed<T>(reason: impl Display) -> Tried<T> {
    Err(Trouble::Failed(reason.to_string()))
}
