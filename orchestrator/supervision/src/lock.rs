//! One orchestrator per system: the lock, and the removal of the files of a run.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, Write};
use std::os::unix::fs::MetadataExt;

use anyhow::Context;
use console::exit::Failure;
use runtime::{Domain, LEAVING, LOCK_FILE, RuntimeError, monotonic_ns, pid_namespace};
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::{FdFlags, fcntl_setfd};

use crate::child::is_suspended;
use crate::halt;
use crate::runs::{self, LivingRun};

/// The last process of a system without an orchestrator cleans up within this time, and so does a run that was stopped [ns].
const LEAVING_NS: u64 = 15_000_000_000;
/// Descriptors reserved for the removal of files, also when the limit is reached: the depth of these files, and two.
const SPARE_DESCRIPTORS: usize = 6;
/// File in the directory of the system that all processes of a run hold locked, by a descriptor that they inherit.
const LIVING_FILE: &str = "living";
/// A lock that another command only probes is free again at one of so many tries.
const PROBES: u32 = 10;
/// Time between two of them.
const PROBE_POLL: std::time::Duration = std::time::Duration::from_millis(2);
/// Time between two tries.
const RETRY: std::time::Duration = std::time::Duration::from_millis(20);

/// The right to run a system. Dropping it gives the right back; from [`SystemLock::own`] on it also removes everything
/// that the system has on this machine: nothing is left in shared memory or in its directory, however the run ended.
#[derive(Debug)]
pub struct SystemLock {
    domain: Domain,
    _lock: File,
    spare: Vec<File>,
    /// Inherited by all processes that are started from now on.
    living: Option<File>,
    owns: bool,
}

/// What is found under the id of a system that is to run.
pub enum Claim {
    /// Nothing: the directory was just made.
    New(Domain, SystemLock),
    /// What a run has left whose orchestrator is gone; its processes may live.
    Left(Domain, SystemLock),
}

impl Claim {
    /// Takes the right to run the system of that id. Waits for a run that was stopped and is just ending.
    ///
    /// # Errors
    /// [`RuntimeError::AlreadyRunning`] while another orchestrator lives, [`RuntimeError::NotPrivate`] for a directory that
    /// is not this user's alone, and errors of the file system.
    pub fn take(system_id: &str) -> anyhow::Result<Self> {
        let deadline_ns = monotonic_ns() + LEAVING_NS;
        loop {
            let taken = match Domain::find(system_id)? {
                Some(domain) => SystemLock::try_take(&domain)?.map(|lock| Self::Left(domain, lock)),
                None => match runs::living(system_id) {
                    Some(run) => return Err(already_running(system_id, &run)),
                    None => Self::make(system_id)?,
                },
            };
            if let Some(claim) = taken {
                return Ok(claim);
            }
            if !is_leaving(system_id) || monotonic_ns() > deadline_ns {
                let holder = || {
                    Domain::find(system_id)
                        .ok()
                        .flatten()
                        .map_or("unknown".to_owned(), |domain| holder(&domain))
                };
                let pid = runs::living(system_id)
                    .and_then(|run| run.orchestrator())
                    .map_or_else(holder, |pid| pid.to_string());
                return Err(RuntimeError::AlreadyRunning { system_id: system_id.to_owned(), pid }.into());
            }
            std::thread::sleep(RETRY);
        }
    }

    /// [`Claim::take`]; the processes and files that an earlier run has left are ended and removed.
    ///
    /// # Errors
    /// As [`Claim::take`], and a robot of an earlier run that is not known to rest.
    pub fn take_new(system_id: &str) -> anyhow::Result<(Domain, SystemLock)> {
        loop {
            match Self::take(system_id)? {
                Self::New(domain, lock) => return Ok((domain, lock)),
                Self::Left(domain, lock) => clear(&domain, lock)?,
            }
        }
    }

    /// `None` when another process made the same system meanwhile.
    fn make(system_id: &str) -> anyhow::Result<Option<Self>> {
        let domain = match Domain::create(system_id) {
            Err(RuntimeError::File { source, .. }) if source.kind() == ErrorKind::AlreadyExists => {
                return Ok(None);
            }
            made => made?,
        };
        let Some(mut lock) = SystemLock::try_take(&domain)? else {
            // A `stop` that came in between removes the directory, but may not have seen the run id.
            domain.remove_bus_files()?;
            return Ok(None);
        };
        // No other process will remove what is there.
        lock.own();
        Ok(Some(Self::New(domain, lock)))
    }
}

