//! The processes of a run as the operating system sees them: started, signalled, reaped, recorded.

pub mod companions;
mod process;
mod starvation;

use std::collections::BTreeMap;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use console::limits::text_of;
use runtime::{
    Bus, CANDIDATE_VARIABLE, Domain, HandoverData, Realtime, RuntimeError, StopWord, monotonic_ns,
    write_handover,
};
use shared_types::Role;

use crate::background::Background;
use crate::child::{Child, Launch};
use crate::child_log::ChildLog;
use crate::entry::{ProcessEntry, ProcessRow};
use crate::environment::{environment_of, variable};
use crate::halt;
use crate::lock::SystemLock;
use crate::realtime::Machine;
use crate::room::Room;
use crate::supervisor::{Event, ProcessExit};

pub use process::Load;
use process::{Process, command_of};
use starvation::Starvation;

/// How many of its last lines are shown when a process dies.
const LAST_LOG_LINES: usize = 10;
/// How many of them stand in the reason why a swap or a shadow ended.
const REASON_LINES: usize = 3;
/// A log on a disk that does not answer is not waited for longer than this.
const LOG_LIMIT: Duration = Duration::from_millis(50);

/// All processes of one run.
pub struct Fleet {
    domain: Domain,
    stop_word: StopWord,
    members: BTreeMap<Role, Member>,
    /// Candidates: processes that run in shadow, for a swap or a comparison.
    candidates: Vec<Process>,
    /// Processes that no role needs any more, and when each is killed if it has not ended [ns].
    leaving: Vec<(Process, u64)>,
    machine: Machine,
    room: Room,
    changed: bool,
    /// Reads and writes the logs: the disk below them may be full or stand still.
    disk: Background,
    // Dropped last: what it removes must not be in use any more.
    _lock: SystemLock,
}

/// One role and the process that fills it.
struct Member {
    entry: ProcessEntry,
    log: Arc<ChildLog>,
    process: Option<Process>,
    /// The incarnation that fills the role, or did last.
    incarnation: u32,
    starts: u32,
    last_log_lines: Vec<String>,
    last_pid: u32,
    starvation: Starvation,
}

/// Processes that have ended.
#[derive(Debug, Default)]
pub struct Reaped {
    /// Processes that filled a role or were candidates: role, incarnation, and how each ended.
    pub ended: Vec<(Role, u32, ProcessExit)>,
    /// Incarnations that no role needed any more.
    pub departed: Vec<u32>,
    /// Whether the bus has ports of such a process, or of a candidate, that are to be cleaned up.
    pub left_ports: bool,
}

impl Fleet {
    /// A fleet whose processes write their output to files below `logs`; an adopted run continues its files.
    ///
    /// # Errors
    /// A log that can't be opened, and a stop word that can't be inherited.
    pub fn new(
        domain: Domain,
        lock: SystemLock,
        stop_word: StopWord,
        realtime: &Realtime,
        entries: &[ProcessEntry],
        logs: PathBuf,
        is_adopted: bool,
    ) -> anyhow::Result<Self> {
        stop_word.hand_down()?;
        let period_ns = stop_word.period_ns();
        let mut members = BTreeMap::new();
        for entry in entries.iter().cloned() {
            let path = logs.join(format!("{}.log", entry.role()));
            let log = ChildLog::of_run(&path, is_adopted)?;
            members.insert(entry.role(), Member::new(entry, log));
        }
        Ok(Self {
            domain,
            stop_word,
            members,
            candidates: Vec::new(),
            leaving: Vec::new(),
            machine: Machine::new(realtime),
            room: Room::new(period_ns),
            changed: false,
            disk: Background::new("logs"),
            _lock: lock,
        })
    }

    /// A role that another orchestrator filled, with the process that fills it, if that lives.
    pub fn adopt(&mut self, role: Role, entry: ProcessEntry, incarnation: u32, child: Option<Child>) {
        let Some(member) = self.members.get_mut(&role) else { return };
        member.starts = u32::from(incarnation != 0);
        member.fill(entry, incarnation, child);
        self.changed = true;
    }

