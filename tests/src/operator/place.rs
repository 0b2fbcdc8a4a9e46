//! File systems of a trial's own, which it may fill.

use std::fs::OpenOptions;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use rustix::fs::{FallocateFlags, fallocate, statvfs};

/// Where shared memory is.
pub const SHARED_MEMORY: &str = "/dev/shm";
/// Any directory that is there on all machines; another one is mounted over it for the trials alone.
const SYSTEMS: &str = "/mnt";
/// Variable that is set where this program has file systems of its own.
const INSIDE: &str = "SCANLOOP_OPERATOR_INSIDE";

/// Starts this program again with the same arguments and file systems of its own, where that is permitted; returns
/// otherwise.
pub fn enter() {
    if is_own() || !Command::new("unshare").args(["-m", "true"]).status().is_ok_and(|status| status.success())
    {
        return;
    }
    let script = format!(
        "mount -t tmpfs -o mode=1777,size=64m tmpfs {SHARED_MEMORY} && \
         mount -t tmpfs -o mode=0700,size=2m tmpfs {SYSTEMS} && exec \"$0\" \"$@\""
    );
    let Ok(executable) = std::env::current_exe() else { return };
    let error = Command::new("unshare")
        .args(["-m", "sh", "-c", &script])
        .arg(executable)
        .args(std::env::args_os().skip(1))
        .env(INSIDE, "1")
        .env(runtime::RUNTIME_DIR_VARIABLE, SYSTEMS)
        .exec();
    eprintln!("no file systems of our own: {error}");
}

/// Whether this program has file systems of its own.
pub fn is_own() -> bool {
    std::env::var_os(INSIDE).is_some()
}

/// A file that takes all but so many bytes of a file system until it is dropped.
#[derive(Debug)]
pub struct Ballast(PathBuf);

impl Ballast {
    /// Fills shared memory, or the file system of the systems.
    ///
    /// # Errors
    /// When the file system is not this program's own, or does not take the file.
    pub fn leave(shared: bool, free: u64) -> Result<Self, String> {
        if !is_own() {
            return Err("mounting is not permitted".to_owned());
        }
        let place = Path::new(if shared { SHARED_MEMORY } else { SYSTEMS });
        let path = place.join("ballast");
        let with_place = |error: &dyn std::fmt::Display| format!("{}: {error}", place.display());
        let file = OpenOptions::new()
            .create_new(true)
            .write(true)
            .open(&path)
            .map_err(|error| with_place(&error))?;
        let ballast = Self(path);
        let found = statvfs(place).map_err(|error| with_place(&error))?;
        if let Some(bytes) = (found.f_bavail * found.f_frsize).checked_sub(free).filter(|bytes| *bytes > 0) {
            fallocate(&file, FallocateFlags::empty(), 0, bytes).map_err(|error| with_place(&error))?;
        }
        Ok(ballast)
    }
}

impl Drop for Ballast {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}
