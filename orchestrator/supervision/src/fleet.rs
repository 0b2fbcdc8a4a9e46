//! The processes of a run as the operating system sees them: started, signalled, reaped, written down.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use runtime::{
    Bus, CANDIDATE_VARIABLE, DIRECTORY_VARIABLE, Domain, HandoverData, INCARNATION_VARIABLE, Identity,
    RESTART_VARIABLE, ROLE_VARIABLE, RUN_ID_VARIABLE, Realtime, RuntimeError, STOP_FD_VARIABLE,
    SYSTEM_ID_VARIABLE, StopWord, monotonic_ns, write_handover,
};
use shared_types::Role;

use crate::background::Background;
use crate::child::{Child, Launch, is_runnable, this_program};
use crate::child_log::ChildLog;
use crate::entry::{ProcessEntry, ProcessRow};
use crate::halt;
use crate::lock::SystemLock;
use crate::realtime::Machine;
use crate::room::Room;
use crate::runs::LivingRun;
use crate::supervisor::{Event, Exit};

/// How many of its last lines are shown when a process dies.
const LAST_LOG_LINES: usize = 10;
/// A log on a disk that does not answer is not waited for longer than this.
const LOG_LIMIT: Duration = Duration::from_millis(50);
/// A share of a processor is measured over at least this long, however often it is asked for [ns].
const LOAD_WINDOW_NS: u64 = 200_000_000;

/// A process that has used this much time on a processor without progress is not starved [s]: a quarter of the
/// shortest hang limit, and three times what a scan takes at most.
const STARVED_CPU_S: f64 = 0.075;

/// All processes of one run.
pub struct Fleet {
    domain: Domain,
    word: StopWord,
    members: BTreeMap<Role, Member>,
    candidate: Vec<Candidate>,
    leaving: Vec<Leaving>,
    /// Incarnations that no role needed and that have ended.
    departed: Vec<u32>,
    left: bool,
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
    child: Option<Child>,
    incarnation: u32,
    starts: u32,
    last_words: Vec<String>,
    usage: Option<Spent>,
    last_pid: u32,
    /// An incarnation that makes no progress, and its processor time when that was noticed [s].
    suspect: Option<(u32, f64)>,
}

/// A process that runs beside the one that fills its role.
struct Candidate {
    role: Role,
    entry: ProcessEntry,
    child: Child,
    incarnation: u32,
    usage: Option<Spent>,
}

/// A process that no role needs any more, and when it is killed if it has not ended [ns].
struct Leaving {
    role: Role,
    entry: ProcessEntry,
    child: Child,
    incarnation: u32,
    kill_ns: u64,
}

/// Time on a processor when it was looked at last, and the share of it that was found then.
#[derive(Debug, Clone, Copy, Default)]
struct Spent {
    at_ns: u64,
    cpu_s: f64,
    percent: f64,
}

/// What the processor and the memory know of a process.
#[derive(Debug, Clone, Copy, Default)]
pub struct Load {
    /// Share of a processor [%].
    pub cpu_percent: f64,
    /// Memory in use [KiB].
    pub memory_kib: u64,
}

impl Fleet {
    /// A fleet whose processes write their output to files below `logs`; `go_on` where others wrote before.
    ///
    /// # Errors
    /// A log that can't be opened, and a stop word that can't be handed down.
    pub fn new(
        domain: Domain,
        lock: SystemLock,
        word: StopWord,
        realtime: &Realtime,
        entries: &[ProcessEntry],
        logs: PathBuf,
        go_on: bool,
    ) -> anyhow::Result<Self> {
        word.hand_down()?;
        let machine = Machine::new(realtime);
        let mut members = BTreeMap::new();
        for role in Role::ALL.iter().copied() {
            let Some(entry) = entries.iter().find(|entry| entry.role == role.name()) else { continue };
            let path = logs.join(format!("{role}.log"));
            if !go_on {
                // The log tells of this run only.
                let _ = std::fs::remove_file(&path);
            }
            let member = Member {
                entry: entry.clone(),
                log: Arc::new(ChildLog::open(&path).with_context(|| format!("{}", path.display()))?),
                child: None,
                incarnation: 0,
                starts: 0,
                last_words: Vec::new(),
                usage: None,
                last_pid: 0,
                suspect: None,
            };
            members.insert(role, member);
        }
        let (candidate, leaving, departed) = (Vec::new(), Vec::new(), Vec::new());
        let (left, changed) = (false, false);
        Ok(Self {
            domain,
            word,
            members,
            candidate,
            leaving,
            departed,
            left,
            changed,
            machine,
            room: Room::default(),
            disk: Background::new("logs"),
            _lock: lock,
        })
    }

