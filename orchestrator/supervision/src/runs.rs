//! Runs that live on this machine, found in `/proc` alone.
//!
//! A process of a run names its run, system and role in its environment, and holds the page of the stop word open.
//! So a run is found without its directory, its bus, its lock and its orchestrator.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use runtime::{
    DIRECTORY_VARIABLE, Domain, Identified, Identity, ROLE_VARIABLE, RuntimeError, SYSTEM_ID_VARIABLE, Seen,
    StopWord, identify, start_ticks, started_processes, uid_of,
};
use shared_types::Role;

/// A run with at least one living process.
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
    /// Its processes, without the orchestrator.
    pub processes: Vec<RunProcess>,
}

/// A process of a run.
#[derive(Debug, Clone)]
pub struct RunProcess {
    /// Distinguishes it from an unrelated process with the same number.
    pub identity: Identity,
    /// The role that it, or the process that started it, was started for.
    pub role: Option<Role>,
}

impl RunProcess {
    /// Opens it for a signal; `None` when it has ended.
    pub fn open(&self) -> Option<Identified> {
        identify(&self.identity).ok()
    }

    /// `controller 812`.
    pub fn label(&self) -> String {
        format!("{} {}", self.role.map_or("process", Role::name), self.identity.pid)
    }
}

impl LivingRun {
    /// All runs of a user.
    pub fn all(uid: u32) -> Vec<Self> {
        let mut runs: Vec<Self> = Vec::new();
        for seen in started_processes(uid) {
            let run_id = seen.identity.run_id.clone();
            Self::entry(&mut runs, &run_id, uid).take(seen);
        }
        for (run_id, link) in stop_words(uid) {
            let run = Self::entry(&mut runs, &run_id, uid);
            if run.word.is_none() {
                run.word = StopWord::open(&link).ok();
            }
        }
        runs.retain(|run| !run.is_over());
        runs.iter_mut().for_each(Self::name);
        runs.sort_by(|one, other| one.system_id.cmp(&other.system_id));
        runs
    }

    /// The run of that id of this user, if any of it lives.
    pub fn of(run_id: &str) -> Option<Self> {
        Self::all(rustix::process::geteuid().as_raw()).into_iter().find(|run| run.run_id == run_id)
    }

    /// The living processes of one role.
    pub fn of_role(&self, role: Role) -> impl Iterator<Item = Identified> {
        self.processes.iter().filter(move |process| process.role == Some(role)).filter_map(RunProcess::open)
    }

    /// Process id of the orchestrator, if it lives. Any process of the user can write into the page of the stop word, so a
    /// process of another user is never taken for the orchestrator: otherwise root could be made to end it.
    pub fn orchestrator(&self) -> Option<u32> {
        let (pid, ticks) = self.word.as_ref()?.orchestrator();
        (pid != 0 && uid_of(pid) == Some(self.uid) && start_ticks(pid) == Some(ticks)).then_some(pid)
    }

    /// Whether neither a process nor the orchestrator lives.
    pub fn is_over(&self) -> bool {
        self.orchestrator().is_none() && self.living_processes().next().is_none()
    }

    /// Its processes that still live.
    pub fn living_processes(&self) -> impl Iterator<Item = &RunProcess> {
        self.processes.iter().filter(|process| process.open().is_some())
    }

    /// Its living processes and orchestrator, as `controller 812`.
    pub fn alive(&self) -> Vec<String> {
        let processes = self.living_processes().map(RunProcess::label);
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
        self.processes.push(RunProcess { identity: seen.identity, role });
    }

    /// A run without processes has its name from its directory.
    fn name(&mut self) {
        if !self.system_id.is_empty() {
            return;
        }
        let domains = Domain::all().unwrap_or_default();
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
/// [`RuntimeError::NotRunning`] when there is none, and as [`find`].
pub fn existing(system_id: &str) -> Result<Domain, RuntimeError> {
    find(system_id)?.ok_or_else(|| RuntimeError::NotRunning(system_id.to_owned()))
}

/// A living run of that id of this user.
pub fn living(system_id: &str) -> Option<LivingRun> {
    let own = rustix::process::geteuid().as_raw();
    LivingRun::all(own).into_iter().find(|run| run.system_id == system_id)
}

/// Run ids and paths of all stop words of a user that the processes of that user hold open; a process may also hold a file
/// of another user.
fn stop_words(uid: u32) -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    // Not through this process: another thread may have reused a number meanwhile for another file. Opening and closing
    // that one would drop the lock by which the bus knows that this process lives.
    let own = std::process::id();
    for pid in runtime::processes(uid).filter(|pid| *pid != own) {
        let Ok(entries) = std::fs::read_dir(format!("/proc/{pid}/fd")) else { continue };
        for path in entries.flatten().map(|entry| entry.path()) {
            let Ok(link) = std::fs::read_link(&path) else { continue };
            if let Some(run_id) = StopWord::run_id_of_link(Path::new(&link))
                && std::fs::metadata(&path).is_ok_and(|page| page.uid() == uid)
            {
                found.push((run_id.to_owned(), path));
            }
        }
    }
    found
}
