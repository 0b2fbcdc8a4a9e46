//! The setup of a process of the chain, in one environment variable, so that it also reaches processes that others
//! start.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::{HopError, WaitPolicy};

/// Processes of a chain: as many as the loop has.
pub const PROCESSES: usize = 5;
/// Hops from the first process to the last.
pub const HOPS: usize = PROCESSES - 1;
/// The environment variable with the [`Setup`] as JSON.
pub const SETUP_VARIABLE: &str = "SCANLOOP_HOP";
/// With this argument the program of a peer only removes the remains of dead processes.
pub const TIDY: &str = "tidy";

/// Everything that one process of a chain must know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Setup {
    /// Name of the contender.
    pub contender: String,
    /// Place in the chain, from 0.
    pub index: usize,
    /// Socket of the driver.
    pub control: PathBuf,
    /// Size of the message on each hop [bytes].
    pub payload_bytes: [usize; HOPS],
    /// Time between two messages [ns].
    pub period_ns: u64,
    /// Messages at the rate of the measurement that are not counted.
    pub warm_up: u64,
    /// Messages that count.
    pub samples: u64,
    /// How processes wait.
    pub policy: WaitPolicy,
    /// Address of each hop, in the contender's own terms: descriptors, sockets, ports.
    pub addresses: Vec<String>,
}

impl Setup {
    /// The setup of this process.
    ///
    /// # Errors
    /// [`HopError::NotInAChain`] or [`HopError::Setup`].
    pub fn from_environment() -> Result<Self, HopError> {
        let text = std::env::var(SETUP_VARIABLE).map_err(|_| HopError::NotInAChain)?;
        let setup: Self = serde_json::from_str(&text).map_err(|error| HopError::Setup(error.to_string()))?;
        if setup.index >= PROCESSES || setup.payload_bytes.iter().any(|bytes| *bytes < crate::SMALLEST) {
            return Err(HopError::Setup("index or payload_bytes out of range".to_owned()));
        }
        Ok(setup)
    }

    /// The setup as the value of [`SETUP_VARIABLE`].
    ///
    /// # Errors
    /// [`HopError::Setup`] for a path that is no text.
    pub fn to_json(&self) -> Result<String, HopError> {
        serde_json::to_string(self).map_err(|error| HopError::Setup(error.to_string()))
    }

    /// What this process reads from; `None` for the first.
    pub fn inlet(&self) -> Option<&str> {
        self.addresses.get(self.index.checked_sub(1)?).map(String::as_str)
    }

    /// What this process writes to; `None` for the last.
    pub fn outlet(&self) -> Option<&str> {
        if self.is_last() { None } else { self.addresses.get(self.index).map(String::as_str) }
    }

    /// Size of what this process reads [bytes]; 0 for the first.
    pub fn inlet_bytes(&self) -> usize {
        self.index.checked_sub(1).map_or(0, |hop| self.payload_bytes[hop])
    }

    /// Size of what this process writes [bytes]; 0 for the last.
    pub fn outlet_bytes(&self) -> usize {
        self.payload_bytes.get(self.index).copied().unwrap_or(0)
    }

    /// Whether this process sends the messages.
    pub fn is_first(&self) -> bool {
        self.index == 0
    }

    /// Whether this process takes the latencies.
    pub fn is_last(&self) -> bool {
        self.index == PROCESSES - 1
    }
}

/// Message sizes that can be chosen: 1 kB to 4 MB in steps of four [bytes].
#[cfg(feature = "chains")]
pub const BLOCK_BYTES: [usize; 7] = [1 << 10, 1 << 12, 1 << 14, 1 << 16, 1 << 18, 1 << 20, 1 << 22];

/// How large messages are.
#[cfg(feature = "chains")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Payload {
    /// The samples that pass from process to process in the loop: odometry, pose, obstacles, command.
    Pipeline,
    /// One of [`BLOCK_BYTES`] on every hop.
    Block(usize),
}

#[cfg(feature = "chains")]
impl Payload {
    /// Size on each hop [bytes].
    pub fn bytes(self) -> [usize; HOPS] {
        use shared_types::Topic;
        match self {
            Self::Pipeline => {
                [Topic::Odometry, Topic::Pose, Topic::Obstacles, Topic::Command].map(Topic::size)
            }
            Self::Block(bytes) => [bytes; HOPS],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_process_reads_what_the_one_before_it_writes() {
        let setup = |index| Setup {
            contender: "floor".to_owned(),
            index,
            control: PathBuf::new(),
            payload_bytes: [100, 200, 300, 400],
            period_ns: 1,
            warm_up: 0,
            samples: 1,
            policy: WaitPolicy::Block,
            addresses: ["a", "b", "c", "d"].map(str::to_owned).to_vec(),
        };
        for index in 1..PROCESSES {
            assert_eq!(setup(index).inlet(), setup(index - 1).outlet());
            assert_eq!(setup(index).inlet_bytes(), setup(index - 1).outlet_bytes());
        }
        assert_eq!((setup(0).inlet(), setup(4).outlet()), (None, None));
        assert_eq!((setup(0).inlet_bytes(), setup(4).outlet_bytes()), (0, 0));
    }
}
