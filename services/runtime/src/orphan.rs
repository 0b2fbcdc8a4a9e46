//! The end of an orphaned system: its processes end, and one of them cleans up.
//!
//! Each process measures how long it has received no directive, while it ran itself. Controller, obstacles, estimator and actuator end
//! after the time set; the last actuation blocks the wheels. The robot ends a second later, at rest.
//!
//! The first of them that gets the lock of the system waits until the others have ended, kills those that do not end,
//! and removes all files. When an orchestrator holds the lock, nothing is touched.

use std::fs::File;
use std::io::{Seek, Write};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::process::Signal;
use shared_types::Role;

use crate::domain::LOCK_FILE;
use crate::identity::{Identified, identify, processes_of};
use crate::stop::{StopWord, Wheels};
use crate::{Domain, ROLE_VARIABLE, monotonic_ns};

/// Follows the process id in that file while the last process of a system cleans up.
pub const LEAVING: &str = "leaving";

/// The robot ends this much later than the others: a robot at 2 m/s comes to rest in a fifth of it [ns].
const ROBOT_LONGER_NS: u64 = 1_000_000_000;
/// Others have this long to end by themselves [ns].
const END_TIMEOUT_NS: u64 = 3_000_000_000;
/// How long to wait for a killed process [ns].
const KILL_TIMEOUT_NS: u64 = 1_000_000_000;
/// Time between two checks of them.
const POLL: std::time::Duration = std::time::Duration::from_millis(10);

/// How long a process of that role runs without a directive [ns].
pub(crate) fn limit_ns(role: Role, orphan_timeout_ns: u64) -> u64 {
    orphan_timeout_ns.saturating_add(if role == Role::Robot { ROBOT_LONGER_NS } else { 0 })
}

/// Cleans up after the system when dropped, if the process ends as an orphan.
#[derive(Debug)]
pub(crate) struct OrphanCleanup {
    domain: Domain,
    word: Option<StopWord>,
    orphaned: bool,
}

impl OrphanCleanup {
    pub(crate) fn new(domain: &Domain, word: Option<StopWord>) -> Self {
        Self { domain: domain.clone(), word, orphaned: false }
    }

    pub(crate) fn mark_orphaned(&mut self) {
        self.orphaned = true;
    }
}

impl Drop for OrphanCleanup {
    fn drop(&mut self) {
        if self.orphaned
            && let Some(_lock) = lock(&self.domain)
        {
            end_others(&self.domain, self.word.as_ref());
            if let Err(error) = self.domain.remove() {
                tracing::warn!("not cleaned up: {error}");
            }
        }
    }
}

fn lock(domain: &Domain) -> Option<File> {
    let mut file = domain.folder().open_file(LOCK_FILE, OFlags::WRONLY).ok()?;
    flock(&file, FlockOperation::NonBlockingLockExclusive).ok()?;
    let emptied = file.set_len(0).and_then(|()| file.rewind());
    emptied.and_then(|()| writeln!(file, "{} {LEAVING}", std::process::id())).ok()?;
    Some(file)
}

fn end_others(domain: &Domain, word: Option<&StopWord>) {
    let is_robot = |name: Option<String>| name.as_deref() == Some(Role::Robot.name());
    let others =
        processes_of(domain.run_id()).into_iter().filter(|seen| seen.identity.pid != std::process::id());
    let mut others: Vec<(bool, Identified)> = others
        .filter_map(|seen| Some((is_robot(seen.variable(ROLE_VARIABLE)), identify(&seen.identity).ok()?)))
        .collect();
    for (timeout_ns, then_kill) in [(END_TIMEOUT_NS, true), (KILL_TIMEOUT_NS, false)] {
        let deadline_ns = monotonic_ns() + timeout_ns;
        loop {
            others.retain(|(_, other)| !other.has_ended());
            if others.is_empty() || monotonic_ns() > deadline_ns {
                break;
            }
            std::thread::sleep(POLL);
        }
        for (is_robot, other) in others.iter().filter(|_| then_kill) {
            // A robot that may still move must keep the process that can stop it.
            if *is_robot && word.is_none_or(|word| word.wheels(Role::Robot).0 != Wheels::Resting) {
                tracing::error!("robot {} does not end, and is not known to rest: it is left", other.pid());
                continue;
            }
            tracing::warn!("process {} does not end and is killed", other.pid());
            other.signal(Signal::KILL);
        }
    }
}
