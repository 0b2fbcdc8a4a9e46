//! Why there is no connection, in words for the log.

use driver::beams::Unusable;
use driver::guard::GuardFault;

use crate::handshake::Refused;
use crate::header::DeviceAddress;
use crate::stream::NotPlayer;
use crate::xdr::Malformed;

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
pub enum Lost {
    /// The host is unknown.
    #[error("host `{host}` is unknown: {source}")]
    UnknownHost {
        /// As the settings name it.
        host: String,
        /// From the resolver.
        source: std::io::Error,
    },
    /// The host does not answer, or has no server at this port.
    #[error("no Player server at {server}: {source}")]
    NotConnected {
        /// Host and port.
        server: String,
        /// From the kernel.
        source: std::io::Error,
    },
    /// It is no Player server.
    #[error("{server}: {source}")]
    NotPlayer {
        /// Host and port.
        server: String,
        /// What it sent.
        source: NotPlayer,
    },
    /// A request failed.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// A message is malformed.
    #[error("a malformed message of {device}, subtype {subtype}: {source}")]
    Malformed {
        /// From which device.
        device: DeviceAddress,
        /// Its subtype.
        subtype: u32,
        /// What is wrong.
        source: Malformed,
    },
    /// The scanner cannot be used.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// A sweep came, but not where its beams point.
    #[error("the scanner does not report where its beams point")]
    NoFan,
    /// The server closed the connection.
    #[error("the server closed the connection")]
    Closed,
    /// The connection failed.
    #[error("the connection failed: {0}")]
    Broken(std::io::Error),
    /// No data come.
    #[error("no data of the {what} for {silent_ms} ms")]
    Silent {
        /// Base or scanner.
        what: &'static str,
        /// For how long.
        silent_ms: u64,
    },
    /// Too much data come.
    #[error("the server floods: {bytes} bytes in {messages} messages within a second")]
    Flood {
        /// How many bytes.
        bytes: usize,
        /// How many messages.
        messages: usize,
    },
    /// The guard of the wheels fails.
    #[error(transparent)]
    Guard(#[from] GuardFault),
}