/// Ends the processes of a run whose orchestrator is gone, and removes its files with the lock.
///
/// # Errors
/// A robot that is not known to rest, a process that does not go, and a file that can't be removed.
pub fn clear(domain: &Domain, lock: SystemLock) -> anyhow::Result<()> {
    if let Some(run) = LivingRun::of(domain.run_id()) {
        halt::block(&run);
        let left = halt::finish(&run);
        if !left.is_empty() {
            return Err(Failure::process(format!(
                "an earlier run of system `{}` does not end: {}",
                domain.system_id(),
                left.join(", ")
            )));
        }
    }
    Ok(lock.remove()?)
}

impl SystemLock {
    /// Takes the lock of a system that has a directory and leaves everything else as it is.
    ///
    /// # Errors
    /// [`RuntimeError::AlreadyRunning`] while another orchestrator holds it, and errors of the file system.
    pub fn take(domain: &Domain) -> anyhow::Result<Self> {
        match Self::try_take(domain)? {
            Some(lock) => Ok(lock),
            None => {
                let run = LivingRun::of(domain.run_id());
                let pid = run
                    .and_then(|run| run.orchestrator())
                    .map_or_else(|| holder(domain), |pid| pid.to_string());
                Err(RuntimeError::AlreadyRunning { system_id: domain.system_id().to_owned(), pid }.into())
            }
        }
    }

    /// `None` while another process holds it, or when the directory has just been removed.
    fn try_take(domain: &Domain) -> anyhow::Result<Option<Self>> {
        let folder = domain.folder();
        let context = || folder.path().join(LOCK_FILE).display().to_string();
        let mut lock = match folder.open_file(LOCK_FILE, OFlags::RDWR | OFlags::CREATE) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            opened => opened.with_context(context)?,
        };
        if !can_lock(&lock, FlockOperation::NonBlockingLockExclusive) {
            return Ok(None);
        }
        // An earlier holder may have removed the file meanwhile: then this lock protects nothing.
        let same = |there: &File| {
            let pair = lock.metadata().and_then(|here| there.metadata().map(|there| (here, there)));
            pair.is_ok_and(|(here, there)| (here.dev(), here.ino()) == (there.dev(), there.ino()))
        };
        if !folder.open_file(LOCK_FILE, OFlags::RDONLY).is_ok_and(|there| same(&there)) || !domain.exists() {
            return Ok(None);
        }
        // No orchestrator lives, but processes may that can't be seen here: their files are left to them.
        if is_held(domain) && LivingRun::seen(domain.run_id()).is_none() {
            return Err(hidden(domain));
        }
        lock.set_len(0).and_then(|()| lock.rewind()).with_context(context)?;
        writeln!(lock, "{} {}", std::process::id(), pid_namespace()).with_context(context)?;
        let spare = std::iter::repeat_with(|| lock.try_clone()).take(SPARE_DESCRIPTORS).flatten().collect();
        Ok(Some(Self { domain: domain.clone(), _lock: lock, spare, living: None, owns: false }))
    }

    /// From now on the files of the system belong to this run: they are removed when the lock is dropped. The processes
    /// that are started from now on hold a lock of their own on the system, which no namespace hides.
    pub fn own(&mut self) {
        self.owns = true;
        let held =
            self.domain.folder().open_file(LIVING_FILE, OFlags::RDWR | OFlags::CREATE).and_then(|file| {
                if !can_lock(&file, FlockOperation::NonBlockingLockShared) {
                    return Err(ErrorKind::WouldBlock.into());
                }
                fcntl_setfd(&file, FdFlags::empty())?;
                Ok(file)
            });
        match held {
            Ok(file) => self.living = Some(file),
            Err(error) => tracing::warn!(%error, "commands of other namespaces will not see this run"),
        }
    }

    /// Removes everything that the system has on this machine.
    fn remove(mut self) -> Result<(), RuntimeError> {
        self.owns = false;
        self.spare.clear();
        self.living = None;
        self.domain.remove()
    }
}

