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
    /// It is whole, but this program can't read it.
    #[error("not supported, at byte {at}: {what}")]
    Unsupported {
        /// Where the record begins.
        at: u64,
        /// What it is.
        what: String,
    },
    /// It would take more memory than this program gives.
    #[error("at byte {at}: {what} of {bytes} bytes, {limit} are allowed")]
    TooLarge {
        /// Where the record begins.
        at: u64,
        /// What is too large.
        what: &'static str,
        /// Its size [bytes].
        bytes: u64,
        /// The limit [bytes].
        limit: u64,
    },
    /// The file system failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// What is wrong with a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Damage {
    /// The file does not begin, or does not end, with the bytes of the format.
    #[error("the bytes of the format are missing")]
    Magic,
    /// No record begins here.
    #[error("no record begins here")]
    Opcode,
    /// A field lies outside of its record.
    #[error("a record is shorter than its fields")]
    Short,
    /// The length of a record does not fit to its fields, or reaches behind the end of the file.
    #[error("the length of the record is wrong")]
    Length,
    /// The checksum of a chunk, an attachment or the summary differs.
    #[error("the checksum differs")]
    Checksum,
    /// A chunk can't be decompressed.
    #[error("the chunk can't be decompressed")]
    Compression,
    /// A record that may be whole.
    #[error("the record is too large or has a compression that is not supported")]
    Refused,
    /// A message of a channel that was not announced.
    #[error("a message belongs to no channel")]
    Channel,
    /// A chunk holds a record that does not belong there, or a channel is defined twice.
    #[error("a record stands where it does not belong")]
    Misplaced,
    /// A chunk that the summary names is not there.
    #[error("what the summary names is not there")]
    Missing,
    /// A chunk is there again, and the summary names it once.
    #[error("a chunk stands twice")]
    Repeated,
    /// The summary counts other messages.
    #[error("the summary counts more or fewer messages than there are")]
    Count,
    /// The summary counts other attached files.
    #[error("the summary counts more attached files or texts than there are")]
    Attached,
    /// The file ends within a record, or without its end.
    #[error("the file was cut off")]
    CutOff,
}

/// What is wrong with a record whose place is known to the caller.
#[derive(Debug)]
pub(super) enum Fault {
    Damage(Damage),
    Unsupported(String),
    TooLarge { what: &'static str, bytes: u64, limit: u64 },
    Io(io::Error),
}

impl Fault {
    /// The error about a record that begins at a byte of the file.
    pub(super) fn at(self, at: u64) -> ReadError {
        match self {
            Self::Damage(what) => ReadError::Damaged { at, what },
            Self::Unsupported(what) => ReadError::Unsupported { at, what },
            Self::TooLarge { what, bytes, limit } => ReadError::TooLarge { at, what, bytes, limit },
            Self::Io(error) => ReadError::Io(error),
        }
    }
}

impl From<Damage> for Fault {
    fn from(damage: Damage) -> Self {
        Self::Damage(damage)
    }
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}
