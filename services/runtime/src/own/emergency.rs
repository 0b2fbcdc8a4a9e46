//! Emergency stops from outside: topics of your own by which a companion says whether a button is pressed.
//!
//! The actuator reads them itself, so that a stop needs no other process. A button that says nothing for longer than
//! `max_age_ms` counts as pressed.

use super::field::OwnFields;
use crate::RuntimeError;

/// The field that says it, not zero for pressed; its type is u8.
pub const EMERGENCY_STOP_FIELDS: &[&str] = &["pressed"];

/// What the actuator knows of one button.
pub(crate) struct EmergencyStop {
    button: OwnFields,
    /// When a sample came last [ns]; 0 before the first.
    seen_ns: u64,
    is_pressed: bool,
}

impl EmergencyStop {
    /// A button that has said nothing.
    pub(crate) fn of(button: OwnFields) -> Self {
        Self { button, seen_ns: 0, is_pressed: false }
    }

    /// Whether the wheels have to be blocked for it at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    /// Errors of the bus.
    pub(crate) fn blocks(&mut self, now_ns: u64) -> Result<bool, RuntimeError> {
        while let Some(pressed) = self.button.take()? {
            self.is_pressed = pressed != 0;
            self.seen_ns = now_ns;
        }
        let is_silent =
            self.button.max_age_ns().is_some_and(|limit| now_ns.saturating_sub(self.seen_ns) > limit);
        Ok(self.is_pressed || is_silent || self.seen_ns == 0)
    }
}
