//! Wakes a process from a thread of its own: for drivers, whose devices do not ring doorbells.

use std::sync::Arc;

use shared_types::Role;

use crate::Process;
use crate::bell::Bells;

/// Ends a sleep of [`Process::wait`] from another thread.
///
/// Limit: while a publisher that does not ring doorbells writes one of the topics that the process reads, a sleep ends
/// at its deadline only.
#[derive(Debug, Clone)]
pub struct Waker {
    bells: Arc<Bells>,
    role: Role,
}

impl Waker {
    /// Ends the sleep now, or the next one if the process does not sleep.
    pub fn wake(&self) {
        self.bells.role(self.role).ring_all();
    }
}

impl Process {
    /// Ends sleeps of this process from another thread.
    pub fn waker(&self) -> Waker {
        Waker { bells: Arc::clone(self.bells()), role: self.role() }
    }
}
