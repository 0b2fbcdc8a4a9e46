//! One process of the run: start it, signal it, see it end.
//!
//! The process leads a group of its own, so that a signal reaches all processes that it starts, and ctrl-C in the
//! terminal reaches the orchestrator alone. Its end wakes a `poll` through a pidfd. Signals go out only while
//! the leader is not reaped: until then the kernel gives its number to no other process or group, so nothing
//! that was not started here can be hit. When the leader has ended, the rest of its group is killed before the
//! leader is reaped.
//!
//! An adopted process is no child: its descriptor shows that it ended, not how. Its number may be given to others at
//! any time, so signals go through the descriptor, and to the rest of its group one by one.
//!
//! Where this fails: a descendant that opens a session of its own leaves the group and is not found. A process
//! outlives an orchestrator that is killed, on purpose: the loop drives on without it. Dropping a [`Child`] kills its
//! process.

mod script;

use std::ffi::OsString;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use console::control_group;
use console::exit::Failure;
use runtime::{Identified, Seen, identify, processes_of};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitId, WaitIdOptions, kill_process_group, pidfd_open, pidfd_send_signal, waitid,
};

pub use self::script::require_script;
use crate::child_log::ChildLog;
use crate::supervisor::ProcessExit;

/// Variables of systemd that only the orchestrator may use.
const NOT_INHERITED: [&str; 4] = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "JOURNAL_STREAM"];

/// Clock ticks per second in /proc: a constant of the interface of Linux.
const TICKS_PER_SECOND: f64 = 100.0;

/// What to start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Launch {
    /// The program, by path or to be found in `PATH`, and its arguments.
    pub command: Vec<OsString>,
    /// Variables set in addition to the inherited ones.
    pub environment: Vec<(OsString, OsString)>,
}

/// Why a process could not be started.
#[derive(Debug, thiserror::Error)]
pub enum ChildError {
    /// There is no program.
    #[error("the command is empty")]
    Empty,
    /// The program, or the interpreter that its first line names, does not exist.
    #[error("command `{0}` was not found")]
    NotFound(String),
    /// The program may not be executed.
    #[error("command `{0}` may not be executed: permission denied")]
    NotExecutable(String),
    /// The kernel can't execute the file, or not with the interpreter that its first line names.
    #[error("command `{command}` can't be executed: {reason}")]
    NoProgram {
        /// The program.
        command: String,
        /// What the file is instead, with what is to be done.
        reason: String,
    },
    /// Anything else that the kernel refused.
    #[error("command `{command}` could not be started: {source}")]
    Refused {
        /// The program.
        command: String,
        /// The error of the kernel.
        source: io::Error,
    },
}

/// What a process has used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    /// Time on a processor since its start, all threads, without its children [s].
    pub cpu_s: f64,
    /// Resident memory, shared parts included [KiB].
    pub memory_kib: u64,
}

/// A process that leads its own group, started here or adopted.
#[derive(Debug)]
pub struct Child {
    origin: Origin,
    pid: Pid,
    pidfd: OwnedFd,
    exit: Option<ProcessExit>,
}

#[derive(Debug)]
enum Origin {
    /// Its number is ours until it is reaped.
    Started(std::process::Child),
    /// It belongs to the run of this id.
    Adopted(String),
}

