//! Which process is one of ours: never a stranger that was given the number of a process that died.
//!
//! A process is written down with its id, its start time and its incarnation. Whoever wants to signal it later
//! opens it by its id first ([`identify`]) and then compares: the start time, and the system and incarnation in its
//! environment. When the opened process still lives after that, everything that was read was its own, and what is
//! sent through its descriptor reaches it or nobody.
//!
//! Where this fails: the environment is the one at the start of the program; a process that overwrites the memory
//! of its environment is taken for a stranger, which is the safe side.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::{Deserialize, Serialize};

use crate::{INCARNATION_VARIABLE, SYSTEM_ID_VARIABLE};

/// Name of the file in the directory of the system that lists its processes.
pub const PROCESSES_FILE: &str = "processes.toml";

/// A process as it is written down.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Process id, also the id of its process group.
    pub pid: u32,
    /// Start time in clock ticks since boot.
    pub start_ticks: u64,
    /// Its incarnation.
    pub incarnation: u32,
}

/// A process that was opened and is the one that was written down.
#[derive(Debug)]
pub struct Identified {
    identity: Identity,
    pidfd: OwnedFd,
}

/// Why there is no process of ours under a number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotOurs {
    /// It has ended.
    #[error("process {0} has ended")]
    Ended(u32),
    /// The number was given to another process.
    #[error("process {pid} is a stranger: it was started at {found} ticks after boot, not at {expected}")]
    Recycled {
        /// The process id.
        pid: u32,
        /// Its start time.
        found: u64,
        /// The start time written down.
        expected: u64,
    },
    /// It belongs to another system, or to none.
    #[error("process {pid} is a stranger: its {variable} is {found}, not `{expected}`")]
    Foreign {
        /// The process id.
        pid: u32,
        /// What tells it from ours.
        variable: &'static str,
        /// What it has there.
        found: String,
        /// What ours has there.
        expected: String,
    },
}

/// Opens a process that was written down for `system_id`, and makes sure that it is the one.
///
/// # Errors
/// [`NotOurs`] with the difference.
pub fn identify(system_id: &str, identity: &Identity) -> Result<Identified, NotOurs> {
    let &Identity { pid, start_ticks: expected, incarnation } = identity;
    let ended = || NotOurs::Ended(pid);
    let raw = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or_else(ended)?;
    let pidfd = pidfd_open(raw, PidfdFlags::empty()).map_err(|_| ended())?;
    let found = start_ticks(pid).ok_or_else(ended)?;
    let environment = environment(pid);
    let process = Identified { identity: identity.clone(), pidfd };
    // Only now is it certain that what was read belongs to the process behind the descriptor.
    if process.has_ended() {
        return Err(ended());
    }
    if found != expected {
        return Err(NotOurs::Recycled { pid, found, expected });
    }
    for (variable, expected) in
        [(SYSTEM_ID_VARIABLE, system_id.to_owned()), (INCARNATION_VARIABLE, incarnation.to_string())]
    {
        let found = value_of(&environment, variable);
        if found.as_deref() != Some(&expected) {
            let found = found.map_or_else(|| "not set".to_owned(), |value| format!("`{value}`"));
            return Err(NotOurs::Foreign { pid, variable, found, expected });
        }
    }
    Ok(process)
}

impl Identified {
    /// What was written down of it.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.identity.pid
    }

    /// Whether it has ended, reaped or not.
    pub fn has_ended(&self) -> bool {
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        poll(&mut [PollFd::new(&self.pidfd, PollFlags::IN)], Some(&now)).is_ok_and(|ready| ready > 0)
    }

    /// Sends it a signal; one that has ended gets none, nor does anyone else.
    pub fn signal(&self, signal: Signal) {
        let _ = pidfd_send_signal(&self.pidfd, signal);
    }

    /// The descriptor that becomes readable when it ends.
    pub fn into_descriptor(self) -> OwnedFd {
        self.pidfd
    }
}

impl AsFd for Identified {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pidfd.as_fd()
    }
}

/// All living processes whose environment names `system_id` and an incarnation: started by an orchestrator of that
/// system, or by one of its processes. With the ids of their groups.
pub fn processes_of(system_id: &str) -> Vec<(Identity, u32)> {
    let Ok(entries) = std::fs::read_dir("/proc") else { return Vec::new() };
    let pids = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter_map(|pid| {
        let environment = environment(pid);
        let is_ours = value_of(&environment, SYSTEM_ID_VARIABLE)? == system_id;
        let incarnation = value_of(&environment, INCARNATION_VARIABLE)?.parse().ok()?;
        let fields = stat_fields(pid)?;
        let [group, start_ticks] = [stat_number(&fields, 5)?, stat_number(&fields, 22)?];
        is_ours.then_some((Identity { pid, start_ticks, incarnation }, u32::try_from(group).ok()?))
    })
    .collect()
}

