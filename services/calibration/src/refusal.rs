//! Why runs cannot be used for a calibration.

use std::ops::RangeInclusive;

/// Runs that are refused, and the reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RunRefusal {
    /// A table or a file cannot be read.
    #[error("{place}: {message}")]
    Unreadable {
        /// File and line.
        place: String,
        /// What is wrong.
        message: String,
    },
    /// There are too few runs or points.
    #[error("{found} {what} are too few: at least {needed} are needed")]
    TooFew {
        /// What is counted.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many it takes.
        needed: usize,
    },
    /// A value is outside its range.
    #[error("{place}: {column} = {value} is not allowed: {allowed}")]
    OutsideRange {
        /// File and line.
        place: String,
        /// The column.
        column: &'static str,
        /// The value.
        value: f64,
        /// The allowed range as text.
        allowed: String,
    },
    /// The runs do not determine the result, or contradict the model.
    #[error("the fit is refused: {0}")]
    Implausible(String),
}

impl RunRefusal {
    /// A fit that is refused for a reason.
    pub(crate) fn implausible(reason: impl Into<String>) -> Self {
        Self::Implausible(reason.into())
    }

    /// A table or a file that cannot be read at a place.
    pub(crate) fn unreadable(place: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Unreadable { place: place.into(), message: message.into() }
    }
}

/// Passes when the value of a column is finite and within its range.
pub(crate) fn within(
    place: &str,
    column: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
) -> Result<(), RunRefusal> {
    if range.contains(&value) {
        return Ok(());
    }
    let allowed = format!("{} to {}", range.start(), range.end());
    Err(RunRefusal::OutsideRange { place: place.to_owned(), column, value, allowed })
}

/// Passes when there are enough of something.
pub(crate) fn enough(what: &'static str, found: usize, needed: usize) -> Result<(), RunRefusal> {
    if found >= needed { Ok(()) } else { Err(RunRefusal::TooFew { what, found, needed }) }
}

/// Refuses the fit with a reason where the condition holds.
pub(crate) fn refuse_if(condition: bool, reason: impl FnOnce() -> String) -> Result<(), RunRefusal> {
    if condition { Err(RunRefusal::Implausible(reason())) } else { Ok(()) }
}
