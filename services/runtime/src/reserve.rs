//! Shared memory is checked and allocated before it is used, so that a full `/dev/shm` is an error and not a signal.
//!
//! The bus makes its files sparse. The first write to a page that the file system can't provide ends a process by
//! SIGBUS; when a new process joins, this may be the robot. Three measures prevent it. The room is checked before any
//! file is made ([`Reserve::take`]). New files are allocated to their length at once ([`allocate_files`]). And the
//! orchestrator holds a [`Reserve`] for one more process, which it frees right before it starts one.
//!
//! Limits: between check and allocation other programs may take the room; then SIGBUS may end the process that joins,
//! which logs it, see `crash.rs`. A memory limit of a control group is not the size of the file system:
//! the kernel kills the process that exceeds it.

use std::fs::OpenOptions;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{FallocateFlags, Mode, OFlags, fallocate, fstatvfs, open};
use rustix::io::Errno;
use shared_types::{Role, TOPICS, Topic};

use crate::qos::{Qos, qos};
use crate::shared_memory::{self, SHARED_MEMORY, Shortage};
use crate::{Domain, RuntimeError};

/// Files of a node: its own, its monitor and its marks in the services that it uses, a page each [bytes].
pub(crate) const NODE_BYTES: u64 = 128 << 10;
/// Files of the two services of a topic, for samples and for events [bytes].
const SERVICE_BYTES: u64 = 64 << 10;
/// Size of one block of `st_blocks` [bytes].
const BLOCK: u64 = 512;
/// Shortest scan period; longer ones need less memory [ns].
const MIN_PERIOD_NS: u64 = 1_000_000;
/// A running process gives a new file its length within this time.
const FILE_MADE: Duration = Duration::from_millis(20);

/// Shared memory that is kept for a process that may have to be started; freed when dropped.
///
/// It is a file without a name, so that nothing is left however its process ends.
#[derive(Debug)]
pub struct Reserve {
    /// `None` where the file system has no files without a name: there the room is only checked.
    _file: Option<OwnedFd>,
}

impl Reserve {
    /// Allocates so many bytes.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when they are not free; then nothing was allocated, not even for a moment.
    pub fn take(bytes: u64) -> Result<Self, RuntimeError> {
        require(&directory()?, bytes)?;
        let flags = OFlags::RDWR | OFlags::TMPFILE | OFlags::CLOEXEC;
        match open(SHARED_MEMORY, flags, Mode::RUSR | Mode::WUSR) {
            Ok(file) => allocate(&file, bytes, bytes).map(|()| Self { _file: Some(file) }),
            Err(Errno::OPNOTSUPP | Errno::ISDIR | Errno::INVAL) => Ok(Self { _file: None }),
            Err(reason) => Err(error(reason)),
        }
    }

    /// Files of a system and of one more process; 350 to 380 were counted.
    pub const FILES_OF_A_SYSTEM: u64 = 512;

    /// Passes when the files of a system can be made.
    ///
    /// # Errors
    /// [`RuntimeError::File`] with both numbers.
    pub fn require_files() -> Result<(), RuntimeError> {
        let status = fstatvfs(directory()?).map_err(error)?;
        // A file system without a limit reports none.
        if status.f_files == 0 || status.f_favail >= Self::FILES_OF_A_SYSTEM {
            return Ok(());
        }
        let (free, needed) = (status.f_favail, Self::FILES_OF_A_SYSTEM);
        let found = format!("{free} more files can be made there, {needed} are needed");
        Err(RuntimeError::file(SHARED_MEMORY, std::io::Error::new(std::io::ErrorKind::StorageFull, found)))
    }

    /// Memory of one more process in a system with this scan period, of the role that needs most [bytes].
    pub fn of_a_process(period_ns: u64) -> u64 {
        Role::ALL.iter().map(|role| process_bytes(*role, period_ns)).max().unwrap_or_default()
    }