    /// A process of another orchestrator that no role needs any more; it is killed at `kill_ns`.
    pub fn dismiss_adopted(&mut self, entry: ProcessEntry, incarnation: u32, child: Child, kill_ns: u64) {
        self.leaving.push((Process::new(entry, incarnation, child), kill_ns));
        self.changed = true;
    }

    /// All living processes, for the process registry.
    pub fn rows(&self) -> Vec<ProcessRow> {
        self.running().filter_map(|process| process.row(&self.domain)).collect()
    }

    /// How a role is started.
    pub fn entry(&self, role: Role) -> Option<&ProcessEntry> {
        self.members.get(&role).map(|member| &member.entry)
    }

    /// Where the processes of roles run, candidates included; `None` is this host.
    pub fn places(&self) -> impl Iterator<Item = (Role, Option<&str>)> {
        let members = self.members.values().map(|member| &member.entry);
        let entries = members.chain(self.candidates.iter().map(|process| &process.entry));
        entries.map(|entry| (entry.role(), entry.host.as_deref()))
    }

    /// The incarnation that fills a role, or did last; 0 before the first.
    pub fn incarnation(&self, role: Role) -> u32 {
        self.members.get(&role).map_or(0, |member| member.incarnation)
    }

    /// Whether processes were started or have ended since the last call.
    pub fn has_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Starts the process of a role; `handover` is the state that the one before it left.
    pub fn spawn(&mut self, role: Role, incarnation: u32, handover: Option<&HandoverData>) -> Event {
        match self.try_spawn(role, incarnation, handover) {
            Ok(pid) => Event::Spawned { role, pid, incarnation },
            Err(error) => Event::SpawnFailed { role, error: text_of(&error) },
        }
    }

    fn try_spawn(
        &mut self,
        role: Role,
        incarnation: u32,
        handover: Option<&HandoverData>,
    ) -> anyhow::Result<u32> {
        let member = self.members.get(&role).context("no process of this role")?;
        let (entry, restart) = (member.entry.clone(), member.starts > 0);
        let child = self.launch(&entry, incarnation, restart, None, handover)?;
        let pid = child.pid();
        if let Some(member) = self.members.get_mut(&role) {
            member.starts += 1;
            member.fill(entry, incarnation, Some(child));
        }
        Ok(pid)
    }

    /// Starts a process with its log.
    fn launch(
        &mut self,
        entry: &ProcessEntry,
        incarnation: u32,
        restart: bool,
        candidate: Option<u32>,
        handover: Option<&HandoverData>,
    ) -> anyhow::Result<Child> {
        let role = entry.role();
        let member = self.members.get(&role).context("no process of this role")?;
        self.room.make()?;
        write_handover(&self.domain, role, handover)?;
        let mut environment = environment_of(&self.domain, &self.stop_word, role, incarnation, restart);
        environment.extend(candidate.map(|running| variable(CANDIDATE_VARIABLE, running)));
        let log = Arc::clone(&member.log);
        let text = format!("{role} incarnation {incarnation}: {}", entry.label());
        // Before the process writes, if the disk allows; a full one keeps no process from being started.
        if let Some(Err(error)) = self.disk.call(LOG_LIMIT, move || log.begin(&text)) {
            tracing::warn!(%role, %error, "not written to its log: incarnation {incarnation} begins here");
        }
        let launch = Launch { command: command_of(entry), environment };
        let child = Child::spawn(&launch, &member.log)?;
        self.stop_word.enlist(child.pid());
        self.changed = true;
        Ok(child)
    }

    /// Starts a process beside the one that fills its role; it resumes from `handover`, or a newer state.
    ///
    /// # Errors
    /// A command that can't be started, and memory or a file system without room.
    pub fn spawn_candidate(
        &mut self,
        entry: ProcessEntry,
        incarnation: u32,
        handover: Option<&HandoverData>,
    ) -> anyhow::Result<()> {
        let running = self.members.get(&entry.role()).map(|member| member.incarnation);
        let child = self.launch(&entry, incarnation, true, running, handover)?;
        self.candidates.push(Process::new(entry, incarnation, child));
        Ok(())
    }

