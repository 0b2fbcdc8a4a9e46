//! Exit codes of the public interface.

use std::io;
use std::path::{Path, PathBuf};

use rustix::io::Errno;

/// How a command ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Did what was asked; for a run: the goal was reached.
    Done = 0,
    /// The run ended without reaching the goal.
    NotReached = 1,
    /// Wrong usage or a bad file.
    BadInput = 2,
    /// The robot touched an obstacle or a wall.
    Collision = 3,
    /// A process could not be started or kept running.
    ProcessFailed = 4,
    /// An internal error.
    Internal = 5,
}

/// An error that ends a command with a code of its own.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Failure {
    /// The exit code.
    pub exit: Exit,
    /// One message: what, where, which value, what is allowed.
    pub message: String,
}

impl Failure {
    /// Wrong usage or a bad file.
    pub fn bad_input(message: impl std::fmt::Display) -> anyhow::Error {
        Self { exit: Exit::BadInput, message: message.to_string() }.into()
    }

    /// A process could not be started or kept running.
    pub fn process(message: impl std::fmt::Display) -> anyhow::Error {
        Self { exit: Exit::ProcessFailed, message: message.to_string() }.into()
    }

    /// A signal ended a command before it was done.
    pub fn interrupted() -> anyhow::Error {
        Self { exit: Exit::NotReached, message: "interrupted by a signal".to_owned() }.into()
    }
}

/// A new file that can't be written, as on a full disk: wrapped into the errors of its writes.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub(crate) struct Unwritable {
    path: PathBuf,
    source: io::Error,
}

impl Unwritable {
    /// Adds the file to an error of its writes, which keeps its kind.
    pub(crate) fn wrap(path: &Path, source: io::Error) -> io::Error {
        io::Error::new(source.kind(), Self { path: path.to_owned(), source })
    }

    fn is_in(error: &io::Error) -> bool {
        error.get_ref().is_some_and(|inner| inner.is::<Self>())
    }
}

/// The exit code that an error asks for.
pub fn exit_of(error: &anyhow::Error) -> Exit {
    if let Some(failure) = error.downcast_ref::<Failure>() {
        return failure.exit;
    }
    if error.chain().filter_map(|cause| cause.downcast_ref()).any(is_shortage) {
        return Exit::ProcessFailed;
    }
    if error.chain().filter_map(|cause| cause.downcast_ref()).any(Unwritable::is_in) {
        return Exit::BadInput;
    }
    match error.downcast_ref::<runtime::RuntimeError>() {
        Some(
            runtime::RuntimeError::SystemId(_)
            | runtime::RuntimeError::LogFilter(_)
            | runtime::RuntimeError::AlreadyRunning { .. }
            | runtime::RuntimeError::NotRunning(_)
            | runtime::RuntimeError::OfAnother { .. }
            | runtime::RuntimeError::NotPrivate { .. }
            | runtime::RuntimeError::NotOurs { .. }
            | runtime::RuntimeError::NotInASystem(_)
            | runtime::RuntimeError::Layout(_)
            | runtime::RuntimeError::Environment { .. },
        ) => Exit::BadInput,
        Some(runtime::RuntimeError::Stopped(_)) => Exit::NotReached,
        Some(error) if error.is_of_shared_memory() => Exit::ProcessFailed,
        _ => Exit::Internal,
    }
}

/// Whether the machine, or a limit of this process, allows no more files, processes or memory, or no larger file, or the disk is
/// full.
fn is_shortage(error: &std::io::Error) -> bool {
    const SHORTAGES: [Errno; 7] =
        [Errno::MFILE, Errno::NFILE, Errno::NOMEM, Errno::AGAIN, Errno::FBIG, Errno::NOSPC, Errno::DQUOT];
    Errno::from_io_error(error).is_some_and(|errno| SHORTAGES.contains(&errno))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortage_is_no_internal_error() {
        let error = |errno: Errno| {
            let source = std::io::Error::from(errno);
            anyhow::Error::from(runtime::RuntimeError::System { action: "make the stop word", source })
        };
        assert_eq!(exit_of(&error(Errno::MFILE).context("start")), Exit::ProcessFailed);
        assert_eq!(exit_of(&error(Errno::INVAL)), Exit::Internal);
    }

    #[test]
    fn shared_memory_that_can_only_be_read_is_a_fault_of_the_machine_and_another_file_is_not() {
        let exit = |path: &str| {
            let source = std::io::Error::from(Errno::ROFS);
            exit_of(&runtime::RuntimeError::File { path: path.into(), source }.into())
        };
        assert_eq!(exit("/dev/shm/scanloop-abc"), Exit::ProcessFailed);
        assert_eq!(exit("/tmp/scanloop-0"), Exit::Internal);
    }
}
