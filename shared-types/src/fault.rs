//! Why the content of a sample may not be used.

/// What is wrong with a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A number is NaN or infinite.
    NotFinite {
        /// Name of the field.
        field: &'static str,
    },
    /// A number is outside what the field can mean.
    OutOfRange {
        /// Name of the field.
        field: &'static str,
        /// The value found.
        value: f64,
    },
    /// An enumeration holds a number without a meaning.
    UnknownValue {
        /// Name of the field.
        field: &'static str,
        /// The number found.
        value: u32,
    },
    /// The producer was built against another layout of the sample.
    Layout {
        /// The layout this program was built with.
        expected: u32,
        /// The layout in the sample.
        found: u32,
    },
}

impl std::fmt::Display for Fault {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotFinite { field } => write!(formatter, "{field} is not finite"),
            Self::OutOfRange { field, value } => write!(formatter, "{field} = {value} is out of range"),
            Self::UnknownValue { field, value } => write!(formatter, "{field} = {value} is unknown"),
            Self::Layout { expected, found } => {
                write!(formatter, "layout {found:#010x} where {expected:#010x} was expected")
            }
        }
    }
}

impl std::error::Error for Fault {}

/// Passes when all `values` are finite, else names `field`.
pub(crate) fn finite(field: &'static str, values: &[f64]) -> Result<(), Fault> {
    if values.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(Fault::NotFinite { field }) }
}