    /// Memory of a system: all services, all processes, the orchestrator, and one more process [bytes].
    pub fn of_a_system(period_ns: u64) -> u64 {
        let services = SERVICE_BYTES * TOPICS.len() as u64;
        let processes: u64 = Role::ALL.iter().map(|role| process_bytes(*role, period_ns)).sum();
        let orchestrator = observer_bytes(period_ns) + output_bytes(Topic::Directive, period_ns);
        services + processes + orchestrator + Self::of_a_process(period_ns)
    }
}

/// Checks that there is room for the ports of a process of a role.
///
/// # Errors
/// [`RuntimeError::SharedMemory`] when there is not.
pub(crate) fn require_room_of(role: Role, period_ns: u64) -> Result<(), RuntimeError> {
    require(&directory()?, process_bytes(role, period_ns))
}

/// Checks that there is room for the ports of an observer, at any scan period.
///
/// # Errors
/// [`RuntimeError::SharedMemory`] when there is not.
pub(crate) fn require_room() -> Result<(), RuntimeError> {
    require(&directory()?, observer_bytes(MIN_PERIOD_NS))
}

fn directory() -> Result<OwnedFd, RuntimeError> {
    open(SHARED_MEMORY, OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty()).map_err(error)
}

/// Allocates all files that a system has in shared memory to their length. Those allocated before are skipped.
///
/// # Errors
/// [`RuntimeError::SharedMemory`] when there is no room; then some files are allocated and others are not.
pub(crate) fn allocate_files(domain: &Domain) -> Result<(), RuntimeError> {
    files(domain, is_sparse)?.iter().try_for_each(|path| allocate_file(path))
}

/// Removes empty files of a system in shared memory: their process died while it made them, or they were truncated.
/// iceoryx2 0.10 waits for ever for the content of such a file, also in a clean-up.
pub(crate) fn remove_empty_files(domain: &Domain) {
    let is_empty = |file: &std::fs::Metadata| file.len() == 0;
    let before = files(domain, is_empty).unwrap_or_default();
    if before.is_empty() {
        return;
    }
    std::thread::sleep(FILE_MADE);
    for path in files(domain, is_empty).unwrap_or_default() {
        if before.contains(&path) && std::fs::remove_file(&path).is_ok() {
            tracing::warn!("{} was empty and is removed", path.display());
        }
    }
}

/// Files of a system in shared memory that `is_wanted` accepts.
fn files(domain: &Domain, is_wanted: fn(&std::fs::Metadata) -> bool) -> Result<Vec<PathBuf>, RuntimeError> {
    let ours = shared_memory::files(domain.shared_memory_prefix())
        .map_err(|source| RuntimeError::file(SHARED_MEMORY, source))?;
    let wanted = ours.filter(|entry| entry.metadata().is_ok_and(|file| file.is_file() && is_wanted(&file)));
    Ok(wanted.map(|entry| entry.path()).collect())
}

fn is_sparse(file: &std::fs::Metadata) -> bool {
    file.blocks() * BLOCK < file.len()
}

/// Allocates one file; one that its process has removed meanwhile is skipped.
fn allocate_file(path: &Path) -> Result<(), RuntimeError> {
    let error = |source| RuntimeError::file(path, source);
    let flags = (OFlags::NOFOLLOW | OFlags::CLOEXEC).bits().cast_signed();
    let file = match OpenOptions::new().write(true).custom_flags(flags).open(path) {
        Err(gone) if gone.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        opened => opened.map_err(error)?,
    };
    let status = file.metadata().map_err(error)?;
    let missing = status.len().saturating_sub(status.blocks() * BLOCK);
    if status.nlink() == 0 || missing == 0 {
        return Ok(());
    }
    require(&file, missing)?;
    allocate(&file, status.len(), missing)
}