impl Child {
    /// Starts a process with no input, whose output goes to `log`.
    ///
    /// # Errors
    /// [`ChildError`], with the command named.
    pub fn spawn(launch: &Launch, log: &ChildLog) -> Result<Self, ChildError> {
        let (program, arguments) = launch.command.split_first().ok_or(ChildError::Empty)?;
        let name = || program.to_string_lossy().into_owned();
        let refused = |source| ChildError::Refused { command: name(), source };
        let mut command = Command::new(program);
        command.args(arguments).envs(launch.environment.iter().map(|(key, value)| (key, value)));
        NOT_INHERITED.iter().for_each(|variable| _ = command.env_remove(variable));
        command.stdin(Stdio::null()).process_group(0);
        command.stdout(log.output().map_err(refused)?).stderr(log.output().map_err(refused)?);
        let no_program = |reason| ChildError::NoProgram { command: name(), reason };
        if let Some(reason) = script::spoilt_first_line(Path::new(program)) {
            return Err(no_program(reason));
        }
        let mut process = command.spawn().map_err(|source| match source.kind() {
            // A program that is cut off can't be read where its parts should be.
            _ if [Errno::NOEXEC, Errno::IO]
                .map(|errno| Some(errno.raw_os_error()))
                .contains(&source.raw_os_error()) =>
            {
                no_program(script::why_not_executed(Path::new(program)))
            }
            io::ErrorKind::NotFound => script::unusable_interpreter(Path::new(program))
                .map_or_else(|| ChildError::NotFound(name()), no_program),
            io::ErrorKind::PermissionDenied => Some(Path::new(program))
                .filter(|program| script::is_executable(program))
                .and_then(script::unusable_interpreter)
                .map_or_else(|| ChildError::NotExecutable(name()), no_program),
            _ => refused(source),
        })?;
        let pid = Pid::from_child(&process);
        match pidfd_open(pid, PidfdFlags::empty()) {
            Ok(pidfd) => Ok(Self { pid, pidfd, exit: None, origin: Origin::Started(process) }),
            Err(error) => {
                // A process whose end cannot be seen is not kept.
                let _ = kill_process_group(pid, Signal::KILL);
                let _ = process.wait();
                Err(refused(error.into()))
            }
        }
    }

    /// A process that another orchestrator started.
    pub fn adopt(process: Identified) -> Option<Self> {
        let pid = Pid::from_raw(process.pid().cast_signed())?;
        let origin = Origin::Adopted(process.identity().run_id.clone());
        Some(Self { origin, pid, pidfd: process.into_descriptor(), exit: None })
    }

    /// Its process id, which is the id of its group.
    pub fn pid(&self) -> u32 {
        self.pid.as_raw_nonzero().get().cast_unsigned()
    }

    /// Leaves the process as it is: from now on it is neither watched nor ended.
    pub fn release(&mut self) {
        self.exit = Some(ProcessExit::Unknown);
    }

    /// Asks the group to end (SIGTERM), also one that was suspended (SIGCONT); nothing happens when the process is known to have ended.
    ///
    /// # Errors
    /// When the kernel refuses, which it does for a process that has become another user's.
    pub fn terminate(&self) -> io::Result<()> {
        self.signal(Signal::TERM)?;
        self.signal(Signal::CONT)
    }

    /// Kills the group (SIGKILL); nothing happens when the process is known to have ended.
    ///
    /// # Errors
    /// When the kernel refuses, which it does for a process that has become another user's.
    pub fn kill(&self) -> io::Result<()> {
        self.signal(Signal::KILL)
    }

    /// How the process ended, if it has. It is then reaped, if it is a child, and the rest of its group killed.
    ///
    /// # Errors
    /// Those of the kernel's wait, which do not happen to a child of ours.
    pub fn try_wait(&mut self) -> io::Result<Option<ProcessExit>> {
        if self.exit.is_some() {
            return Ok(self.exit);
        }
        let pid = self.pid();
        let process = match &mut self.origin {
            Origin::Started(process) => process,
            Origin::Adopted(run_id) => {
                if wait_readable(&self.pidfd, Duration::ZERO)? {
                    signal_group(run_id, pid, Signal::KILL);
                    self.exit = Some(ProcessExit::Unknown);
                }
                return Ok(self.exit);
            }
        };
        // Check without reaping: the group may be signalled only as long as its leader is not reaped.
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let ended = loop {
            match waitid(WaitId::PidFd(self.pidfd.as_fd()), options) {
                Err(rustix::io::Errno::INTR) => {}
                other => break other?.is_some(),
            }
        };
        if ended {
            let _ = kill_process_group(self.pid, Signal::KILL);
            self.exit = process.try_wait()?.map(ProcessExit::from);
        }
        Ok(self.exit)
    }

    /// Waits for the end of the process, but not longer than `limit`.
    ///
    /// # Errors
    /// As [`Child::try_wait`].
    pub fn wait_for(&mut self, limit: Duration) -> io::Result<Option<ProcessExit>> {
        let started = Instant::now();
        loop {
            let exit = self.try_wait()?;
            let left = limit.saturating_sub(started.elapsed());
            if exit.is_some() || left.is_zero() {
                return Ok(exit);
            }
            wait_readable(&self.pidfd, left)?;
        }
    }

    /// What the process has used so far; `None` when it has ended.
    pub fn usage(&self) -> Option<Usage> {
        if self.exit.is_some() {
            return None;
        }
        usage_of(self.pid())
    }

