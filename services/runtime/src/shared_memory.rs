//! Shared memory as the kernel shows it: files in one directory, of which there may be too few bytes.

use std::fs::DirEntry;

/// Where the kernel shows shared memory as files.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// The files whose names begin with `prefix`.
pub(crate) fn files(prefix: &str) -> std::io::Result<impl Iterator<Item = DirEntry>> {
    let entries = std::fs::read_dir(SHARED_MEMORY)?.flatten();
    Ok(entries.filter(move |entry| entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes())))
}

/// Shared memory that is not there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "shared memory is full: {} has {} KiB free, {} KiB are needed: {} KiB are missing",
    SHARED_MEMORY,
    free / 1024,
    needed.div_ceil(1024),
    self.missing().div_ceil(1024)
)]
pub struct Shortage {
    /// What is needed [bytes].
    pub needed: u64,
    /// What is free [bytes].
    pub free: u64,
}

impl Shortage {
    /// What has to be freed [bytes]; at least one byte, as a full file system may have room for what it can't give.
    pub fn missing(&self) -> u64 {
        self.needed.saturating_sub(self.free).max(1)
    }
}
