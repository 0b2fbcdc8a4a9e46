//! One chain of five processes and four hops over any transport, and the driver that measures it.
//!
//! The chain is that of the pipeline: what the first process publishes wakes the second, and so on to the fifth. No
//! process computes anything. The first writes CLOCK_MONOTONIC into the message right before it publishes, every
//! other passes the stamp on, and the last takes the time when it has the message: the difference is one latency.
//! [`measure`] starts the processes of one contender, waits until the first message has come through, lets the first
//! process send at a fixed rate regardless of answers, and collects the latency of each message, or that it was lost.
//!
//! All processes and their threads run with the scheduling and on the processors that the driver sets before they
//! start. The figures are no latencies of processes with work to do. Messages are written at both ends only. Filling
//! the rest would cost the same everywhere; leaving it out favours transports that copy, because their data stay in
//! the cache.
//!
//! Without the feature `chains` this is only what the program of a peer needs: [`Setup`], [`DriverConnection`],
//! [`ChainStage`].

mod control;
mod message;
mod policy;
mod setup;
mod stage;

#[cfg(feature = "chains")]
mod bus;
#[cfg(feature = "chains")]
mod contender;
#[cfg(feature = "chains")]
mod driver;
#[cfg(feature = "chains")]
mod floor;
#[cfg(feature = "chains")]
mod listener;
#[cfg(feature = "chains")]
mod peers;
#[cfg(feature = "chains")]
mod plan;
#[cfg(feature = "chains")]
mod ring;
#[cfg(feature = "chains")]
mod spawn;
#[cfg(feature = "chains")]
mod unix_socket;
#[cfg(feature = "chains")]
mod wiring;

pub use control::{DriverConnection, DriverOrder};
pub use message::{Arrival, SMALLEST, Stamp, monotonic_ns};
pub use policy::WaitPolicy;
pub use setup::{HOPS, PROCESSES, SETUP_VARIABLE, Setup, TIDY};
pub use stage::{ChainStage, run};

#[cfg(feature = "chains")]
pub use {
    contender::Contender,
    driver::{Block, measure},
    peers::missing,
    plan::ChainPlan,
    setup::{BLOCK_BYTES, Payload},
    spawn::{PRIORITY, SchedulingClass, processors},
};

/// What can go wrong in a chain.
#[derive(Debug, thiserror::Error)]
pub enum HopError {
    /// The process was started by hand.
    #[error("{SETUP_VARIABLE} is not set: hops are started by `scanloop bench transport`")]
    NotInAChain,
    /// The variable holds something else.
    #[error("{SETUP_VARIABLE}: {0}")]
    Setup(String),
    /// The operating system refused.
    #[error("{action}: {source}")]
    System {
        /// What was to be done.
        action: String,
        /// Why it was not.
        source: std::io::Error,
    },
    /// The transport refused.
    #[error("{action}: {reason}")]
    Transport {
        /// What was to be done.
        action: String,
        /// Why it was not.
        reason: String,
    },
    /// The chain did not come up, or a process of it ended.
    #[error("{contender}: {reason}")]
    Chain {
        /// The contender.
        contender: &'static str,
        /// What happened, with the last log line of the process.
        reason: String,
    },
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

impl HopError {
    /// An error of the operating system while doing `action`.
    pub fn system(action: impl Into<String>) -> impl FnOnce(std::io::Error) -> Self {
        let action = action.into();
        move |source| Self::System { action, source }
    }

    /// An error of a transport while doing `action`.
    pub fn transport(action: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        Self::Transport { action: action.into(), reason: format!("{reason:?}") }
    }
}

/// Runs one process of a chain of this crate until the driver closes the chain: `scanloop service hop`.
///
/// # Errors
/// [`HopError::NotInAChain`] when started by hand, and what the transport refuses.
#[cfg(feature = "chains")]
pub fn hop() -> Result<(), HopError> {
    let mut setup = Setup::from_environment()?;
    let mut stage = contender::stage(&mut setup)?;
    run(stage.as_mut(), &setup)
}
