//! The processes of a run as the operating system sees them: started, signalled, reaped, written down.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;

use anyhow::Context;
use runtime::{
    Domain, INCARNATION_VARIABLE, RESTART_VARIABLE, SYSTEM_ID_VARIABLE, monotonic_ns, write_handover,
};
use shared_types::{Checkpoint, Role};

use crate::child::{Child, Launch};
use crate::child_log::ChildLog;
use crate::lock::SystemLock;
use crate::supervisor::{Event, Exit};
use crate::system::{ProcessEntry, System};

/// How many of its last lines are shown when a process dies.
const LAST_WORDS: usize = 10;

/// All processes of one run.
pub(crate) struct Fleet {
    domain: Domain,
    members: BTreeMap<Role, Member>,
    // Dropped last: what it removes must not be in use any more.
    lock: SystemLock,
}

/// One role and the process that fills it.
struct Member {
    entry: ProcessEntry,
    log: ChildLog,
    child: Option<Child>,
    incarnation: u32,
    starts: u32,
    last_words: Vec<String>,
    usage: Option<(u64, f64)>,
    last_pid: u32,
}

/// What the processor and the memory know of a process.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Load {
    pub(crate) cpu_percent: f64,
    pub(crate) memory_kib: u64,
}

impl Fleet {
    /// A fleet whose processes write their output to files below `logs`.
    pub(crate) fn new(
        domain: Domain,
        lock: SystemLock,
        system: &System,
        logs: PathBuf,
    ) -> anyhow::Result<Self> {
        let mut members = BTreeMap::new();
        for role in Role::ALL.iter().copied() {
            let Some(entry) = system.entry(role) else { continue };
            let path = logs.join(format!("{role}.log"));
            // The log tells of this run only.
            let _ = std::fs::remove_file(&path);
            let member = Member {
                entry: entry.clone(),
                log: ChildLog::open(&path).with_context(|| format!("{}", path.display()))?,
                child: None,
                incarnation: 0,
                starts: 0,
                last_words: Vec::new(),
                usage: None,
                last_pid: 0,
            };
            members.insert(role, member);
        }
        Ok(Self { domain, members, lock })
    }

    /// Starts the process of a role; `checkpoint` is the newest state of the one before it.
    pub(crate) fn spawn(&mut self, role: Role, incarnation: u32, checkpoint: Option<&Checkpoint>) -> Event {
        match self.try_spawn(role, incarnation, checkpoint) {
            Ok(pid) => Event::Spawned { role, pid, incarnation },
            Err(error) => Event::SpawnFailed { role, error: format!("{error:#}") },
        }
    }

    fn try_spawn(
        &mut self,
        role: Role,
        incarnation: u32,
        checkpoint: Option<&Checkpoint>,
    ) -> anyhow::Result<u32> {
        let member = self.members.get_mut(&role).context("no process of this role")?;
        let command = match (&member.entry.command, &member.entry.implementation) {
            (Some(command), _) => command.iter().map(OsString::from).collect(),
            (None, implementation) => {
                let this = std::env::current_exe().context("path of this executable")?;
                let name = implementation.clone().unwrap_or_default();
                vec![this.into_os_string(), "service".into(), name.into()]
            }
        };
        write_handover(&self.domain, role, checkpoint)?;
        let restart = member.starts > 0;
        let variable = |name: &str, value: String| (OsString::from(name), OsString::from(value));
        let environment = vec![
            variable(SYSTEM_ID_VARIABLE, self.domain.system_id().to_owned()),
            variable(INCARNATION_VARIABLE, incarnation.to_string()),
            variable(RESTART_VARIABLE, u8::from(restart).to_string()),
        ];
        member.log.begin(&format!("{role} incarnation {incarnation}: {}", member.entry.label()))?;
        member.starts += 1;
        member.incarnation = incarnation;
        let child = Child::spawn(&Launch { command, environment, directory: None }, &member.log)?;
        let pid = child.pid();
        member.child = Some(child);
        member.usage = Some((monotonic_ns(), 0.0));
        member.last_pid = pid;
        self.lock.register(role, pid.cast_signed(), incarnation)?;
        Ok(pid)
    }

    /// Asks a process to end, or kills it.
    pub(crate) fn signal(&self, role: Role, kill: bool) {
        let Some(child) = self.members.get(&role).and_then(|member| member.child.as_ref()) else { return };
        let sent = if kill { child.kill() } else { child.terminate() };
        if let Err(error) = sent {
            tracing::warn!(%role, %error, "signal not sent");
        }
    }

    /// Processes that have ended since the last look, with their last words.
    pub(crate) fn reap(&mut self) -> Vec<(Role, u32, Exit)> {
        let mut ended = Vec::new();
        for (role, member) in &mut self.members {
            let Some(child) = &mut member.child else { continue };
            if let Ok(Some(exit)) = child.try_wait() {
                member.last_words = member.log.last_lines(LAST_WORDS).unwrap_or_default();
                member.child = None;
                ended.push((*role, member.incarnation, exit));
            }
        }
        ended
    }

    /// Keeps the logs within their size.
    pub(crate) fn trim_logs(&self) {
        for member in self.members.values() {
            let _ = member.log.trim();
        }
    }

    /// Descriptors that become readable when a process ends.
    pub(crate) fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.members.values().filter_map(|member| member.child.as_ref().map(AsFd::as_fd))
    }

    /// Last lines of the process of a role before it ended.
    pub(crate) fn last_words(&self, role: Role) -> &[String] {
        self.members.get(&role).map_or(&[], |member| &member.last_words)
    }

    /// Implementation or command of a role.
    pub(crate) fn label(&self, role: Role) -> String {
        self.members.get(&role).map_or_else(String::new, |member| member.entry.label())
    }

    /// Process id that filled the role last.
    pub(crate) fn last_pid(&self, role: Role) -> u32 {
        self.members.get(&role).map_or(0, |member| member.last_pid)
    }

    /// Processor share since the last call, and memory, of the process of a role.
    pub(crate) fn load(&mut self, role: Role) -> Load {
        let Some(member) = self.members.get_mut(&role) else { return Load::default() };
        let Some(usage) = member.child.as_ref().and_then(Child::usage) else { return Load::default() };
        let now = monotonic_ns();
        let before = member.usage.replace((now, usage.cpu_s));
        let cpu_percent = before.map_or(0.0, |(then, cpu_s)| {
            let elapsed_s = now.saturating_sub(then).max(1) as f64 * 1e-9;
            100.0 * (usage.cpu_s - cpu_s).max(0.0) / elapsed_s
        });
        Load { cpu_percent, memory_kib: usage.memory_kib }
    }
}
