//! The report of a reader about samples that it dropped or refused because of their content.

use crate::describe::layout;
use crate::{Fault, Header, Rule};

/// Longest name of a field in a [`Refusal`] [bytes].
pub const FIELD_NAME_BYTES: usize = 32;

layout! {
    /// How many samples of one input were dropped or refused because of their content, and the newest of them.
    pub struct Refusal(64) {
        /// Samples dropped or refused because of their content, since the process started
        pub count: u64,
        /// Scan of the newest one
        pub scan_id: u64,
        /// Faulty value in the newest one; 0 if it is not finite
        pub value: f64,
        /// Incarnation of the writer of the newest one
        pub incarnation: u32,
        /// Rule that the newest one violates, `Rule`
        pub rule: u32,
        /// Name of its faulty field in ASCII, padded with zeros
        pub field: [u8; FIELD_NAME_BYTES],
    }
}

impl Refusal {
    /// Counts one more sample with its fault.
    pub fn note(&mut self, header: &Header, fault: &Fault) {
        let (field, value) = fault.finding();
        let mut name = [0; FIELD_NAME_BYTES];
        name.iter_mut().zip(field.bytes()).for_each(|(place, letter)| *place = letter);
        *self = Self {
            count: self.count + 1,
            scan_id: header.scan_id,
            value,
            incarnation: header.incarnation,
            rule: fault.rule().wire(),
            field: name,
        };
    }

    /// The rule that the newest failed; `None` also for a number without a meaning.
    pub fn failed(&self) -> Rule {
        Rule::try_from(self.rule).unwrap_or(Rule::None)
    }

    /// Name of the field at fault; empty when it is not readable.
    pub fn field_name(&self) -> &str {
        let length = self.field.iter().position(|letter| *letter == 0).unwrap_or(FIELD_NAME_BYTES);
        let name = std::str::from_utf8(&self.field[..length]).unwrap_or_default();
        if name.chars().all(|letter| letter.is_ascii_graphic()) { name } else { "" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_names_the_newest_fault_and_counts_all() {
        let mut refusal = Refusal::default();
        assert_eq!((refusal.failed(), refusal.field_name()), (Rule::None, ""));
        let header = Header { scan_id: 8, incarnation: 3, ..Header::default() };
        refusal.note(&header, &Fault::NotFinite { field: "steering_rad" });
        refusal.note(&header, &Fault::NotVerified { value: 0 });
        assert_eq!((refusal.count, refusal.scan_id, refusal.incarnation), (2, 8, 3));
        assert_eq!(
            (refusal.failed(), refusal.field_name(), refusal.value),
            (Rule::NotVerified, "verified", 0.0)
        );
        refusal.note(
            &header,
            &Fault::OutOfRange { field: "a_name_that_is_longer_than_there_is_room", value: f64::NAN },
        );
        assert_eq!((refusal.field_name().len(), refusal.value), (FIELD_NAME_BYTES, 0.0));
        refusal.field = [0x1b; FIELD_NAME_BYTES];
        assert_eq!(refusal.field_name(), "");
    }
}
