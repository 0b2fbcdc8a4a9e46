//! The error of all settings: key, value, and what is allowed.

use std::fmt::Display;
use std::ops::RangeInclusive;

/// A setting that is outside its allowed range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value} is not allowed: {allowed}")]
pub struct Invalid {
    /// The key, with the tables it stands in: `noise.range_m`.
    pub key: String,
    /// The value found.
    pub value: String,
    /// What is allowed, as text: `0 to 1 m`.
    pub allowed: String,
}

impl Invalid {
    /// An error about one key.
    pub fn new(key: &str, value: impl Display, allowed: impl Display) -> Self {
        Self { key: key.to_owned(), value: value.to_string(), allowed: allowed.to_string() }
    }

    /// The same error about a key in a table: `range_m` becomes `noise.range_m`.
    #[must_use]
    pub fn within(self, table: &str) -> Self {
        Self { key: format!("{table}.{}", self.key), ..self }
    }
}

/// Passes when `value` is finite and within `range`.
///
/// # Errors
/// [`Invalid`] with the key, the value and the range; NaN is never within.
pub fn require(key: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), Invalid> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(Invalid::new(key, value, format!("{} to {}", range.start(), range.end())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_names_key_value_and_range() {
        let error = require("range_m", f64::NAN, 0.0..=1.0).unwrap_err().within("noise");
        assert_eq!(error.to_string(), "noise.range_m = NaN is not allowed: 0 to 1");
        assert_eq!(require("range_m", 1.0, 0.0..=1.0), Ok(()));
    }
}
