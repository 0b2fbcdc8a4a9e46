//! The settings of one measurement of a chain.

use std::path::PathBuf;

use crate::{Contender, Payload, SchedulingClass, WaitPolicy};

/// One measurement.
#[derive(Debug, Clone)]
pub struct ChainPlan {
    /// The transport.
    pub contender: Contender,
    /// How large messages are.
    pub payload: Payload,
    /// Messages per second.
    pub rate_hz: f64,
    /// Messages at that rate before those that count.
    pub warm_up: u64,
    /// Messages that count.
    pub samples: u64,
    /// How processes wait.
    pub policy: WaitPolicy,
    /// Scheduler of all processes and threads of the chain.
    pub scheduling: SchedulingClass,
    /// Processors they may run on; empty: all.
    pub cpus: Vec<usize>,
    /// The program that calls [`crate::hop`].
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<String>,
}

impl ChainPlan {
    /// Time between two messages [ns].
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz) as u64
    }
}