    /// The candidate of that incarnation fills its role from now on; the one before it is asked to end. Returns its id.
    pub fn promote(&mut self, incarnation: u32) -> Option<u32> {
        let process = self.take_candidate(incarnation)?;
        let member = self.members.get_mut(&process.entry.role())?;
        let pid = process.child.pid();
        let grace_ms = std::mem::replace(&mut member.entry, process.entry.clone()).grace_ms;
        if let Some(old) = member.process.replace(process) {
            let _ = old.child.terminate();
            self.leaving.push((old, monotonic_ns() + grace_ms * 1_000_000));
        }
        (member.incarnation, member.last_pid) = (incarnation, pid);
        member.last_log_lines.clear();
        self.changed = true;
        Some(pid)
    }

    /// Kills the candidate of that incarnation, if there is one.
    pub fn dismiss(&mut self, incarnation: u32) {
        if let Some(process) = self.take_candidate(incarnation) {
            let _ = process.child.kill();
            self.leaving.push((process, monotonic_ns()));
        }
    }

    /// Process id, entry and load of the candidate of that incarnation.
    pub fn candidate(&mut self, incarnation: u32) -> Option<(u32, ProcessEntry, Load)> {
        let process = self.candidates.iter_mut().find(|process| process.incarnation == incarnation)?;
        Some((process.child.pid(), process.entry.clone(), process.load()))
    }

    fn take_candidate(&mut self, incarnation: u32) -> Option<Process> {
        let index = self.candidates.iter().position(|process| process.incarnation == incarnation)?;
        Some(self.candidates.remove(index))
    }

    fn running(&self) -> impl Iterator<Item = &Process> {
        let members = self.members.values().filter_map(|member| member.process.as_ref());
        members.chain(&self.candidates).chain(self.leaving.iter().map(|(process, _)| process))
    }

    /// Gives a process that has made its connections its processors and priority.
    ///
    /// Not before: while processes join the bus they wait for each other, and one that has priority over all others
    /// would keep those it waits for from running.
    pub fn connected(&mut self, incarnation: u32) {
        let process = self.running().find(|process| process.incarnation == incarnation);
        if let Some(pid) = process.map(|process| process.child.pid()) {
            self.machine.take_in(pid);
        }
    }

    /// Leaves the process of a role as it is; returns its id.
    pub fn leave(&mut self, role: Role) -> Option<u32> {
        let mut process = self.members.get_mut(&role)?.process.take()?;
        process.child.release();
        self.changed = true;
        Some(process.child.pid())
    }

    /// Holds shared memory for one more process, unless one of a role starts, or a candidate runs or leaves. Returns
    /// what is missing, once.
    pub fn keep_room(&mut self, bus: &Bus, starts: bool) -> Option<RuntimeError> {
        self.room.keep(bus, starts || !self.candidates.is_empty() || !self.leaving.is_empty())
    }

    /// Asks a process to end, or kills it.
    pub fn signal(&self, role: Role, kill: bool) {
        let member = self.members.get(&role);
        let Some(process) = member.and_then(|member| member.process.as_ref()) else { return };
        let sent = if kill { process.child.kill() } else { process.child.terminate() };
        if let Err(error) = sent {
            tracing::warn!(%role, %error, "signal not sent");
        }
    }

    /// Processes that have ended since the last call; the last log lines of members are kept.
    pub fn reap(&mut self) -> Reaped {
        let mut reaped = Reaped::default();
        for (role, member) in &mut self.members {
            let Some(process) = &mut member.process else { continue };
            if let Ok(Some(exit)) = process.child.try_wait() {
                member.last_log_lines = last_lines(&self.disk, &member.log);
                member.process = None;
                reaped.ended.push((*role, member.incarnation, exit));
            }
        }
        self.candidates.retain_mut(|process| {
            let Ok(Some(exit)) = process.child.try_wait() else { return true };
            reaped.ended.push((process.entry.role(), process.incarnation, exit));
            reaped.left_ports = true;
            false
        });
        let now_ns = monotonic_ns();
        self.leaving.retain_mut(|(process, kill_ns)| {
            if now_ns >= *kill_ns {
                let _ = process.child.kill();
            }
            let has_ended = process.has_ended();
            reaped.departed.extend(has_ended.then_some(process.incarnation));
            !has_ended
        });
        reaped.left_ports |= !reaped.departed.is_empty();
        self.changed |= reaped.left_ports || !reaped.ended.is_empty();
        reaped
    }

