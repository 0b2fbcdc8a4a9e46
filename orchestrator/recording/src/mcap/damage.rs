//! What can be wrong with a file.

use std::io;

/// Why a file can't be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// It is no MCAP file.
    #[error("no MCAP file: it does not begin with the bytes of the format")]
    Foreign,
    /// Its content is not what was written.
    #[error("damaged at byte {at}: {what}")]
    Damaged {
        /// Where the record with the damage begins.
        at: u64,
        /// What is wrong.
        what: Damage,
    },
    /// The file system failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// What is wrong with a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Damage {
    /// A field lies outside of its record.
    #[error("a record is shorter than its fields")]
    Short,
    /// The checksum of a chunk or attachment differs.
    #[error("the checksum differs")]
    Checksum,
    /// A chunk can't be decompressed.
    #[error("the chunk can't be decompressed")]
    Compression,
    /// A message of a channel that was not announced.
    #[error("a message belongs to no channel")]
    Channel,
    /// A record is longer than any file of this kind has.
    #[error("a record is too long")]
    Long,
}
