//! Why a sample may not be used.

/// What is wrong with a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// A number is NaN or infinite.
    NotFinite {
        /// Name of the field.
        field: &'static str,
    },
    /// A number is outside the range of the field.
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
    /// The publisher was built against another layout of the sample.
    Layout {
        /// The layout this program was built with.
        expected: u32,
        /// The layout in the sample.
        found: u32,
    },
    /// A command to drive was not verified.
    NotVerified {
        /// The number found in `verified`.
        value: u32,
    },
    /// A command to drive is outside the hard limits of its reader.
    OutsideBounds {
        /// Name of the field.
        field: &'static str,
        /// The value found.
        value: f64,
        /// The lowest value allowed.
        lowest: f64,
        /// The highest value allowed.
        highest: f64,
    },
    /// A command to drive one way while the robot still rolls the other way.
    StillRolling {
        /// The velocity found [m/s].
        value: f64,
        /// The velocity that the wheels were last told [m/s].
        rolling_mps: f64,
    },
    /// The scan behind it is too old.
    TooOld {
        /// Its age [ms].
        age_ms: f64,
    },
    /// The scan behind it lies in the future.
    FromTheFuture {
        /// By so much [ms].
        ahead_ms: f64,
    },
    /// Its scan was answered before.
    AnsweredBefore {
        /// The newest scan answered.
        newest: u64,
    },
    /// A number of its header is one that no scan, or no sample of its publisher, can have.
    ImpossibleNumber {
        /// Name of the field.
        field: &'static str,
        /// The number found.
        value: u64,
        /// The largest number that it can have.
        highest: u64,
    },
}

impl Fault {
    /// Name of the field at fault, and the value found; the value is 0 when it is not finite.
    pub fn finding(&self) -> (&'static str, f64) {
        let (field, value) = match *self {
            Self::NotFinite { field } => (field, 0.0),
            Self::OutOfRange { field, value } | Self::OutsideBounds { field, value, .. } => (field, value),
            Self::UnknownValue { field, value } => (field, f64::from(value)),
            Self::Layout { found, .. } => ("header.layout", f64::from(found)),
            Self::NotVerified { value } => ("verified", f64::from(value)),
            Self::StillRolling { value, .. } => ("velocity_mps", value),
            Self::TooOld { age_ms } => ("age_ms", age_ms),
            Self::FromTheFuture { ahead_ms } => ("ahead_ms", ahead_ms),
            Self::AnsweredBefore { newest } => ("header.scan_id", newest as f64),
            Self::ImpossibleNumber { field, value, .. } => (field, value as f64),
        };
        (field, if value.is_finite() { value } else { 0.0 })
    }
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
            Self::NotVerified { value } => {
                write!(formatter, "not verified: verified = {value}, 1 is required of a command to drive")
            }
            Self::OutsideBounds { field, value, lowest, highest } => {
                write!(formatter, "outside bounds: {field} = {value} is not within {lowest} to {highest}")
            }
            Self::StillRolling { value, rolling_mps } => {
                write!(
                    formatter,
                    "still rolling: velocity_mps = {value} before the robot rests from {rolling_mps} m/s"
                )
            }
            Self::TooOld { age_ms } => write!(formatter, "too old: its scan was taken {age_ms} ms ago"),
            Self::FromTheFuture { ahead_ms } => {
                write!(formatter, "from the future: its scan is {ahead_ms} ms ahead")
            }
            Self::AnsweredBefore { newest } => {
                write!(formatter, "answered before: scan {newest} was answered already")
            }
            Self::ImpossibleNumber { field, value, highest } => {
                write!(formatter, "impossible number: {field} = {value}, {highest} is the largest possible")
            }
        }
    }
}

impl std::error::Error for Fault {}

/// Passes when all `values` are finite, else names `field`.
///
/// # Errors
/// [`Fault::NotFinite`] with the name of the field.
pub fn finite(field: &'static str, values: &[f64]) -> Result<(), Fault> {
    if values.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(Fault::NotFinite { field }) }
}
