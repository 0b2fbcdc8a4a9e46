//! What can go wrong between a process and the bus.

use std::fmt::Display;
use std::path::PathBuf;

use rustix::io::Errno;
use shared_types::{Difference, Role, Topic};

use crate::shared_memory::{SHARED_MEMORY, Shortage};

/// An error of the bus, or of the files and settings around it.
#[derive(Debug, thiserror::Error)]
pub enum RuntimeError {
    /// The process was started by hand, not by an orchestrator.
    #[error("{0} is not set: processes are started by `scanloop run`, or joined with `scanloop swap`")]
    NotInASystem(&'static str),
    /// A system id that can't be part of file names.
    #[error("system id `{0}` is not allowed: 1 to 16 letters, digits or `-`")]
    SystemId(String),
    /// An environment variable that holds no number.
    #[error("{variable} = `{value}` is not a number above 0")]
    Environment {
        /// Name of the variable.
        variable: &'static str,
        /// Its value.
        value: String,
    },
    /// A log filter that can't be read.
    #[error(
        "SCANLOOP_LOG = `{0}` is not allowed: off, error, warn, info, debug or trace, also for single targets \
         (`warn,nmpc=debug`)"
    )]
    LogFilter(String),
    /// Another orchestrator runs a system of this id.
    #[error("system `{system_id}` is already running (process {pid}); choose another with --system-id")]
    AlreadyRunning {
        /// The system id.
        system_id: String,
        /// The process that holds it.
        pid: String,
    },
    /// No system of this id is running.
    #[error("system `{0}` is not running")]
    NotRunning(String),
    /// The system of this id is another user's.
    #[error(
        "system `{system_id}` is that of user {uid}: run this command as that user, with {}={}; as root, \
         `scanloop stop --uid {uid}` stops it",
        crate::RUNTIME_DIR_VARIABLE,
        place.display()
    )]
    OfAnother {
        /// Its id.
        system_id: String,
        /// The user it runs as.
        uid: u32,
        /// The directory that holds the systems of that user.
        place: PathBuf,
    },
    /// The run was stopped, and a stop is never taken back.
    #[error("system `{0}` was stopped: `scanloop run` starts it anew once it has ended")]
    Stopped(String),
    /// A directory that must be private to this user is not.
    #[error(
        "{} {reason}; it has to be a directory of this user with mode 0700: change or remove it, or name another with {}",
        path.display(),
        crate::RUNTIME_DIR_VARIABLE
    )]
    NotPrivate {
        /// The directory.
        path: PathBuf,
        /// What is wrong with it, with its owner.
        reason: String,
    },
    /// A directory with the name of a system that was not made for one.
    #[error(
        "{} is no directory of a system, it has no run id: it is left as it is; move it, or choose another --system-id or \
         another {}",
        path.display(),
        crate::RUNTIME_DIR_VARIABLE
    )]
    NotOurs {
        /// The directory.
        path: PathBuf,
    },
    /// A role opens a topic that it does not read or write.
    #[error("role {role} does not {verb} topic {topic}")]
    NotYourTopic {
        /// The role.
        role: Role,
        /// `read` or `write`.
        verb: &'static str,
        /// The topic.
        topic: Topic,
    },
    /// A process opens a topic that the system file does not give it.
    #[error("{process} neither reads nor writes topic {topic} by the system file")]
    NoOwnTopic {
        /// Name of the process.
        process: String,
        /// The topic.
        topic: String,
    },
    /// A process uses the wrong end of a topic.
    #[error("topic {topic} is {verb} by this process, by the system file")]
    WrongEnd {
        /// The topic.
        topic: String,
        /// `read` or `written`.
        verb: &'static str,
    },
    /// The process was built against another layout of a sample than the system.
    #[error(
        "built against another layout: {0}; build it again with what `scanloop types` of this system prints"
    )]
    Layout(Difference),
    /// The settings file of the system could not be used.
    #[error("{}: {reason}", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file or directory of the system could not be used.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The bus refused something.
    #[error("{action}: {reason}")]
    Bus {
        /// What was tried.
        action: String,
        /// The error of iceoryx2.
        reason: String,
    },
    /// There is not enough shared memory.
    #[error(transparent)]
    SharedMemory(#[from] Shortage),
    /// A person does not drive, or a goal is not taken, with what `scanloop` says.
    #[error("{0}")]
    Refused(String),
    /// A system call failed.
    #[error("{action}: {source}")]
    System {
        /// What was tried.
        action: &'static str,
        /// The error of the operating system.
        source: std::io::Error,
    },
}

impl RuntimeError {
    /// Whether the kernel allows no more open files or memory: that says nothing of the file.
    pub(crate) fn is_shortage(&self) -> bool {
        matches!(self, Self::File { source, .. } if Errno::from_io_error(source).is_some_and(is_shortage))
    }

    /// Whether shared memory could not be used: it is full, missing or can only be read.
    pub fn is_of_shared_memory(&self) -> bool {
        match self {
            Self::SharedMemory(_) => true,
            Self::File { path, .. } => path.starts_with(SHARED_MEMORY),
            _ => false,
        }
    }

    pub(crate) fn file(path: impl Into<PathBuf>, source: impl Into<std::io::Error>) -> Self {
        Self::File { path: path.into(), source: source.into() }
    }

    pub(crate) fn settings(path: PathBuf, reason: impl Display) -> Self {
        Self::Settings { path, reason: reason.to_string() }
    }

    pub(crate) fn bus(action: impl Into<String>, reason: impl std::fmt::Debug) -> Self {
        Self::Bus { action: action.into(), reason: format!("{reason:?}") }
    }
}

/// Whether the kernel allows no more open files or memory.
pub(crate) fn is_shortage(errno: Errno) -> bool {
    [Errno::MFILE, Errno::NFILE, Errno::NOMEM].contains(&errno)
}
