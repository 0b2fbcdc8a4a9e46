//! Shared memory: files in one directory, of which there may be too few bytes, and pages of atomics.
#![expect(unsafe_code, reason = "shared memory is mapped and read through a pointer")]

use std::fs::DirEntry;
use std::io;
use std::ops::Deref;
use std::os::fd::AsFd;
use std::ptr::NonNull;

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// Where the kernel shows shared memory as files.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// The files whose names begin with `prefix`.
pub(crate) fn files(prefix: &str) -> io::Result<impl Iterator<Item = DirEntry>> {
    let entries = std::fs::read_dir(SHARED_MEMORY)?.flatten();
    Ok(entries.filter(move |entry| entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes())))
}

/// A lack of shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "shared memory is full: {} has {} KiB free, {} KiB are needed: {} KiB are missing",
    SHARED_MEMORY,
    free / 1024,
    needed.div_ceil(1024),
    self.missing().div_ceil(1024)
)]
pub struct Shortage {
    /// Bytes needed.
    pub needed: u64,
    /// Bytes free.
    pub free: u64,
}

impl Shortage {
    /// Bytes to free; at least one, because a file system may refuse although it reports enough free bytes.
    pub fn missing(&self) -> u64 {
        self.needed.saturating_sub(self.free).max(1)
    }
}

/// A page of atomics that processes share.
pub(crate) struct Mapped<P>(NonNull<P>);

// SAFETY: the page stays mapped until the last user is gone, and `P` itself allows access from several threads.
unsafe impl<P: Sync> Send for Mapped<P> {}
// SAFETY: as above.
unsafe impl<P: Sync> Sync for Mapped<P> {}

impl<P> Mapped<P> {
    /// Maps the beginning of a file.
    ///
    /// # Safety
    /// `P` consists of atomics only, for which any bytes are valid. Its alignment is at most that of a page of the
    /// machine. The file is at least as large as `P`, and never made smaller.
    pub(crate) unsafe fn new(file: impl AsFd) -> io::Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping at an address of the kernel's choice.
        let page =
            unsafe { mmap(std::ptr::null_mut(), size_of::<P>(), protection, MapFlags::SHARED, file, 0) }?;
        NonNull::new(page.cast()).map(Self).ok_or_else(|| io::Error::other("mapped at zero"))
    }
}

impl<P> std::fmt::Debug for Mapped<P> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(formatter)
    }
}

impl<P> Deref for Mapped<P> {
    type Target = P;

    fn deref(&self) -> &P {
        // SAFETY: mapped in `new`, whose caller guarantees the rest, and unmapped only on drop.
        unsafe { self.0.as_ref() }
    }
}

impl<P> Drop for Mapped<P> {
    fn drop(&mut self) {
        // SAFETY: the mapping was made in `new` with this size, and a value that is dropped is not borrowed.
        let _ = unsafe { munmap(self.0.as_ptr().cast(), size_of::<P>()) };
    }
}