impl Drop for SystemLock {
    fn drop(&mut self) {
        self.spare.clear();
        if self.owns
            && let Err(error) = self.domain.remove()
        {
            tracing::warn!("not cleaned up: {error:#}");
        }
    }
}

/// Whether processes of the system live of which none can be seen: they are in another pid or user namespace.
pub fn is_hidden(domain: &Domain) -> bool {
    is_held(domain) && LivingRun::seen(domain.run_id()).is_none() && !is_here(&text_of(domain))
}

/// Whether a lock with this text is not that of a process which can't be seen: its holder can be seen, an orchestrator
/// that has not made its stop word yet; or there is no text, because the directory is just being made or removed.
fn is_here(text: &str) -> bool {
    if text.is_empty() {
        return true;
    }
    let mut words = text.split_whitespace();
    let (pid, namespace) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    namespace == pid_namespace().to_string() && std::fs::read(format!("/proc/{pid}/environ")).is_ok()
}

/// Whether any process holds the lock that processes of a run inherit.
fn is_held(domain: &Domain) -> bool {
    let opened = domain.folder().open_file(LIVING_FILE, OFlags::RDWR);
    opened.is_ok_and(|file| !can_lock(&file, FlockOperation::NonBlockingLockExclusive))
}

/// Locks a file; false when a process holds it, not only probes it at this moment.
fn can_lock(file: &File, operation: FlockOperation) -> bool {
    (0..PROBES).any(|probe| {
        if probe > 0 {
            std::thread::sleep(PROBE_POLL);
        }
        flock(file, operation).is_ok()
    })
}

/// That a system can't be judged or ended from here; exit code 4.
pub fn hidden(domain: &Domain) -> anyhow::Error {
    Failure::process(format!(
        "system `{}` can't be seen from this PID namespace: its processes live in another PID or user namespace; \
         run the command there",
        domain.system_id()
    ))
}

/// What is written in the lock: the process id of its holder and its pid namespace, or [`LEAVING`].
fn text_of(domain: &Domain) -> String {
    let mut text = String::new();
    if let Ok(mut file) = domain.folder().open_file(LOCK_FILE, OFlags::RDONLY) {
        let _ = file.read_to_string(&mut text);
    }
    text
}

/// Process id of the orchestrator that holds the lock of a system, if it can't run because it was suspended or frozen.
pub fn suspended_orchestrator(domain: &Domain) -> Option<u32> {
    let text = text_of(domain);
    let (pid, namespace) = text.trim().split_once(' ')?;
    let is_here = namespace == pid_namespace().to_string();
    // A process that was killed leaves the text, and another one may have its number now.
    let is_locked = || {
        let opened = domain.folder().open_file(LOCK_FILE, OFlags::RDONLY);
        opened.is_ok_and(|file| !can_lock(&file, FlockOperation::NonBlockingLockShared))
    };
    pid.parse().ok().filter(|pid| is_here && is_suspended(*pid) && is_locked())
}

/// Why an orchestrator that is suspended does nothing: `process 97 was suspended by a signal ...`.
pub fn suspension(pid: u32) -> String {
    format!("process {pid} was suspended by a signal (`kill -CONT {pid}`), or its control group is frozen")
}

/// Notices for a command that observes a system that its orchestrator stands still, and that it runs again.
#[derive(Debug, Default)]
pub struct Standstill {
    pid: Option<u32>,
}

impl Standstill {
    /// A sentence when that has changed since the last call.
    pub fn change(&mut self, domain: &Domain) -> Option<String> {
        let before = std::mem::replace(&mut self.pid, suspended_orchestrator(domain));
        let system_id = domain.system_id();
        match self.pid {
            now if now == before => None,
            Some(pid) => Some(format!(
                "the orchestrator of system `{system_id}` does not run, so the robot stops and its topics fall silent: {}",
                suspension(pid)
            )),
            None => Some(format!("the orchestrator of system `{system_id}` no longer stands still")),
        }
    }
}

fn holder(domain: &Domain) -> String {
    text_of(domain).split_whitespace().next().unwrap_or("unknown").to_owned()
}

