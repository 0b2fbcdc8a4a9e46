//! Runs that live on this machine, found in `/proc` alone.
//!
//! A process of a run names its run, system and role in its environment, and holds the page of the stop word open.
//! So a run is found without its directory, its bus, its lock and its orchestrator.
//!
//! A run lives while its orchestrator lives, or a process that the orchestrator has started, with the group of that process.
//! What such a process has started in a group of its own, a daemon, inherits the same environment and is a *stray*: it is
//! named and ended, but no run lives by it. This is the one definition for all commands.
//!
//! A stray may have changed its user. Root finds it as long as its run has another process, or it holds the page of the stop
//! word of its run itself. It is never more than a stray: another user may have given a process the environment of a run.
//!
//! Limit: processes of other pid or user namespaces are not visible here; [`crate::lock::is_hidden`] notices them.

use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use runtime::{
    COMPANION_VARIABLE, DIRECTORY_VARIABLE, Domain, Identified, Identity, ROLE_VARIABLE, RuntimeError,
    SYSTEM_ID_VARIABLE, Seen, StopWord, identify, start_ticks, started_processes,
    started_processes_of_others, uid_of,
};
use shared_types::Role;

/// A run of which at least one process lives; only strays for one that is over.
#[derive(Debug, Clone, Default)]
pub struct LivingRun {
    /// Id of its system.
    pub system_id: String,
    /// Its random id.
    pub run_id: String,
    /// The user it runs as.
    pub uid: u32,
    /// The directory of its system.
    pub directory: Option<PathBuf>,
    /// Its stop word, if any of its processes still has it.
    pub word: Option<StopWord>,
    /// Its processes and strays, without the orchestrator.
    pub processes: Vec<RunProcess>,
}

/// The link of a system to other hosts has this incarnation.
const LINK_INCARNATION: u32 = 0;

/// A process of a run.
#[derive(Debug, Clone)]
pub struct RunProcess {
    /// Distinguishes it from an unrelated process with the same number.
    pub identity: Identity,
    /// The role that it, or the process that started it, was started for.
    pub role: Option<Role>,
    /// The companion that it, or the process that started it, is.
    companion: Option<String>,
    /// Its process group.
    group: u32,
    /// Whether the orchestrator did not start it.
    pub is_stray: bool,
}

impl RunProcess {
    /// Opens it for a signal; `None` when it has ended.
    pub fn open(&self) -> Option<Identified> {
        identify(&self.identity).ok()
    }

    /// Its process group.
    pub fn group(&self) -> u32 {
        self.group
    }

    /// `controller 812`.
    pub fn label(&self) -> String {
        format!("{} {}", self.role.map_or("process", Role::name), self.identity.pid)
    }

    /// `process 97 (sleep), which companion lidar has started`.
    pub fn description(&self) -> String {
        let pid = self.identity.pid;
        let program = std::fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
        // A program names itself, with what moves the cursor of a terminal too.
        let program: String = program.chars().filter(|letter| !letter.is_control()).collect();
        let starter = match (self.role, &self.companion) {
            (Some(role), _) => format!("the process of role {role}"),
            (None, Some(name)) => format!("companion {name}"),
            (None, None) => "a process of the run".to_owned(),
        };
        format!("process {pid} ({program}), which {starter} has started")
    }
}

impl LivingRun {
    /// All runs of a user that live.
    pub fn all(uid: u32) -> Vec<Self> {
        let mut runs = Self::with_strays(uid);
        runs.retain(|run| !run.is_over());
        runs
    }

    /// [`LivingRun::of`], also when only strays are left of it, or a process that has nothing but its stop word.
    pub fn seen(run_id: &str) -> Option<Self> {
        Self::gathered(rustix::process::geteuid().as_raw()).into_iter().find(|run| run.run_id == run_id)
    }

    /// All runs of a user, also those that are over but have left strays.
    pub fn with_strays(uid: u32) -> Vec<Self> {
        let mut runs = Self::gathered(uid);
        runs.retain(|run| !run.is_over() || run.strays().next().is_some());
        runs.iter_mut().for_each(Self::name);
        runs.sort_by(|one, other| one.system_id.cmp(&other.system_id));
        runs
    }

