//! Whether the kernel has killed a process because its control group had no memory left.

use console::control_group::{Reached, memory_limit, out_of_memory_kills};
use supervision::supervisor::ProcessExit;

/// Number of the signal with which the kernel ends a process for want of memory.
const KILL: i32 = 9;

/// The kills until now.
pub(super) struct MemoryWatch {
    kills: u64,
}

impl Default for MemoryWatch {
    fn default() -> Self {
        Self { kills: out_of_memory_kills() }
    }
}

impl MemoryWatch {
    /// The limit behind the end of a process, as a continuation of the sentence; empty for another cause.
    pub(super) fn cause_of(&mut self, exit: ProcessExit) -> String {
        if exit != ProcessExit::Signal(KILL) {
            return String::new();
        }
        let before = std::mem::replace(&mut self.kills, out_of_memory_kills());
        match memory_limit() {
            Some(Reached { group, limit }) if self.kills > before => {
                format!(": its control group {group} has no more memory than {} KiB", limit / 1024)
            }
            _ => String::new(),
        }
    }
}
