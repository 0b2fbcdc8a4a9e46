//! One event while it is handled: its time, and the actions that it leads to.

use super::policy::nanoseconds;
use super::{Action, Severity};

/// The time of an event, and what is to be done about it, in order.
pub(super) struct Turn {
    pub(super) now_ns: u64,
    pub(super) actions: Vec<Action>,
}

impl Turn {
    pub(super) fn push(&mut self, action: Action) {
        self.actions.push(action);
    }

    pub(super) fn info(&mut self, text: String) {
        self.push(Action::Log(Severity::Info, text));
    }

    pub(super) fn warn(&mut self, text: String) {
        self.push(Action::Log(Severity::Warn, text));
    }

    /// The time so many milliseconds from now [ns].
    pub(super) fn in_ms(&self, milliseconds: u64) -> u64 {
        self.now_ns.saturating_add(nanoseconds(milliseconds))
    }

    pub(super) fn is_due(&self, deadline_ns: Option<u64>) -> bool {
        deadline_ns.is_some_and(|deadline_ns| deadline_ns <= self.now_ns)
    }
}