    /// All that is found of runs of a user.
    fn gathered(uid: u32) -> Vec<Self> {
        let mut runs: Vec<Self> = Vec::new();
        for seen in started_processes(uid) {
            let run_id = seen.identity.run_id.clone();
            Self::entry(&mut runs, &run_id, uid).take(seen);
        }
        Self::find_stop_words(&mut runs, uid);
        for seen in started_processes_of_others(uid) {
            let (run_id, pid) = (seen.identity.run_id.clone(), seen.identity.pid);
            let is_known = runs.iter().any(|run| run.run_id == run_id);
            if is_known || stop_words_of(pid, uid).any(|(held, _)| held == run_id) {
                Self::entry(&mut runs, &run_id, uid).take(seen);
            }
        }
        runs.iter_mut().for_each(Self::mark_strays);
        runs
    }

    /// Opens the stop words of runs, and adds the runs of which nothing else is known: those of all processes of the user, one
    /// of which is the orchestrator. Of the processes of a run, which hold a hundred files each, one is enough, and only its
    /// own run is looked for.
    fn find_stop_words(runs: &mut Vec<Self>, uid: u32) {
        // Not through this process: another thread may have reused a number meanwhile for another file. Opening and closing
        // that one would drop the lock by which the bus knows that this process lives.
        let own = std::process::id();
        for pid in runtime::processes(uid).filter(|pid| *pid != own) {
            let is_of = |run: &&mut Self| run.processes.iter().any(|process| process.identity.pid == pid);
            if let Some(run) = runs.iter_mut().find(is_of) {
                let mut words = stop_words_of(pid, uid).filter(|(run_id, _)| *run_id == run.run_id);
                let open = || words.find_map(|(_, link)| StopWord::open(&link).ok());
                run.word = run.word.take().or_else(open);
                continue;
            }
            for (run_id, link) in stop_words_of(pid, uid) {
                let run = Self::entry(runs, &run_id, uid);
                if run.word.is_none() {
                    run.word = StopWord::open(&link).ok();
                }
            }
        }
    }

    /// The run of that id of this user, if any of it lives.
    pub fn of(run_id: &str) -> Option<Self> {
        Self::all(rustix::process::geteuid().as_raw()).into_iter().find(|run| run.run_id == run_id)
    }

    /// Its processes and strays without this process: a command that a process of the run has started must not end itself.
    pub fn others(&self) -> impl Iterator<Item = &RunProcess> + Clone {
        let own = std::process::id();
        self.processes.iter().filter(move |process| process.identity.pid != own)
    }

    /// The living processes of one role, of the user of the run; without this process.
    pub fn of_role(&self, role: Role) -> impl Iterator<Item = Identified> {
        let own = self.others().filter(|process| process.identity.uid == self.uid);
        own.filter(move |process| process.role == Some(role)).filter_map(RunProcess::open)
    }

    /// Process id of the orchestrator, if it lives. Any process of the user can write into the page of the stop word, so a
    /// process of another user is never taken for the orchestrator: otherwise root could be made to end it.
    pub fn orchestrator(&self) -> Option<u32> {
        let (pid, ticks) = self.word.as_ref()?.orchestrator();
        (pid != 0 && uid_of(pid) == Some(self.uid) && start_ticks(pid) == Some(ticks)).then_some(pid)
    }

    /// Whether neither the orchestrator nor a process that it started lives.
    pub fn is_over(&self) -> bool {
        self.orchestrator().is_none() && self.members().next().is_none()
    }

    /// Its processes that still live, without strays and without this process.
    pub fn members(&self) -> impl Iterator<Item = &RunProcess> {
        self.others().filter(|process| !process.is_stray && process.open().is_some())
    }

    /// What its processes have started in groups of its own, and still lives; without this process.
    pub fn strays(&self) -> impl Iterator<Item = &RunProcess> {
        self.others().filter(|process| process.is_stray && process.open().is_some())
    }

    /// Its living processes and orchestrator, as `controller 812`.
    pub fn alive(&self) -> Vec<String> {
        let processes = self.members().map(RunProcess::label);
        processes.chain(self.orchestrator().map(|pid| format!("orchestrator {pid}"))).collect()
    }

    /// The directory of its system, if it is this user's and still of this run; also one in a place that is not searched,
    /// because the run was started with other variables.
    pub fn domain(&self) -> Option<Domain> {
        let domain = Domain::at(&self.system_id, &self.run_id, self.directory.as_ref()?).ok()?;
        domain.is_current().then_some(domain)
    }

