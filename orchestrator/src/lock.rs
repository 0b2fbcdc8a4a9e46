//! One orchestrator per system: the lock, and what an earlier one left behind.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::PathBuf;

use anyhow::Context;
use runtime::{Domain, RuntimeError};
use rustix::fs::{FlockOperation, flock};
use rustix::process::{Pid, Signal, kill_process_group};
use serde::{Deserialize, Serialize};
use shared_types::Role;

use crate::child::start_ticks;

const LOCK_FILE: &str = "lock";
const PROCESSES_FILE: &str = "processes.json";

/// A process as it is written down, so that a later orchestrator can tell it from a stranger of the same id.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Registered {
    /// Name of its role.
    pub role: String,
    /// Process id, also the id of its process group.
    pub pid: i32,
    /// Start time of the process in clock ticks since boot.
    pub start_time: u64,
    /// Incarnation of the process.
    pub incarnation: u32,
}

/// The right to run a system. Dropping it gives the right back and removes everything that the system has on this
/// machine: nothing is left in shared memory or in its directory, however the run ended.
#[derive(Debug)]
pub(crate) struct SystemLock {
    domain: Domain,
    _lock: File,
    registered: Vec<Registered>,
}

impl SystemLock {
    /// Takes the lock of the system, ends processes that an earlier run left and removes its files.
    ///
    /// # Errors
    /// [`RuntimeError::AlreadyRunning`] while another orchestrator holds it, and errors of the file system.
    pub(crate) fn acquire(domain: &Domain) -> anyhow::Result<Self> {
        let directory = domain.directory();
        std::fs::create_dir_all(directory).with_context(|| format!("{}", directory.display()))?;
        let path = directory.join(LOCK_FILE);
        let mut lock = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path)
            .with_context(|| format!("{}", path.display()))?;
        if flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err() {
            let mut pid = String::new();
            lock.read_to_string(&mut pid).with_context(|| format!("{}", path.display()))?;
            let pid = if pid.trim().is_empty() { "unknown".to_owned() } else { pid.trim().to_owned() };
            return Err(RuntimeError::AlreadyRunning { system_id: domain.system_id().to_owned(), pid }.into());
        }
        lock.set_len(0).and_then(|()| lock.rewind()).with_context(|| format!("{}", path.display()))?;
        writeln!(lock, "{}", std::process::id()).with_context(|| format!("{}", path.display()))?;
        let taken = Self { domain: domain.clone(), _lock: lock, registered: Vec::new() };
        taken.end_leftovers()?;
        domain.remove_bus_files()?;
        Ok(taken)
    }

    /// Writes a started process down.
    ///
    /// # Errors
    /// Errors of the file system.
    pub(crate) fn register(&mut self, role: Role, pid: i32, incarnation: u32) -> anyhow::Result<()> {
        let Some(start_time) = start_ticks(pid.cast_unsigned()) else { return Ok(()) };
        // Two processes of one role live while one takes over from the other.
        let lives =
            |process: &Registered| start_ticks(process.pid.cast_unsigned()) == Some(process.start_time);
        self.registered.retain(|process| process.role != role.name() || lives(process));
        self.registered.push(Registered { role: role.name().to_owned(), pid, start_time, incarnation });
        let path = self.processes_file();
        let temporary = path.with_extension("tmp");
        std::fs::write(&temporary, serde_json::to_vec_pretty(&self.registered)?)
            .and_then(|()| std::fs::rename(&temporary, &path))
            .with_context(|| format!("{}", path.display()))
    }

    fn clean(&self) -> anyhow::Result<()> {
        self.domain.remove_bus_files()?;
        let directory = self.domain.directory();
        std::fs::remove_dir_all(directory).with_context(|| format!("{}", directory.display()))?;
        if let Some(parent) = directory.parent() {
            // Stays while other systems of this user run.
            let _ = std::fs::remove_dir(parent);
        }
        Ok(())
    }

    fn processes_file(&self) -> PathBuf {
        self.domain.directory().join(PROCESSES_FILE)
    }

    /// Ends processes of an earlier run that are still alive: same id and same start time, so never a stranger.
    fn end_leftovers(&self) -> anyhow::Result<()> {
        let Ok(text) = std::fs::read_to_string(self.processes_file()) else { return Ok(()) };
        let left: Vec<Registered> = serde_json::from_str(&text).unwrap_or_default();
        let alive =
            |process: &&Registered| start_ticks(process.pid.cast_unsigned()) == Some(process.start_time);
        for process in left.iter().filter(alive) {
            tracing::warn!(
                role = process.role,
                pid = process.pid,
                "ending a process that an earlier run left"
            );
            if let Some(group) = Pid::from_raw(process.pid) {
                let _ = kill_process_group(group, Signal::KILL);
            }
        }
        let deadline = runtime::monotonic_ns() + 2_000_000_000;
        while left.iter().any(|process| alive(&process)) && runtime::monotonic_ns() < deadline {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        std::fs::remove_file(self.processes_file()).context("processes of an earlier run")
    }
}

impl Drop for SystemLock {
    fn drop(&mut self) {
        if let Err(error) = self.clean() {
            tracing::warn!("not cleaned up: {error:#}");
        }
    }
}