/// Allocates a file to `length`, for which `missing` bytes are needed, where the file system can; its content stays.
pub(crate) fn allocate(file: impl AsFd, length: u64, missing: u64) -> Result<(), RuntimeError> {
    match fallocate(&file, FallocateFlags::empty(), 0, length) {
        Ok(()) | Err(Errno::OPNOTSUPP) => Ok(()),
        Err(Errno::NOSPC) => Err(Shortage { needed: missing, free: free(file)?.unwrap_or_default() }.into()),
        Err(reason) => Err(error(reason)),
    }
}

/// Checks the free room first, because an allocation that fails takes all of it for a moment.
fn require(file: impl AsFd, needed: u64) -> Result<(), RuntimeError> {
    match free(file)? {
        Some(free) if free < needed => Err(Shortage { needed, free }.into()),
        _ => Ok(()),
    }
}

/// Free bytes of the file system; `None` when it has no limit.
fn free(file: impl AsFd) -> Result<Option<u64>, RuntimeError> {
    let status = fstatvfs(file).map_err(error)?;
    Ok((status.f_blocks > 0).then(|| status.f_bavail * status.f_frsize))
}

fn error(reason: Errno) -> RuntimeError {
    RuntimeError::file(SHARED_MEMORY, reason)
}

/// Shared memory of a process of a role, and of the orchestrator to watch its outputs, at most [bytes].
pub(crate) fn process_bytes(role: Role, period_ns: u64) -> u64 {
    let (output, input) =
        (|topic: Topic| output_bytes(topic, period_ns), |topic: Topic| input_bytes(topic, period_ns));
    let written = TOPICS.iter().filter(|topic| topic.writer() == Some(role));
    let common = output(Topic::Heartbeat)
        + output(Topic::Checkpoint)
        + output(Topic::Journal)
        + input(Topic::Checkpoint)
        + input(Topic::Directive);
    let outputs: u64 = written.map(|topic| output(*topic) + input(*topic)).sum();
    let inputs: u64 = role.reads().iter().map(|topic| input(*topic)).sum();
    NODE_BYTES + common + outputs + inputs
}

/// Shared memory of an observer of all topics, at most [bytes].
fn observer_bytes(period_ns: u64) -> u64 {
    NODE_BYTES + TOPICS.iter().map(|topic| input_bytes(*topic, period_ns)).sum::<u64>()
}

/// Shared memory of a topic that a system file adds: its services, its writer and the successor of it, and all readers that
/// there may be [bytes].
pub(crate) fn bytes_of_topic(qos: Qos, size: usize) -> u64 {
    SERVICE_BYTES + 2 * output_of(qos, size) + qos.subscribers as u64 * input_of(qos)
}

/// Size of the file system; `None` when it has no limit [bytes].
pub(crate) fn total() -> Result<Option<u64>, RuntimeError> {
    let status = fstatvfs(directory()?).map_err(error)?;
    Ok((status.f_blocks > 0).then(|| status.f_blocks * status.f_frsize))
}

/// Samples of one publisher, and its connections to all readers that there may be [bytes].
fn output_bytes(topic: Topic, period_ns: u64) -> u64 {
    output_of(qos(topic, period_ns), topic.size())
}

fn output_of(qos: Qos, size: usize) -> u64 {
    qos.samples_bytes(size) + qos.subscribers as u64 * qos.connection_bytes()
}

/// Connections of one reader to all publishers that there may be [bytes].
fn input_bytes(topic: Topic, period_ns: u64) -> u64 {
    input_of(qos(topic, period_ns))
}

fn input_of(qos: Qos) -> u64 {
    qos.publishers as u64 * qos.connection_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_without_content_are_removed_and_others_stay() {
        let domain = Domain::create(&format!("empty{}", std::process::id())).unwrap();
        let path = |name| PathBuf::from(format!("{SHARED_MEMORY}/{}{name}", domain.shared_memory_prefix()));
        let (cut, whole) = (path("a.connection"), path("b.connection"));
        std::fs::write(&cut, "").unwrap();
        std::fs::write(&whole, "content").unwrap();
        remove_empty_files(&domain);
        assert!(!cut.exists() && whole.exists());
        domain.remove().unwrap();
    }
}
