//! Limits of the kernel, and a umask, that may be too small for a system.

use rustix::fs::Mode;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit, umask};

use crate::exit::Failure;

/// Twice the measured use of the deepest computation [bytes].
const MIN_STACK_BYTES: u64 = 1 << 20;
/// An orchestrator has 150 files open while it drives, and more during a swap.
const MIN_OPEN_FILES: u64 = 256;
/// The limit that is requested where it is allowed.
const OPEN_FILES: u64 = 1024;

/// Clears the owner's bits of the umask: with them, only root could enter the directories that the bus makes. The
/// rest of the umask stays as the user wants it.
pub fn keep_own_rights() {
    let mask = umask(Mode::RWXG | Mode::RWXO);
    umask(mask & (Mode::RWXG | Mode::RWXO));
}

/// Passes when the stack suffices; raises its limit when that is allowed. The kernel checks the limit whenever the
/// stack of a process grows, so this holds at once, and for all processes started from now on.
///
/// # Errors
/// The limit, what is needed, and the command that sets it; exit code 4.
pub fn require_stack() -> anyhow::Result<()> {
    let bytes = raise(Resource::Stack, MIN_STACK_BYTES);
    if bytes >= MIN_STACK_BYTES {
        return Ok(());
    }
    let (limit, needed) = (bytes / 1024, MIN_STACK_BYTES / 1024);
    Err(Failure::process(format!(
        "the stack is limited to {limit} KiB, {needed} are needed: `ulimit -s {needed}`"
    )))
}

/// Passes when enough files can be open at a time; raises the limit when that is allowed.
///
/// # Errors
/// As [`require_stack`].
pub fn require_open_files() -> anyhow::Result<()> {
    let files = raise(Resource::Nofile, OPEN_FILES);
    if files >= MIN_OPEN_FILES {
        return Ok(());
    }
    Err(Failure::process(format!(
        "at most {files} files may be open, {MIN_OPEN_FILES} are needed: `ulimit -n {MIN_OPEN_FILES}`"
    )))
}

/// Raises a limit to `wanted`, or as far as is allowed; returns the new limit.
fn raise(resource: Resource, wanted: u64) -> u64 {
    let Rlimit { current, maximum } = getrlimit(resource);
    let limit = current.unwrap_or(u64::MAX);
    let allowed = wanted.min(maximum.unwrap_or(u64::MAX));
    if limit < allowed && setrlimit(resource, Rlimit { current: Some(allowed), maximum }).is_ok() {
        allowed
    } else {
        limit
    }
}
