//! What becomes of a system that nobody speaks to any more: its processes end, and the last one cleans up.
//!
//! Each process counts for itself how long it has heard no directive. Controller, obstacles, estimator and actuator
//! end after the time set, the actuator with a block as its last word. The robot ends a second later, at rest.
//!
//! The first of them that gets the lock of the system waits until the others are gone, kills who does not go, and
//! removes all files. When an orchestrator holds the lock, it is alive or has just come: then nothing is touched.

use std::fs::{File, OpenOptions};
use std::io::{Seek, Write};

use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;
use serde::Deserialize;
use shared_types::Role;

use crate::identity::{Identity, PROCESSES_FILE, identify};
use crate::{Domain, monotonic_ns};

/// Name of the file in the directory of the system that an orchestrator holds locked.
pub const LOCK_FILE: &str = "lock";
/// Stands behind the process id in that file while the last process of a system cleans up.
pub const LEAVING: &str = "leaving";

/// The robot outlives the others by this: wheels that turn at 2 m/s come to rest in a fifth of it [ns].
const ROBOT_LONGER_NS: u64 = 1_000_000_000;
/// Others have this long to end by themselves [ns].
const PATIENCE_NS: u64 = 3_000_000_000;
/// A killed process is waited for this long [ns].
const KILL_PATIENCE_NS: u64 = 1_000_000_000;
/// Time between two looks at them.
const LOOK: std::time::Duration = std::time::Duration::from_millis(10);

/// How long a process of that role goes on without a word of an orchestrator [ns].
pub(crate) fn limit_ns(role: Role, orphan_timeout_ns: u64) -> u64 {
    orphan_timeout_ns.saturating_add(if role == Role::Robot { ROBOT_LONGER_NS } else { 0 })
}

/// Cleans up after the system when it is dropped, if the process ends as an orphan.
#[derive(Debug)]
pub(crate) struct Janitor {
    domain: Domain,
    orphaned: bool,
}

/// The list of processes, as far as it matters here.
#[derive(Debug, Deserialize)]
struct Listed {
    #[serde(default)]
    process: Vec<ListedProcess>,
}

#[derive(Debug, Deserialize)]
struct ListedProcess {
    identity: Identity,
}

impl Janitor {
    pub(crate) fn new(domain: &Domain) -> Self {
        Self { domain: domain.clone(), orphaned: false }
    }

    pub(crate) fn is_orphaned(&mut self) {
        self.orphaned = true;
    }
}

impl Drop for Janitor {
    fn drop(&mut self) {
        if self.orphaned
            && let Some(_lock) = lock(&self.domain)
        {
            end_others(&self.domain);
            if let Err(error) = self.domain.remove() {
                tracing::warn!("not cleaned up: {error}");
            }
        }
    }
}

fn lock(domain: &Domain) -> Option<File> {
    let mut file = OpenOptions::new().write(true).open(domain.directory().join(LOCK_FILE)).ok()?;
    flock(&file, FlockOperation::NonBlockingLockExclusive).ok()?;
    let said = file.set_len(0).and_then(|()| file.rewind());
    said.and_then(|()| writeln!(file, "{} {LEAVING}", std::process::id())).ok()?;
    Some(file)
}

fn end_others(domain: &Domain) {
    let text = std::fs::read_to_string(domain.directory().join(PROCESSES_FILE)).unwrap_or_default();
    let listed = toml::from_str::<Listed>(&text).map_or_else(|_| Vec::new(), |listed| listed.process);
    let mut others: Vec<_> = listed
        .iter()
        .filter(|process| process.identity.pid != std::process::id())
        .filter_map(|process| identify(domain.system_id(), &process.identity).ok())
        .collect();
    for (patience_ns, then_kill) in [(PATIENCE_NS, true), (KILL_PATIENCE_NS, false)] {
        let deadline_ns = monotonic_ns() + patience_ns;
        loop {
            others.retain(|other| !other.has_ended());
            if others.is_empty() || monotonic_ns() > deadline_ns {
                break;
            }
            std::thread::sleep(LOOK);
        }
        for other in others.iter().filter(|_| then_kill) {
            tracing::warn!("process {} does not end and is killed", other.pid());
            other.signal(Signal::KILL);
        }
    }
}