    /// A role that another orchestrator filled, with the process that fills it, if that lives.
    pub fn adopt(&mut self, role: Role, entry: ProcessEntry, incarnation: u32, child: Option<Child>) {
        let Some(member) = self.members.get_mut(&role) else { return };
        member.starts = u32::from(incarnation != 0);
        member.last_pid = child.as_ref().map_or(0, Child::pid);
        member.usage = child.as_ref().map(spent_so_far);
        (member.entry, member.incarnation, member.child) = (entry, incarnation, child);
        self.changed = true;
    }

    /// A process of another orchestrator that no role needs any more; it is killed at `kill_ns`.
    pub fn dismiss_adopted(
        &mut self,
        role: Role,
        entry: ProcessEntry,
        incarnation: u32,
        child: Child,
        kill_ns: u64,
    ) {
        self.leaving.push(Leaving { role, entry, child, incarnation, kill_ns });
        self.changed = true;
    }

    /// All living processes, as they are to be written down.
    pub fn rows(&self) -> Vec<ProcessRow> {
        let row = |role: &Role, entry: &ProcessEntry, child: &Child, incarnation: u32| {
            let (role, entry) = (role.name().to_owned(), entry.clone());
            let identity = Identity::of(&self.domain, child.pid(), incarnation)?;
            Some(ProcessRow { role, identity, entry })
        };
        let members = self.members.iter().filter_map(|(role, member)| {
            row(role, &member.entry, member.child.as_ref()?, member.incarnation)
        });
        let candidate = self.candidate.iter().filter_map(|candidate| {
            row(&candidate.role, &candidate.entry, &candidate.child, candidate.incarnation)
        });
        let leaving = self
            .leaving
            .iter()
            .filter_map(|leaving| row(&leaving.role, &leaving.entry, &leaving.child, leaving.incarnation));
        members.chain(candidate).chain(leaving).collect()
    }

    /// How a role is started.
    pub fn entry(&self, role: Role) -> Option<&ProcessEntry> {
        self.members.get(&role).map(|member| &member.entry)
    }

    /// The incarnation that fills a role, or did last; 0 before the first.
    pub fn incarnation(&self, role: Role) -> u32 {
        self.members.get(&role).map_or(0, |member| member.incarnation)
    }

