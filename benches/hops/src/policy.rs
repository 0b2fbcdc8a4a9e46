//! How a process waits for its next message.

use serde::{Deserialize, Serialize};

/// Longest sleep: the most that a process takes to notice that the chain is closed. No multiple of a usual period, so
/// that time-outs and messages do not meet.
pub(crate) const MAX_WAIT_NS: u64 = 230_000_000;
/// How long a process polls before and after the time at which a message is due [us]. Twice what a timer and a
/// wake-up are late by, and less than half a period at 1 kHz.
pub(crate) const POLL_US: u64 = 200;

/// How a process waits for its next message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WaitPolicy {
    /// It sleeps until the message wakes it.
    Block,
    /// It sleeps until shortly before the message is due, a period after the last one. Then it polls, and yields the
    /// processor in between. When the message is late it sleeps until it is woken.
    Poll,
}

impl WaitPolicy {
    /// Name on the command line and in JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Block => "block",
            Self::Poll => "poll",
        }
    }
}
