//! Which process belongs to a run: never one that was given the process id of a dead process of the run.
//!
//! The record of a process holds its id, start time and user, the boot and pid namespace in which the id holds, the
//! run and the incarnation. Before a signal, the process is first opened by its id ([`identify`]) and then compared.
//! When it still runs after that, all that was read belongs to it. A signal through its descriptor reaches it or no
//! process.
//!
//! Limit: the environment is the one at the start of the program. A process that overwrites the memory of its
//! environment is taken for a stranger, which is the safe side.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::MetadataExt;

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use serde::{Deserialize, Serialize};

use crate::{Domain, INCARNATION_VARIABLE, RUN_ID_VARIABLE, wait_for};

/// Name of the file in the directory of the system that lists its processes.
pub const PROCESSES_FILE: &str = "processes.toml";

/// The record of a process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Process id, also the id of its process group.
    pub pid: u32,
    /// Start time in clock ticks since boot.
    pub start_ticks: u64,
    /// Its incarnation.
    pub incarnation: u32,
    /// The random id of its run.
    pub run_id: String,
    /// The user it runs as.
    pub uid: u32,
    /// The boot of the machine in which it was started.
    pub boot_id: String,
    /// The namespace in which its id holds, by inode.
    pub pid_namespace: u64,
}

/// An open process that matches its record.
#[derive(Debug)]
pub struct Identified {
    identity: Identity,
    pidfd: OwnedFd,
}

/// Why a process id does not lead to the recorded process.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotOurs {
    /// It has ended.
    #[error("process {0} has ended")]
    Ended(u32),
    /// The number was given to another process.
    #[error("process {pid} is a stranger: its {what} is `{found}`, not `{expected}`")]
    Stranger {
        /// The process id.
        pid: u32,
        /// The property that differs.
        what: &'static str,
        /// Its value.
        found: String,
        /// The recorded value.
        expected: String,
    },
}

impl Identity {
    /// A process of this user, boot and namespace; `None` when it has ended.
    pub fn of(domain: &Domain, pid: u32, incarnation: u32) -> Option<Self> {
        let start_ticks = start_ticks(pid)?;
        Some(Self { start_ticks, incarnation, run_id: domain.run_id().to_owned(), ..Self::here(pid) })
    }

    /// A record with what all processes of this user, boot and namespace have in common.
    fn here(pid: u32) -> Self {
        Self {
            pid,
            start_ticks: 0,
            incarnation: 0,
            run_id: String::new(),
            uid: rustix::process::geteuid().as_raw(),
            boot_id: boot_id(),
            pid_namespace: pid_namespace(),
        }
    }
}

/// Opens a recorded process, and verifies that it is the same.
///
/// # Errors
/// [`NotOurs`] with the difference.
pub fn identify(identity: &Identity) -> Result<Identified, NotOurs> {
    let pid = identity.pid;
    let ended = || NotOurs::Ended(pid);
    let compare = |what, found: String, expected: String| match found == expected {
        true => Ok(()),
        false => Err(NotOurs::Stranger { pid, what, found, expected }),
    };
    let here = Identity::here(pid);
    compare("boot", here.boot_id, identity.boot_id.clone())?;
    compare("pid namespace", here.pid_namespace.to_string(), identity.pid_namespace.to_string())?;
    let raw = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or_else(ended)?;
    let pidfd = pidfd_open(raw, PidfdFlags::empty()).map_err(|_| ended())?;
    let found_ticks = start_ticks(pid).ok_or_else(ended)?;
    let found_uid = uid_of(pid).ok_or_else(ended)?;
    let environment = environment(pid);
    let process = Identified { identity: identity.clone(), pidfd };
    // It still runs, so what was read belongs to the process behind the descriptor.
    if process.has_ended() {
        return Err(ended());
    }
    compare("start time", found_ticks.to_string(), identity.start_ticks.to_string())?;
    compare("user", found_uid.to_string(), identity.uid.to_string())?;
    for (variable, expected) in
        [(RUN_ID_VARIABLE, identity.run_id.clone()), (INCARNATION_VARIABLE, identity.incarnation.to_string())]
    {
        compare(variable, value_of(&environment, variable).unwrap_or_default(), expected)?;
    }
    Ok(process)
}