    /// Whether processes have come or gone since the last call.
    pub fn has_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Starts the process of a role; `handover` is what the one before it left.
    pub fn spawn(&mut self, role: Role, incarnation: u32, handover: Option<&HandoverData>) -> Event {
        match self.try_spawn(role, incarnation, handover) {
            Ok(pid) => Event::Spawned { role, pid, incarnation },
            Err(error) => Event::SpawnFailed { role, error: format!("{error:#}") },
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
        let child = self.launch(role, &entry, incarnation, restart, None, handover)?;
        let pid = child.pid();
        let member = self.members.get_mut(&role).context("no process of this role")?;
        member.starts += 1;
        member.incarnation = incarnation;
        member.child = Some(child);
        member.usage = Some(Spent { at_ns: monotonic_ns(), ..Spent::default() });
        member.last_pid = pid;
        Ok(pid)
    }

    /// Starts a process, written down and with its log.
    fn launch(
        &mut self,
        role: Role,
        entry: &ProcessEntry,
        incarnation: u32,
        restart: bool,
        candidate: Option<u32>,
        handover: Option<&HandoverData>,
    ) -> anyhow::Result<Child> {
        let member = self.members.get(&role).context("no process of this role")?;
        let command = match (&entry.command, &entry.implementation) {
            (Some(command), _) => command.iter().map(OsString::from).collect(),
            (None, implementation) => {
                let name = implementation.clone().unwrap_or_default();
                vec![this_program().into_os_string(), "service".into(), name.into()]
            }
        };
        self.room.make()?;
        write_handover(&self.domain, role, handover)?;
        let mut environment = environment_of(&self.domain, &self.word, role, incarnation, restart);
        environment.extend(candidate.map(|running| variable(CANDIDATE_VARIABLE, running.to_string())));
        let (log, text) =
            (Arc::clone(&member.log), format!("{role} incarnation {incarnation}: {}", entry.label()));
        // Before the process writes, if the disk allows; a full one keeps no process from being started.
        if let Some(Err(error)) = self.disk.call(LOG_LIMIT, move || log.begin(&text)) {
            tracing::warn!(%role, %error, "not written to its log: incarnation {incarnation} begins here");
        }
        let child = Child::spawn(&Launch { command, environment, directory: None }, &member.log)?;
        self.changed = true;
        Ok(child)
    }

    /// What a role would be filled with: the entry of the process that fills it, with another implementation.
    pub fn entry_with(
        &self,
        role: Role,
        implementation: Option<String>,
        command: Option<Vec<String>>,
    ) -> Option<ProcessEntry> {
        let member = self.members.get(&role)?;
        Some(ProcessEntry { implementation, command, ..member.entry.clone() })
    }

    /// Starts a process beside the one that fills the role; it resumes from `handover`, or a newer state.
    ///
    /// # Errors
    /// A command that can't be started, and memory or a file system without room.
    pub fn spawn_candidate(
        &mut self,
        role: Role,
        entry: ProcessEntry,
        incarnation: u32,
        handover: Option<&HandoverData>,
    ) -> anyhow::Result<()> {
        let running = self.members.get(&role).map(|member| member.incarnation);
        let child = self.launch(role, &entry, incarnation, true, running, handover)?;
        let usage = Some(Spent { at_ns: monotonic_ns(), ..Spent::default() });
        self.candidate.push(Candidate { role, entry, child, incarnation, usage });
        Ok(())
    }

    /// The process of that incarnation fills its role from now on; the one before it is asked to end. Returns its id.
    pub fn promote(&mut self, incarnation: u32) -> Option<u32> {
        let Candidate { role, entry, child, usage, .. } = self.take_candidate(incarnation)?;
        let member = self.members.get_mut(&role)?;
        let pid = child.pid();
        if let Some(old) = member.child.replace(child) {
            let _ = old.terminate();
            let kill_ns = monotonic_ns() + member.entry.grace_ms * 1_000_000;
            let (entry, incarnation) = (member.entry.clone(), member.incarnation);
            self.leaving.push(Leaving { role, entry, child: old, incarnation, kill_ns });
        }
        self.changed = true;
        (member.entry, member.incarnation, member.usage, member.last_pid) = (entry, incarnation, usage, pid);
        member.last_words.clear();
        Some(pid)
    }

    /// Kills the process of that incarnation, if it runs beside another.
    pub fn dismiss(&mut self, incarnation: u32) {
        if let Some(Candidate { role, entry, child, incarnation, .. }) = self.take_candidate(incarnation) {
            let _ = child.kill();
            self.leaving.push(Leaving { role, entry, child, incarnation, kill_ns: monotonic_ns() });
        }
    }

    /// Process id, implementation and load of the process of that incarnation, if it runs beside another.
    pub fn candidate(&mut self, incarnation: u32) -> Option<(u32, String, Load)> {
        let found = self.candidate.iter_mut().find(|candidate| candidate.incarnation == incarnation);
        let Candidate { entry, child, usage, .. } = found?;
        Some((child.pid(), entry.label(), load_of(child, usage)))
    }

    fn take_candidate(&mut self, incarnation: u32) -> Option<Candidate> {
        let index = self.candidate.iter().position(|candidate| candidate.incarnation == incarnation)?;
        Some(self.candidate.remove(index))
    }

    /// Incarnations that no role needed any more and that have ended since the last call.
    pub fn take_departed(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.departed)
    }

    /// Whether a process that no role needs any more has ended since the last call.
    pub fn have_left(&mut self) -> bool {
        std::mem::take(&mut self.left)
    }