    /// How a candidate ended, with the last lines of its log.
    pub fn reason_of(&self, role: Role, exit: ProcessExit) -> String {
        let lines =
            self.members.get(&role).map_or_else(Vec::new, |member| last_lines(&self.disk, &member.log));
        let last = lines[lines.len().saturating_sub(REASON_LINES)..].join(" | ");
        if last.is_empty() { exit.to_string() } else { format!("{exit}: {last}") }
    }

    /// Descriptors that become readable when a process ends.
    pub fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.running().map(|process| process.child.as_fd())
    }

    /// Last log lines of the process of a role before it ended.
    pub fn last_log_lines(&self, role: Role) -> &[String] {
        self.members.get(&role).map_or(&[], |member| &member.last_log_lines)
    }

    /// Whether a process that makes no progress is only short of a processor. Ask as soon as it is suspected.
    pub fn is_starved(&mut self, role: Role, incarnation: u32) -> bool {
        let Some(member) = self.members.get_mut(&role) else { return false };
        let pid = member.process.as_ref().map(|process| process.child.pid());
        pid.is_some_and(|pid| member.starvation.is_starved(incarnation, pid))
    }

    /// All processes but those of these roles make progress again.
    pub fn forget_suspects(&mut self, but: impl Fn(Role) -> bool) {
        let others = self.members.iter_mut().filter(|(role, _)| !but(**role));
        others.for_each(|(_, member)| member.starvation.clear());
    }

    /// Implementation or command of a role.
    pub fn label(&self, role: Role) -> String {
        self.entry(role).map_or_else(String::new, ProcessEntry::label)
    }

    /// Process id that filled the role last.
    pub fn last_pid(&self, role: Role) -> u32 {
        self.members.get(&role).map_or(0, |member| member.last_pid)
    }

    /// Processor share since the last call, and memory, of the process of a role.
    pub fn load(&mut self, role: Role) -> Load {
        let member = self.members.get_mut(&role);
        member.and_then(|member| member.process.as_mut()).map_or_else(Load::default, Process::load)
    }
}

impl Drop for Fleet {
    /// An orchestrator that ends for an error, or panics, does not end its processes while the robot moves.
    fn drop(&mut self) {
        let mut processes = self.members.values_mut().filter_map(|member| member.process.as_mut());
        if processes.all(Process::has_ended) {
            return;
        }
        halt::end_own_run(&self.domain, &self.stop_word);
        let robot = self.members.get_mut(&Role::Robot).and_then(|member| member.process.as_mut());
        if let Some(robot) = robot
            && !robot.has_ended()
        {
            robot.child.release();
        }
    }
}

impl Member {
    fn new(entry: ProcessEntry, log: Arc<ChildLog>) -> Self {
        Self {
            entry,
            log,
            process: None,
            incarnation: 0,
            starts: 0,
            last_log_lines: Vec::new(),
            last_pid: 0,
            starvation: Starvation::default(),
        }
    }

    /// The process of this incarnation fills the role, or did last.
    fn fill(&mut self, entry: ProcessEntry, incarnation: u32, child: Option<Child>) {
        self.last_pid = child.as_ref().map_or(0, Child::pid);
        self.process = child.map(|child| Process::new(entry.clone(), incarnation, child));
        (self.entry, self.incarnation) = (entry, incarnation);
    }
}

/// The last lines of a log, none when the disk does not give them in time.
fn last_lines(disk: &Background, log: &Arc<ChildLog>) -> Vec<String> {
    let log = Arc::clone(log);
    disk.call(LOG_LIMIT, move || log.last_lines(LAST_LOG_LINES)).and_then(Result::ok).unwrap_or_default()
}
