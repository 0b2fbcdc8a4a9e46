//! One orchestrator per system: the lock, and who cleans up.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Seek, Write};
use std::os::unix::fs::MetadataExt;

use anyhow::Context;
use runtime::{Domain, LEAVING, LOCK_FILE, RuntimeError, monotonic_ns};
use rustix::fs::{FlockOperation, flock};

/// The last process of a system without an orchestrator cleans up within this time [ns].
const LEAVING_PATIENCE_NS: u64 = 6_000_000_000;

/// The right to run a system. Dropping it gives the right back; from [`SystemLock::own`] on it also removes everything
/// that the system has on this machine: nothing is left in shared memory or in its directory, however the run ended.
#[derive(Debug)]
pub(crate) struct SystemLock {
    domain: Domain,
    _lock: File,
    owns: bool,
}

impl SystemLock {
    /// Takes the lock of the system and leaves everything else as it is.
    ///
    /// # Errors
    /// [`RuntimeError::AlreadyRunning`] while another orchestrator holds it, and errors of the file system.
    pub(crate) fn take(domain: &Domain) -> anyhow::Result<Self> {
        let path = domain.directory().join(LOCK_FILE);
        let context = || format!("{}", path.display());
        let deadline_ns = monotonic_ns() + LEAVING_PATIENCE_NS;
        loop {
            std::fs::create_dir_all(domain.directory()).with_context(context)?;
            let opened = OpenOptions::new().create(true).truncate(false).read(true).write(true).open(&path);
            let mut lock = match opened {
                // Another system that ends just now may have removed the folder above that of ours.
                Err(error) if error.kind() == ErrorKind::NotFound && monotonic_ns() < deadline_ns => continue,
                opened => opened.with_context(context)?,
            };
            if flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok() {
                // Whoever held it before may have removed the file meanwhile: then this lock is worth nothing.
                let same = std::fs::metadata(&path).is_ok_and(|there| {
                    lock.metadata().is_ok_and(|here| (here.dev(), here.ino()) == (there.dev(), there.ino()))
                });
                if same {
                    lock.set_len(0).and_then(|()| lock.rewind()).with_context(context)?;
                    writeln!(lock, "{}", std::process::id()).with_context(context)?;
                    return Ok(Self { domain: domain.clone(), _lock: lock, owns: false });
                }
                continue;
            }
            let mut holder = String::new();
            lock.read_to_string(&mut holder).with_context(context)?;
            if !holder.contains(LEAVING) || monotonic_ns() > deadline_ns {
                let pid = holder.split_whitespace().next().unwrap_or("unknown").to_owned();
                return Err(
                    RuntimeError::AlreadyRunning { system_id: domain.system_id().to_owned(), pid }.into()
                );
            }
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }

    /// From now on the files of the system are of this run: they are removed when the lock is dropped.
    pub(crate) fn own(&mut self) {
        self.owns = true;
    }
}

impl Drop for SystemLock {
    fn drop(&mut self) {
        if self.owns
            && let Err(error) = self.domain.remove()
        {
            tracing::warn!("not cleaned up: {error:#}");
        }
    }
}