    /// The run of that id, added when it is new.
    fn entry<'a>(runs: &'a mut Vec<Self>, run_id: &str, uid: u32) -> &'a mut Self {
        let index = runs.iter().position(|run| run.run_id == run_id).unwrap_or_else(|| {
            runs.push(Self { run_id: run_id.to_owned(), uid, ..Self::default() });
            runs.len() - 1
        });
        &mut runs[index]
    }

    fn take(&mut self, seen: Seen) {
        if self.system_id.is_empty() {
            self.system_id = seen.variable(SYSTEM_ID_VARIABLE).unwrap_or_default();
            self.directory = seen.variable(DIRECTORY_VARIABLE).map(PathBuf::from);
        }
        let role = seen.variable(ROLE_VARIABLE).and_then(|name| name.parse().ok());
        let (companion, group) = (seen.variable(COMPANION_VARIABLE), seen.group);
        let identity = seen.identity;
        self.processes.push(RunProcess { identity, role, companion, group, is_stray: false });
    }

    /// Tells strays by the page of the stop word. Where that does not tell, none is: the safe side. Where no process has
    /// it, all are, because those of the orchestrator inherit it. One that reports what the wheels do is none. One of
    /// another user is always one.
    fn mark_strays(&mut self) {
        let word = self.word.clone();
        for process in &mut self.processes {
            let pid = process.identity.pid;
            let reports = |word: &StopWord| Role::ALL.iter().any(|role| word.obeyed_by(*role) == pid);
            let is_told = |word: &StopWord| word.has_started(process.group) == Some(false) && !reports(word);
            process.is_stray = process.identity.uid != self.uid
                || process.identity.incarnation != LINK_INCARNATION && word.as_ref().is_none_or(is_told);
        }
    }

    /// A run without processes has its name from its directory, in the places that can be opened.
    fn name(&mut self) {
        if !self.system_id.is_empty() {
            return;
        }
        let (domains, _) = Domain::all_found();
        if let Some(domain) = domains.into_iter().find(|domain| domain.run_id() == self.run_id) {
            self.system_id = domain.system_id().to_owned();
            self.directory = Some(domain.directory().to_path_buf());
        }
    }
}

/// The system of that id, also with its directory in a place that is not searched.
///
/// # Errors
/// [`RuntimeError::SystemId`], and [`RuntimeError::NotPrivate`] for a directory that is not this user's alone.
pub fn find(system_id: &str) -> Result<Option<Domain>, RuntimeError> {
    let found = Domain::find(system_id)?;
    Ok(found.or_else(|| living(system_id)?.domain()))
}

/// [`find`] for a command that needs one.
///
/// # Errors
/// That of [`absent`] when there is none, and as [`find`].
pub fn existing(system_id: &str) -> Result<Domain, RuntimeError> {
    find(system_id)?.ok_or_else(|| absent(system_id))
}

/// Why this user has no system of that id: [`RuntimeError::NotRunning`], or [`RuntimeError::OfAnother`] where root sees
/// that another user has.
pub fn absent(system_id: &str) -> RuntimeError {
    let is_it = |seen: &Seen| seen.variable(SYSTEM_ID_VARIABLE).as_deref() == Some(system_id);
    let others = started_processes_of_others(rustix::process::geteuid().as_raw()).into_iter().filter(is_it);
    let mut users: Vec<u32> = others.map(|seen| seen.identity.uid).collect();
    users.dedup();
    let runs = users.into_iter().flat_map(LivingRun::all).find(|run| run.system_id == system_id);
    match runs.and_then(|run| Some((run.uid, run.directory?.parent()?.to_owned()))) {
        Some((uid, place)) => RuntimeError::OfAnother { system_id: system_id.to_owned(), uid, place },
        None => RuntimeError::NotRunning(system_id.to_owned()),
    }
}

/// A living run of that id of this user.
pub fn living(system_id: &str) -> Option<LivingRun> {
    let own = rustix::process::geteuid().as_raw();
    LivingRun::all(own).into_iter().find(|run| run.system_id == system_id)
}

/// What runs of a system that are over have left: processes of this user.
pub fn strays_of(system_id: &str) -> Vec<RunProcess> {
    let runs = LivingRun::with_strays(rustix::process::geteuid().as_raw()).into_iter();
    let over = runs.filter(|run| run.is_over() && run.system_id == system_id);
    over.flat_map(|run| run.strays().cloned().collect::<Vec<_>>()).collect()
}

/// Run ids and paths of the stop words of a user that a process holds open.
fn stop_words_of(pid: u32, uid: u32) -> impl Iterator<Item = (String, PathBuf)> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let held = move |path: PathBuf| {
        let link = std::fs::read_link(&path).ok()?;
        let run_id = StopWord::run_id_of_link(&link)?.to_owned();
        std::fs::metadata(&path).is_ok_and(|page| page.uid() == uid).then_some((run_id, path))
    };
    entries.filter_map(move |entry| held(entry.path()))
}
