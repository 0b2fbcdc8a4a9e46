//! Status of a reply.

use std::fmt;

/// The two characters after the echo of a reply; of a reply in SCIP 1.1 the first one only.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct ScipStatus(pub [u8; 2]);

impl ScipStatus {
    /// The command was accepted.
    pub const DONE: Self = Self(*b"00");
    /// A scan follows.
    pub const SCAN: Self = Self(*b"99");
    /// A scanner in SCIP 1.1 answers a command of SCIP 2.0 with it.
    pub const SCIP_1: Self = Self([b'E', 0]);
    /// Unknown command; in time mode, any command that is not allowed there.
    pub const NOT_ALLOWED: Self = Self(*b"0E");
    /// `SCIP2.0` answers with a single digit.
    pub const SELECTED: Self = Self([b'0', 0]);

    /// The number of a status of two digits.
    pub fn number(self) -> Option<u8> {
        let [tens, ones] = self.0;
        let are_digits = tens.is_ascii_digit() && ones.is_ascii_digit();
        are_digits.then(|| (tens - b'0') * 10 + (ones - b'0'))
    }

    /// What it means in the reply to a measurement.
    pub fn meaning(self) -> &'static str {
        match (self.number(), self.0) {
            (Some(0), _) => "accepted",
            (Some(1..=7), _) => "the measurement has a parameter that this model does not allow",
            (Some(10), _) => "the laser is off",
            (Some(21..=49), _) => "the scanner checks itself and has stopped measuring",
            (Some(50..=97), _) => "fault of the scanner's hardware",
            (Some(98), _) => "the scanner has recovered and measures again",
            (Some(99), _) => "a scan",
            (_, [b'E', 0]) => "the scanner uses SCIP 1.1",
            (_, [b'0', b'A' | b'B']) => "the scanner is busy or has an internal fault",
            (_, [b'0', b'C'..=b'H']) => "the scanner does not know the command",
            (_, [b'0', b'I']) => "the scanner waits for firmware",
            _ => "unknown status",
        }
    }
}

impl fmt::Display for ScipStatus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0
            .iter()
            .filter(|byte| **byte != 0)
            .try_for_each(|byte| write!(formatter, "{}", byte.escape_ascii()))
    }
}

impl fmt::Debug for ScipStatus {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "ScipStatus({self})")
    }
}