    fn signal(&self, signal: Signal) -> io::Result<()> {
        if self.exit.is_some() {
            return Ok(());
        }
        if let Origin::Adopted(run_id) = &self.origin {
            let _ = pidfd_send_signal(&self.pidfd, signal);
            signal_group(run_id, self.pid(), signal);
            return Ok(());
        }
        match kill_process_group(self.pid, signal) {
            // Only the leader is left of the group; it has ended and waits to be reaped.
            Err(rustix::io::Errno::SRCH) => Ok(()),
            other => Ok(other?),
        }
    }
}

impl AsFd for Child {
    /// The pidfd: readable once the process has ended.
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pidfd.as_fd()
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        if self.exit.is_none() {
            let _ = self.kill();
            // A killed process ends within milliseconds unless it hangs in the kernel, where waiting does not help.
            let _ = self.wait_for(Duration::from_secs(1));
        }
    }
}

/// Whether a descriptor becomes readable within `limit`; a signal may end the wait earlier.
fn wait_readable(descriptor: &OwnedFd, limit: Duration) -> io::Result<bool> {
    let timeout = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: limit.subsec_nanos().into() };
    match poll(&mut [PollFd::new(descriptor, PollFlags::IN)], Some(&timeout)) {
        Err(rustix::io::Errno::INTR) => Ok(false),
        ready => Ok(ready? > 0),
    }
}

/// The file of this program, also when an update has replaced it meanwhile.
pub fn this_program() -> PathBuf {
    match std::env::current_exe() {
        Ok(path) if path.exists() => path,
        _ => PathBuf::from("/proc/self/exe"),
    }
}

/// A program that is built apart, beside this one or in `PATH`; `folder` has its sources.
///
/// # Errors
/// Where it was looked for, and the command that builds it; exit code 2.
pub fn other_program(name: &str, folder: &str) -> anyhow::Result<PathBuf> {
    let beside = this_program().parent().map(|folder| folder.join(name));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let in_path = std::env::split_paths(&path).map(|folder| folder.join(name));
    beside.into_iter().chain(in_path).find(|file| file.is_file()).ok_or_else(|| {
        Failure::bad_input(format!(
            "{name} is neither beside this program nor in PATH; build it with \
             `cargo build --release --manifest-path {folder}/Cargo.toml` and copy it there"
        ))
    })
}

/// Whether a process has work to do, on a processor or waiting for one or for memory, and its processor time [s].
pub fn is_runnable(pid: u32) -> Option<(bool, f64)> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let state = stat.rsplit_once(')')?.1.trim_start().chars().next()?;
    Some((matches!(state, 'R' | 'D'), usage_of(pid)?.cpu_s))
}

/// Whether a process does not run until another one lets it: suspended by a signal, or frozen with its control group.
/// One that a debugger holds is none: a signal does not continue it.
pub fn is_suspended(pid: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    let state = stat.rsplit_once(')').and_then(|(_, fields)| fields.trim_start().chars().next());
    state == Some('T') || control_group::is_frozen(pid)
}

/// What a process has used so far; `None` when there is none.
pub fn usage_of(pid: u32) -> Option<Usage> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name of the program may hold blanks and brackets; the first field behind it is the third.
    let (_name, fields) = stat.rsplit_once(')')?;
    let ticks = |place: usize| fields.split_whitespace().nth(place - 3)?.parse::<u64>().ok();
    let [user, system] = [ticks(14)?, ticks(15)?];
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    // A zombie has no memory and no such line.
    let memory = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let memory_kib = memory.and_then(|text| text.split_whitespace().next()?.parse().ok()).unwrap_or(0);
    Some(Usage { cpu_s: (user + system) as f64 / TICKS_PER_SECOND, memory_kib })
}

/// Sends a signal to all processes of a run in the group that `leader` led, but not to `leader` itself.
///
/// The kernel may reuse the number of a group whose leader is not a child of this process, so each one is identified.
fn signal_group(run_id: &str, leader: u32, signal: Signal) {
    let is_member = |seen: &&Seen| seen.group == leader && seen.identity.pid != leader;
    for seen in processes_of(run_id).iter().filter(is_member) {
        if let Ok(process) = identify(&seen.identity) {
            process.signal(signal);
        }
    }
}

#[cfg(test)]
mod tests;