/// Whether the system is about to end: its last process cleans up, it was stopped, or no process of it lives.
fn is_leaving(system_id: &str) -> bool {
    let Ok(Some(domain)) = Domain::find(system_id) else { return true };
    // Without a living process it is just being made or removed.
    let Some(run) = LivingRun::of(domain.run_id()) else { return !is_hidden(&domain) };
    text_of(&domain).contains(LEAVING) || run.word.is_some_and(|word| !word.is_armed())
}

/// A run whose directory is not in a searched place.
fn already_running(system_id: &str, run: &LivingRun) -> anyhow::Error {
    let place = run.directory.as_ref().map_or("no directory".to_owned(), |path| path.display().to_string());
    let alive = run.alive().join(", ");
    Failure::bad_input(format!(
        "system `{system_id}` is already running in {place} ({alive}); `scanloop stop` ends it, or choose another with \
         --system-id"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_directory_that_is_being_removed_is_not_hidden() {
        let id = format!("lockgone{}", std::process::id());
        let domain = Domain::create(&id).unwrap();
        let mut lock = SystemLock::take(&domain).unwrap();
        lock.own();
        assert!(is_here(&text_of(&domain)) && !is_hidden(&domain));
        let elsewhere = format!("{} {}\n", std::process::id(), pid_namespace() + 1);
        std::fs::write(domain.directory().join(LOCK_FILE), elsewhere).unwrap();
        assert!(is_hidden(&domain) && !is_leaving(&id), "its holder lives in another namespace");
        // The file of the lock goes before the directory does.
        std::fs::remove_file(domain.directory().join(LOCK_FILE)).unwrap();
        assert!(!is_hidden(&domain) && is_leaving(&id));
    }

    #[test]
    fn a_run_waits_for_a_stop_that_removes_what_was_left() {
        let id = format!("lock{}", std::process::id());
        let left = Domain::create(&id).unwrap();
        let mut stop = SystemLock::take(&left).unwrap();
        stop.own();
        let run = std::thread::spawn(move || {
            let (domain, _lock) = Claim::take_new(&id)?;
            anyhow::Ok(domain)
        });
        std::thread::sleep(5 * RETRY);
        assert!(!run.is_finished(), "no process lives, so it is not running already");
        drop(stop);
        let made = run.join().unwrap().unwrap();
        assert!(made.run_id() != left.run_id() && !made.exists() && !left.bus_directory().exists());
    }

    #[test]
    fn commands_that_probe_at_once_take_each_other_for_no_process_of_the_run() {
        let domain = Domain::create(&format!("lockprobe{}", std::process::id() % 1_000_000)).unwrap();
        domain.folder().write(LIVING_FILE, b"").unwrap();
        let opened = || domain.folder().open_file(LIVING_FILE, OFlags::RDWR).unwrap();
        let probed = opened();
        flock(&probed, FlockOperation::NonBlockingLockExclusive).unwrap();
        let probe = std::thread::spawn(move || {
            std::thread::sleep(PROBE_POLL);
            drop(probed);
        });
        assert!(!is_held(&domain), "it is only probed");
        probe.join().unwrap();
        let held = opened();
        flock(&held, FlockOperation::NonBlockingLockShared).unwrap();
        assert!(is_held(&domain));
        domain.remove().unwrap();
    }

    #[test]
    fn a_suspended_process_is_the_orchestrator_only_while_the_lock_is_held() {
        let domain = Domain::create(&format!("locksusp{}", std::process::id() % 1_000_000)).unwrap();
        let mut process = std::process::Command::new("sleep").arg("90").spawn().unwrap();
        let pid = rustix::process::Pid::from_child(&process);
        rustix::process::kill_process(pid, rustix::process::Signal::STOP).unwrap();
        while !is_suspended(process.id()) {
            std::thread::sleep(PROBE_POLL);
        }
        let lock = SystemLock::take(&domain).unwrap();
        let text = format!("{} {}\n", process.id(), pid_namespace());
        std::fs::write(domain.directory().join(LOCK_FILE), text).unwrap();
        assert_eq!(suspended_orchestrator(&domain), Some(process.id()));
        drop(lock);
        assert_eq!(suspended_orchestrator(&domain), None, "the number is that of another process");
        process.kill().unwrap();
        process.wait().unwrap();
        domain.remove().unwrap();
    }
}