    /// Puts a process that has made its connections where it shall run.
    ///
    /// Not before: while processes join the bus they wait for each other, and one that goes before all others would
    /// keep those it waits for from running.
    pub fn connected(&mut self, incarnation: u32) {
        let member = self.members.values().find(|member| member.incarnation == incarnation);
        let candidate = self.candidate.iter().find(|candidate| candidate.incarnation == incarnation);
        let child =
            member.and_then(|member| member.child.as_ref()).or(candidate.map(|candidate| &candidate.child));
        if let Some(pid) = child.map(Child::pid) {
            self.machine.take_in(pid);
        }
    }

    /// Leaves the process of a role as it is; returns its id.
    pub fn leave(&mut self, role: Role) -> Option<u32> {
        let member = self.members.get_mut(&role)?;
        let mut child = member.child.take()?;
        child.release();
        self.changed = true;
        Some(child.pid())
    }

    /// Holds shared memory for one more process, unless one of a role starts, or another comes or leaves; what is
    /// missing is returned once.
    pub fn keep_room(&mut self, bus: &Bus, starts: bool) -> Option<RuntimeError> {
        self.room.keep(bus, starts || !self.candidate.is_empty() || !self.leaving.is_empty())
    }

    /// Asks a process to end, or kills it.
    pub fn signal(&self, role: Role, kill: bool) {
        let Some(child) = self.members.get(&role).and_then(|member| member.child.as_ref()) else { return };
        let sent = if kill { child.kill() } else { child.terminate() };
        if let Err(error) = sent {
            tracing::warn!(%role, %error, "signal not sent");
        }
    }

    /// Processes that have ended since the last look, with their last words.
    pub fn reap(&mut self) -> Vec<(Role, u32, Exit)> {
        let mut ended = Vec::new();
        for (role, member) in &mut self.members {
            let Some(child) = &mut member.child else { continue };
            if let Ok(Some(exit)) = child.try_wait() {
                member.last_words = last_lines(&self.disk, &member.log);
                member.child = None;
                ended.push((*role, member.incarnation, exit));
            }
        }
        let left = &mut self.left;
        self.candidate.retain_mut(|Candidate { role, child, incarnation, .. }| {
            let Ok(Some(exit)) = child.try_wait() else { return true };
            ended.push((*role, *incarnation, exit));
            *left = true;
            false
        });
        let now = monotonic_ns();
        let before = self.leaving.len();
        self.leaving.retain_mut(|leaving| {
            if now >= leaving.kill_ns {
                let _ = leaving.child.kill();
            }
            let has_ended = matches!(leaving.child.try_wait(), Ok(Some(_)));
            self.departed.extend(has_ended.then_some(leaving.incarnation));
            !has_ended
        });
        self.left |= self.leaving.len() < before;
        self.changed |= self.left || !ended.is_empty();
        ended
    }

    /// Last lines that were written for a role.
    pub fn newest_log_lines(&self, role: Role) -> Vec<String> {
        self.members.get(&role).map_or_else(Vec::new, |member| last_lines(&self.disk, &member.log))
    }

    /// Keeps the logs within their size.
    pub fn trim_logs(&self) {
        let logs: Vec<_> = self.members.values().map(|member| Arc::clone(&member.log)).collect();
        self.disk.post(move || logs.iter().for_each(|log| _ = log.trim()));
    }

    /// Descriptors that become readable when a process ends.
    pub fn descriptors(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        let members = self.members.values().filter_map(|member| member.child.as_ref());
        let candidate = self.candidate.iter().map(|candidate| &candidate.child);
        members.chain(candidate).chain(self.leaving.iter().map(|leaving| &leaving.child)).map(AsFd::as_fd)
    }

    /// Last lines of the process of a role before it ended.
    pub fn last_words(&self, role: Role) -> &[String] {
        self.members.get(&role).map_or(&[], |member| &member.last_words)
    }

    /// Whether a process that makes no progress would, if it got a processor; asked the first time before it is judged.
    ///
    /// One that sleeps or was stopped is not starved, nor is one that has used a good part of a hang limit since.
    pub fn is_starved(&mut self, role: Role, incarnation: u32) -> bool {
        let Some(member) = self.members.get_mut(&role) else { return false };
        let now = member.child.as_ref().and_then(|child| is_runnable(child.pid()));
        let Some((runnable, cpu_s)) = now else { return false };
        match member.suspect {
            Some((suspect, before_s)) if suspect == incarnation => {
                runnable && cpu_s - before_s < STARVED_CPU_S
            }
            _ => {
                member.suspect = Some((incarnation, cpu_s));
                runnable
            }
        }
    }