impl Identified {
    /// Its record.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.identity.pid
    }

    /// Whether it has ended, reaped or not.
    pub fn has_ended(&self) -> bool {
        wait_for(&[self.pidfd.as_fd()], 0)
    }

    /// Sends it a signal; when it has ended, no process gets one.
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

/// A running process as the kernel shows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seen {
    /// Its record.
    pub identity: Identity,
    /// Id of its process group.
    pub group: u32,
    /// Its environment, as `NAME=VALUE` each.
    environment: Vec<u8>,
}

impl Seen {
    /// The value of a variable of its environment.
    pub fn variable(&self, name: &str) -> Option<String> {
        value_of(&self.environment, name)
    }
}

/// All running processes of user `uid` whose environment names a run and an incarnation: started by an orchestrator,
/// or by one of its processes.
pub fn started_processes(uid: u32) -> Vec<Seen> {
    processes(uid).filter_map(seen).filter(|process| process.identity.uid == uid).collect()
}

/// All running processes of other users than `uid` whose environment names a run and an incarnation. The environment of
/// another user is readable for root alone.
pub fn started_processes_of_others(uid: u32) -> Vec<Seen> {
    if !rustix::process::geteuid().is_root() {
        return Vec::new();
    }
    let others = all_processes().filter(|pid| uid_of(*pid) != Some(uid));
    others.filter_map(seen).filter(|process| process.identity.uid != uid).collect()
}

/// The running processes of one run of this user.
pub fn processes_of(run_id: &str) -> Vec<Seen> {
    let mut found = started_processes(rustix::process::geteuid().as_raw());
    found.retain(|process| process.identity.run_id == run_id);
    found
}

/// Ids of all running processes of a user.
pub fn processes(uid: u32) -> impl Iterator<Item = u32> {
    all_processes().filter(move |pid| uid_of(*pid) == Some(uid))
}

fn all_processes() -> impl Iterator<Item = u32> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok())
}

fn seen(pid: u32) -> Option<Seen> {
    let environment = environment(pid);
    let run_id = value_of(&environment, RUN_ID_VARIABLE)?;
    let incarnation = value_of(&environment, INCARNATION_VARIABLE)?.parse().ok()?;
    let fields = stat_fields(pid).filter(|fields| !is_zombie(fields))?;
    let [group, start_ticks] = [stat_number(&fields, 5)?, stat_number(&fields, 22)?];
    let identity = Identity { start_ticks, incarnation, run_id, uid: uid_of(pid)?, ..Identity::here(pid) };
    Some(Seen { identity, group: u32::try_from(group).ok()?, environment })
}

/// Start time of a process in clock ticks since boot; `None` when it has ended, reaped or not.
pub fn start_ticks(pid: u32) -> Option<u64> {
    let fields = stat_fields(pid).filter(|fields| !is_zombie(fields))?;
    stat_number(&fields, 22)
}

fn is_zombie(fields: &str) -> bool {
    matches!(fields.split_whitespace().next(), Some("Z" | "X"))
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

/// The real user of a process; `None` when there is no such process.
pub fn uid_of(pid: u32) -> Option<u32> {
    status_of(pid, "Uid:")?.split_whitespace().next()?.parse().ok()
}

/// The process that has this id in its own pid namespace, by its id here.
pub(crate) fn numbered_elsewhere(pid: u32, ticks: u64) -> Option<u32> {
    let has_number = |here: &u32| {
        let ids = status_of(*here, "NSpid:");
        ids.is_some_and(|ids| ids.split_whitespace().next_back() == Some(&pid.to_string()))
    };
    all_processes().find(|here| has_number(here) && start_ticks(*here) == Some(ticks))
}

/// The value of a line of /proc/PID/status.
fn status_of(pid: u32, name: &str) -> Option<String> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    status.lines().find_map(|line| line.strip_prefix(name)).map(str::to_owned)
}