/// When a process was started, in clock ticks since boot; `None` when there is no such process, or only its remains.
pub fn start_ticks(pid: u32) -> Option<u64> {
    let fields = stat_fields(pid)?;
    let is_zombie = matches!(fields.split_whitespace().next(), Some("Z" | "X"));
    if is_zombie { None } else { stat_number(&fields, 22) }
}

/// The fields of /proc/PID/stat behind the name, which may hold blanks and brackets itself.
fn stat_fields(pid: u32) -> Option<String> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit_once(')').map(|(_name, fields)| fields.to_owned())
}

/// A number by its place in the kernel's documentation, where the first field behind the name is the third.
fn stat_number(fields: &str, place: usize) -> Option<u64> {
    fields.split_whitespace().nth(place - 3)?.parse().ok()
}

/// Empty when it is not ours to read, or the process has ended.
fn environment(pid: u32) -> Vec<u8> {
    std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default()
}

fn value_of(environment: &[u8], variable: &str) -> Option<String> {
    environment.split(|byte| *byte == 0).find_map(|text| {
        let value = text.strip_prefix(variable.as_bytes())?.strip_prefix(b"=")?;
        Some(String::from_utf8_lossy(value).into_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Child, Command};

    /// A process with the environment of ours, ended when dropped.
    struct Sleeper(Child);

    impl Sleeper {
        fn new(system_id: &str, incarnation: &str) -> Self {
            let mut command = Command::new("sleep");
            command.arg("60").env(SYSTEM_ID_VARIABLE, system_id).env(INCARNATION_VARIABLE, incarnation);
            let sleeper = Self(command.spawn().unwrap());
            // Until the program is loaded the environment is that of this process.
            while value_of(&environment(sleeper.0.id()), INCARNATION_VARIABLE).is_none() {
                std::thread::yield_now();
            }
            sleeper
        }

        fn identity(&self) -> Identity {
            let pid = self.0.id();
            Identity { pid, start_ticks: start_ticks(pid).unwrap(), incarnation: 7 }
        }
    }

    impl Drop for Sleeper {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    #[test]
    fn a_process_is_ours_by_id_start_time_system_and_incarnation() {
        let sleeper = Sleeper::new("ident-a", "7");
        let identity = sleeper.identity();
        let found = identify("ident-a", &identity).unwrap();
        assert_eq!((found.pid(), found.has_ended()), (identity.pid, false));
        let listed: Vec<Identity> = processes_of("ident-a").into_iter().map(|(found, _)| found).collect();
        assert_eq!(listed, [identity]);
    }

    #[test]
    fn a_stranger_is_refused_and_named() {
        let sleeper = Sleeper::new("ident-b", "7");
        let identity = sleeper.identity();
        let recycled = Identity { start_ticks: identity.start_ticks - 1, ..identity.clone() };
        let message = identify("ident-b", &recycled).unwrap_err().to_string();
        assert!(message.starts_with(&format!("process {} is a stranger: it was started", identity.pid)));
        let message = identify("other", &identity).unwrap_err().to_string();
        assert!(message.ends_with("its SCANLOOP_SYSTEM_ID is `ident-b`, not `other`"), "{message}");
        let older = Identity { incarnation: 6, ..identity.clone() };
        let message = identify("ident-b", &older).unwrap_err().to_string();
        assert!(message.ends_with("its SCANLOOP_INCARNATION is `7`, not `6`"), "{message}");
        let init = Identity { pid: 1, start_ticks: start_ticks(1).unwrap_or(0), incarnation: 7 };
        assert!(identify("ident-b", &init).is_err());
    }

    #[test]
    fn a_process_that_ended_is_nobody_even_before_it_is_reaped() {
        let mut sleeper = Sleeper::new("ident-c", "7");
        let identity = sleeper.identity();
        let opened = identify("ident-c", &identity).unwrap();
        sleeper.0.kill().unwrap();
        while !opened.has_ended() {
            std::thread::yield_now();
        }
        assert_eq!(identify("ident-c", &identity).unwrap_err(), NotOurs::Ended(identity.pid));
        assert_eq!(start_ticks(identity.pid), None, "it is not reaped yet");
        sleeper.0.wait().unwrap();
        opened.signal(Signal::KILL);
        assert_eq!(identify("ident-c", &identity).unwrap_err(), NotOurs::Ended(identity.pid));
    }
}