    /// All others make progress.
    pub fn forget_suspects(&mut self, but: impl Fn(Role) -> bool) {
        self.members
            .iter_mut()
            .filter(|(role, _)| !but(**role))
            .for_each(|(_, member)| member.suspect = None);
    }

    /// Implementation or command of a role.
    pub fn label(&self, role: Role) -> String {
        self.members.get(&role).map_or_else(String::new, |member| member.entry.label())
    }

    /// Process id that filled the role last.
    pub fn last_pid(&self, role: Role) -> u32 {
        self.members.get(&role).map_or(0, |member| member.last_pid)
    }

    /// Processor share since the last call, and memory, of the process of a role.
    pub fn load(&mut self, role: Role) -> Load {
        let Some(member) = self.members.get_mut(&role) else { return Load::default() };
        member.child.as_ref().map_or_else(Load::default, |child| load_of(child, &mut member.usage))
    }
}

impl Drop for Fleet {
    /// An orchestrator that ends for an error, or panics, does not end its processes while the robot moves.
    fn drop(&mut self) {
        let drives = self.members.values_mut().any(|member| {
            member.child.as_mut().is_some_and(|child| !matches!(child.try_wait(), Ok(Some(_))))
        });
        if !drives {
            return;
        }
        self.word.latch();
        if let Some(run) = LivingRun::of(self.domain.run_id()) {
            halt::block(&run);
            for left in halt::end_processes(&run) {
                tracing::error!("{left} does not end, and is not known to rest: it is left");
            }
        }
        let robot = self.members.get_mut(&Role::Robot).and_then(|member| member.child.as_mut());
        if let Some(robot) = robot
            && !matches!(robot.try_wait(), Ok(Some(_)))
        {
            robot.release();
        }
    }
}

/// What a process finds in its environment.
pub fn environment_of(
    domain: &Domain,
    word: &StopWord,
    role: Role,
    incarnation: u32,
    restart: bool,
) -> Vec<(OsString, OsString)> {
    vec![
        variable(SYSTEM_ID_VARIABLE, domain.system_id().to_owned()),
        variable(RUN_ID_VARIABLE, domain.run_id().to_owned()),
        (DIRECTORY_VARIABLE.into(), domain.directory().into()),
        variable(ROLE_VARIABLE, role.name().to_owned()),
        variable(INCARNATION_VARIABLE, incarnation.to_string()),
        variable(RESTART_VARIABLE, u8::from(restart).to_string()),
        variable(STOP_FD_VARIABLE, word.descriptor().to_string()),
    ]
}

fn variable(name: &str, value: String) -> (OsString, OsString) {
    (OsString::from(name), OsString::from(value))
}

/// The last lines of a log, none when the disk does not give them in time.
fn last_lines(disk: &Background, log: &Arc<ChildLog>) -> Vec<String> {
    let log = Arc::clone(log);
    disk.call(LOG_LIMIT, move || log.last_lines(LAST_LOG_LINES)).and_then(Result::ok).unwrap_or_default()
}

/// Processor share since `before`, which is brought up to date, and memory.
fn load_of(child: &Child, before: &mut Option<Spent>) -> Load {
    let Some(usage) = child.usage() else { return Load::default() };
    let at_ns = monotonic_ns();
    let then = before.get_or_insert(Spent { at_ns, cpu_s: usage.cpu_s, percent: 0.0 });
    let elapsed_ns = at_ns.saturating_sub(then.at_ns);
    if elapsed_ns >= LOAD_WINDOW_NS {
        let percent = 100.0 * (usage.cpu_s - then.cpu_s).max(0.0) / (elapsed_ns as f64 * 1e-9);
        *then = Spent { at_ns, cpu_s: usage.cpu_s, percent };
    }
    Load { cpu_percent: then.percent, memory_kib: usage.memory_kib }
}

fn spent_so_far(child: &Child) -> Spent {
    let cpu_s = child.usage().map_or(0.0, |usage| usage.cpu_s);
    Spent { at_ns: monotonic_ns(), cpu_s, percent: 0.0 }
}