fn boot_id() -> String {
    let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    text.trim().to_owned()
}

/// The pid namespace of this process, by inode; 0 when it is unknown.
pub fn pid_namespace() -> u64 {
    std::fs::metadata("/proc/self/ns/pid").map_or(0, |found| found.ino())
}

/// Empty when it is not readable, or the process has ended.
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
        fn new(run_id: &str, incarnation: &str) -> Self {
            let mut command = Command::new("sleep");
            command.arg("60").env(RUN_ID_VARIABLE, run_id).env(INCARNATION_VARIABLE, incarnation);
            let sleeper = Self(command.spawn().unwrap());
            // Until the program is loaded the environment is that of this process.
            while value_of(&environment(sleeper.0.id()), INCARNATION_VARIABLE).is_none() {
                std::thread::yield_now();
            }
            sleeper
        }

        fn identity(&self, run_id: &str) -> Identity {
            let pid = self.0.id();
            let start_ticks = start_ticks(pid).unwrap();
            Identity { start_ticks, incarnation: 7, run_id: run_id.to_owned(), ..Identity::here(pid) }
        }
    }

    impl Drop for Sleeper {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    #[test]
    fn a_process_is_ours_by_all_that_is_written_down() {
        let sleeper = Sleeper::new("identityaa", "7");
        let identity = sleeper.identity("identityaa");
        let found = identify(&identity).unwrap();
        assert_eq!((found.pid(), found.has_ended()), (identity.pid, false));
        let listed: Vec<Identity> =
            processes_of("identityaa").into_iter().map(|found| found.identity).collect();
        assert_eq!(listed, [identity]);
    }

    #[test]
    fn a_stranger_is_refused_and_named() {
        let sleeper = Sleeper::new("identitybb", "7");
        let identity = sleeper.identity("identitybb");
        let differs = |change: &dyn Fn(&mut Identity)| {
            let mut other = identity.clone();
            change(&mut other);
            identify(&other).unwrap_err().to_string()
        };
        assert!(differs(&|other| other.start_ticks -= 1).contains("its start time is"));
        assert!(differs(&|other| other.uid += 1).contains("its user is"));
        assert!(differs(&|other| other.pid_namespace += 1).contains("its pid namespace is"));
        assert!(differs(&|other| other.boot_id.push('x')).contains("its boot is"));
        let message = differs(&|other| other.run_id = "identitycc".to_owned());
        assert!(message.ends_with("its SCANLOOP_RUN_ID is `identitybb`, not `identitycc`"), "{message}");
        let message = differs(&|other| other.incarnation = 6);
        assert!(message.ends_with("its SCANLOOP_INCARNATION is `7`, not `6`"), "{message}");
        let init = Identity { pid: 1, start_ticks: start_ticks(1).unwrap_or(0), ..identity };
        assert!(identify(&init).is_err());
    }

    #[test]
    fn processes_of_another_user_are_not_listed() {
        let _sleeper = Sleeper::new("identitydd", "7");
        let other = rustix::process::geteuid().as_raw() + 1;
        assert!(started_processes(other).is_empty());
        let found = started_processes_of_others(other);
        let is_found = found.iter().any(|seen| seen.identity.run_id == "identitydd");
        assert_eq!(is_found, rustix::process::geteuid().is_root());
    }

    #[test]
    fn a_process_that_ended_is_none_of_ours_even_before_it_is_reaped() {
        let mut sleeper = Sleeper::new("identityee", "7");
        let identity = sleeper.identity("identityee");
        let opened = identify(&identity).unwrap();
        sleeper.0.kill().unwrap();
        while !opened.has_ended() {
            std::thread::yield_now();
        }
        assert_eq!(identify(&identity).unwrap_err(), NotOurs::Ended(identity.pid));
        assert_eq!(start_ticks(identity.pid), None, "it is not reaped yet");
        sleeper.0.wait().unwrap();
        opened.signal(Signal::KILL);
        assert_eq!(identify(&identity).unwrap_err(), NotOurs::Ended(identity.pid));
    }
}
