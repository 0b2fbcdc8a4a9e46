//! The rules for samples, one of which a dropped or refused sample failed.

use crate::Fault;
use crate::named::wire_enum;

wire_enum! {
    /// The rule that a dropped or refused sample failed.
    pub enum Rule {
        /// It failed none.
        None = 0 "none",
        /// Its layout is that of this system.
        Layout = 1 "foreign_layout",
        /// Its numbers are finite.
        NotFinite = 2 "not_finite",
        /// Its numbers are within the ranges of the fields.
        OutOfRange = 3 "out_of_range",
        /// Its enumerations hold known numbers.
        UnknownValue = 4 "unknown_value",
        /// A command to drive was verified.
        NotVerified = 5 "not_verified",
        /// A command to drive is within the hard limits of the actuator.
        OutsideBounds = 6 "outside_bounds",
        /// Its scan is young enough.
        TooOld = 7 "too_old",
        /// Its scan does not lie in the future.
        FromTheFuture = 8 "from_the_future",
        /// Its scan was not answered before.
        AnsweredBefore = 9 "answered_before",
        /// Its numbers are such as its scan and its publisher can have reached.
        ImpossibleNumber = 10 "impossible_number",
        /// A command to drive the other way finds the robot at rest.
        StillRolling = 11 "still_rolling",
    }
}

impl Rule {
    /// Whether every reader drops a sample that fails it, whatever it has answered before.
    pub const fn is_of_content(self) -> bool {
        matches!(
            self,
            Self::Layout
                | Self::NotFinite
                | Self::OutOfRange
                | Self::UnknownValue
                | Self::NotVerified
                | Self::ImpossibleNumber
        )
    }

    /// Whether the publisher of the sample is at fault; age and number may also be due to earlier stages.
    pub const fn is_of_writer(self) -> bool {
        self.is_of_content() || matches!(self, Self::OutsideBounds | Self::StillRolling)
    }
}

impl Fault {
    /// Whether the number of the sample among those of its publisher can't be read or believed.
    pub fn hides_sequence(&self) -> bool {
        matches!(self, Self::Layout { .. } | Self::ImpossibleNumber { field: "header.sequence", .. })
    }

    /// The rule that the sample failed.
    pub const fn rule(&self) -> Rule {
        match self {
            Self::NotFinite { .. } => Rule::NotFinite,
            Self::OutOfRange { .. } => Rule::OutOfRange,
            Self::UnknownValue { .. } => Rule::UnknownValue,
            Self::Layout { .. } => Rule::Layout,
            Self::NotVerified { .. } => Rule::NotVerified,
            Self::OutsideBounds { .. } => Rule::OutsideBounds,
            Self::StillRolling { .. } => Rule::StillRolling,
            Self::TooOld { .. } => Rule::TooOld,
            Self::FromTheFuture { .. } => Rule::FromTheFuture,
            Self::AnsweredBefore { .. } => Rule::AnsweredBefore,
            Self::ImpossibleNumber { .. } => Rule::ImpossibleNumber,
        }
    }
}
