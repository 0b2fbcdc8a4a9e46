//! The stop word: one page of memory through which any process of the same user stops a run, whatever else has failed.
//!
//! Driving needs the exact value [`ARMED`] in the page; any other value is a stop. Actuator and robot check it with
//! each sample and at least ten times a second, so a stop needs no bus, no directory, no lock and no orchestrator. A
//! stop is final: the next run has a page of its own.
//!
//! The page is an anonymous file (memfd) whose memory is allocated when it is made and which is sealed against
//! shrinking, so that no access can fault. The orchestrator's processes inherit its descriptor; others of the same
//! user reach it as `/proc/PID/fd/N` of any process of the run. Actuator and robot write into it what the wheels do,
//! so that a stop can be confirmed. The orchestrator lists the processes that it has started, because what these start
//! themselves inherits environment and descriptors, but is no part of the run.
//!
//! Limits: a process of the same user can write anything into the page. A robot that neither obeys it nor receives
//! actuations is stopped by its own dead man at best.
#![expect(unsafe_code, reason = "shared memory is mapped from a file")]

use std::fs::OpenOptions;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd, RawFd};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rustix::fs::{FallocateFlags, MemfdFlags, Mode, SealFlags};
use serde::{Deserialize, Serialize};
use shared_types::{ROLES, Role};

use crate::shared_memory::Mapped;
use crate::{RuntimeError, STOP_FD_VARIABLE, identity, monotonic_ns};

/// The only value with which wheels may turn.
const ARMED: u64 = 0x5ca1_ab1e_d01e_d0e5;
/// What is written for a stop.
const STOPPED: u64 = 0;
/// Number of the layout of the page.
const VERSION: u64 = 1;
/// Start of the name of the page in `/proc/PID/fd`.
const NAME: &str = "scanloop-stop-";
/// Size of the page [bytes].
const LENGTH: usize = 4096;
/// Most living processes of a run on one host: five roles with their candidates, and 45 companions with theirs.
const MAX_STARTED: usize = 128;

/// What the wheels do, as a role reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(u64)]
pub enum Wheels {
    /// Nothing was reported.
    Unknown = 0,
    /// They may turn.
    Turning = 1,
    /// They are blocked; the robot may still slide.
    Blocked = 2,
    /// They are blocked, and the robot stands.
    Resting = 3,
}

impl Wheels {
    /// Whether they are blocked, whatever the robot does then.
    pub fn are_blocked(self) -> bool {
        self >= Self::Blocked
    }
}

impl From<u64> for Wheels {
    fn from(value: u64) -> Self {
        match value {
            1 => Self::Turning,
            2 => Self::Blocked,
            3 => Self::Resting,
            _ => Self::Unknown,
        }
    }
}

/// Content of the memory: one cache line, one per role, then the started processes.
#[repr(C)]
struct Page {
    head: Head,
    rows: [Row; ROLES],
    started: [Started; MAX_STARTED],
}

#[repr(C, align(64))]
struct Head {
    version: AtomicU64,
    word: AtomicU64,
    stopped_ns: AtomicU64,
    period_ns: AtomicU64,
    orchestrator_pid: AtomicU64,
    orchestrator_ticks: AtomicU64,
    /// Inode of the pid namespace of the orchestrator, in which all process ids of the page hold.
    pid_namespace: AtomicU64,
}

/// Written by the process in charge of a role.
#[repr(C, align(64))]
struct Row {
    pid: AtomicU64,
    wheels: AtomicU64,
    seen_ns: AtomicU64,
}

/// A process that the orchestrator has started; all zero when there is none.
#[repr(C)]
struct Started {
    pid: AtomicU64,
    ticks: AtomicU64,
}

const _: () = assert!(size_of::<Page>() <= LENGTH && size_of::<Head>() == 64 && size_of::<Row>() == 64);

/// The stop word of one run, mapped.
#[derive(Debug, Clone)]
pub struct StopWord(Arc<Memory>);

#[derive(Debug)]
struct Memory {
    page: Mapped<Page>,
    descriptor: OwnedFd,
}

impl StopWord {
    /// Makes the page of a new run, armed; processes that are started from now on inherit its descriptor.
    ///
    /// # Errors
    /// [`RuntimeError::System`] when the kernel refuses the memory.
    pub fn create(run_id: &str, period_ns: u64) -> Result<Self, RuntimeError> {
        let made = || -> io::Result<Self> {
            let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
            let descriptor = rustix::fs::memfd_create(format!("{NAME}{run_id}"), flags)?;
            rustix::fs::fchmod(&descriptor, Mode::RUSR | Mode::WUSR)?;
            rustix::fs::ftruncate(&descriptor, LENGTH as u64)?;
            rustix::fs::fallocate(&descriptor, FallocateFlags::empty(), 0, LENGTH as u64)?;
            rustix::fs::fcntl_add_seals(&descriptor, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
            Self::map(descriptor)
        };
        let word = made().map_err(|source| RuntimeError::System { action: "make the stop word", source })?;
        let head = word.head();
        head.period_ns.store(period_ns, Ordering::SeqCst);
        head.version.store(VERSION, Ordering::SeqCst);
        head.word.store(ARMED, Ordering::SeqCst);
        word.claim();
        Ok(word)
    }

    /// The page that this process inherited from its orchestrator; `None` when none was handed to it.
    ///
    /// # Errors
    /// [`RuntimeError::System`] when the descriptor is not that of a stop word.
    pub fn inherited() -> Result<Option<Self>, RuntimeError> {
        let Ok(text) = std::env::var(STOP_FD_VARIABLE) else { return Ok(None) };
        let number: RawFd = text
            .parse()
            .map_err(|_| RuntimeError::Environment { variable: STOP_FD_VARIABLE, value: text.clone() })?;
        // Opened again: the inherited descriptor stays open for access through /proc.
        Self::open(Path::new(&format!("/proc/self/fd/{number}"))).map(Some)
    }

    /// Opens the page through `/proc/PID/fd/N` of a process that has it.
    ///
    /// # Errors
    /// [`RuntimeError::System`] when it can't be opened, or is no stop word.
    pub fn open(path: &Path) -> Result<Self, RuntimeError> {
        let opened = || -> io::Result<Self> {
            let file = OpenOptions::new().read(true).write(true).open(path)?;
            let seals = rustix::fs::fcntl_get_seals(&file)?;
            let length = file.metadata()?.len();
            if !seals.contains(SealFlags::SHRINK) || length != LENGTH as u64 {
                return Err(io::Error::other("it is not a stop word"));
            }
            let word = Self::map(file.into())?;
            match word.head().version.load(Ordering::SeqCst) {
                VERSION => Ok(word),
                other => Err(io::Error::other(format!("it is a stop word of version {other}"))),
            }
        };
        opened().map_err(|source| RuntimeError::System { action: "open the stop word", source })
    }

    /// The run id, if a link in `/proc/PID/fd` leads to a stop word.
    pub fn run_id_of_link(link: &Path) -> Option<&str> {
        let name = link.to_str()?.strip_prefix("/memfd:")?.strip_prefix(NAME)?;
        Some(name.strip_suffix(" (deleted)").unwrap_or(name))
    }

    /// Notes this process as the orchestrator.
    pub fn claim(&self) {
        let pid = std::process::id();
        self.head().orchestrator_pid.store(u64::from(pid), Ordering::SeqCst);
        let ticks = crate::start_ticks(pid).unwrap_or(0);
        self.head().orchestrator_ticks.store(ticks, Ordering::SeqCst);
        self.head().pid_namespace.store(identity::pid_namespace(), Ordering::SeqCst);
    }

    /// Notes a process that this orchestrator has just started, in the place of one that has ended.
    pub fn enlist(&self, pid: u32) {
        let Some(ticks) = crate::start_ticks(pid) else { return };
        let is_free = |place: &&Started| {
            let before = place.pid.load(Ordering::SeqCst);
            let lives = |ticks| ticks == place.ticks.load(Ordering::SeqCst);
            before == 0 || !u32::try_from(before).ok().and_then(crate::start_ticks).is_some_and(lives)
        };
        if let Some(place) = self.0.page.started.iter().find(is_free) {
            place.pid.store(0, Ordering::SeqCst);
            place.ticks.store(ticks, Ordering::SeqCst);
            place.pid.store(pid.into(), Ordering::SeqCst);
        }
    }

    /// Whether the orchestrator has started the process of that id itself, and so the process group of that id. `None` when
    /// the page does not tell: its numbers are those of another pid namespace, or nothing was listed yet.
    pub fn has_started(&self, pid: u32) -> Option<bool> {
        let is_here = self.is_of_this_namespace();
        let listed = self.0.page.started.iter().map(|place| place.pid.load(Ordering::SeqCst));
        let listed: Vec<u64> = listed.filter(|pid| *pid != 0).collect();
        (is_here && !listed.is_empty()).then(|| listed.contains(&pid.into()))
    }

    /// Process id and start time of the orchestrator that claimed the run last. One in another pid namespace has another
    /// id here, and 0 where it can't be seen.
    pub fn orchestrator(&self) -> (u32, u64) {
        let pid = u32::try_from(self.head().orchestrator_pid.load(Ordering::SeqCst)).unwrap_or(0);
        let ticks = self.head().orchestrator_ticks.load(Ordering::SeqCst);
        let here = || identity::numbered_elsewhere(pid, ticks).unwrap_or(0);
        (if pid == 0 || self.is_of_this_namespace() { pid } else { here() }, ticks)
    }

    /// Whether the process ids in the page are those of this pid namespace.
    fn is_of_this_namespace(&self) -> bool {
        self.head().pid_namespace.load(Ordering::SeqCst) == identity::pid_namespace()
    }

    /// Whether wheels may turn.
    pub fn is_armed(&self) -> bool {
        self.head().word.load(Ordering::SeqCst) == ARMED
    }

    /// Stops the run for good. Safe to call from a signal handler.
    pub fn latch(&self) {
        let now_ns = monotonic_ns();
        let _ = self.head().stopped_ns.compare_exchange(0, now_ns, Ordering::SeqCst, Ordering::SeqCst);
        self.head().word.store(STOPPED, Ordering::SeqCst);
    }

    /// When the run was stopped [ns of CLOCK_MONOTONIC]; 0 while it is armed.
    pub fn stopped_ns(&self) -> u64 {
        self.head().stopped_ns.load(Ordering::SeqCst)
    }

    /// Scan period of the run [ns].
    pub fn period_ns(&self) -> u64 {
        self.head().period_ns.load(Ordering::SeqCst)
    }

    /// Reports what the wheels do; for the process in charge of `role`.
    pub fn report(&self, role: Role, wheels: Wheels) {
        let row = self.row(role);
        row.pid.store(u64::from(std::process::id()), Ordering::SeqCst);
        row.wheels.store(wheels as u64, Ordering::SeqCst);
        row.seen_ns.store(monotonic_ns(), Ordering::SeqCst);
    }

    /// What the process in charge of a role reported last, and when [ns of CLOCK_MONOTONIC].
    pub fn wheels(&self, role: Role) -> (Wheels, u64) {
        let row = self.row(role);
        let seen_ns = row.seen_ns.load(Ordering::SeqCst);
        (Wheels::from(row.wheels.load(Ordering::SeqCst)), seen_ns)
    }

    /// The process that reported last for a role, 0 when none has: it obeys the stop word.
    pub fn obeyed_by(&self, role: Role) -> u32 {
        u32::try_from(self.row(role).pid.load(Ordering::SeqCst)).unwrap_or(0)
    }

    /// The descriptor, as processes that are started inherit it.
    pub fn descriptor(&self) -> RawFd {
        self.0.descriptor.as_raw_fd()
    }

    /// Lets processes that are started from now on inherit the descriptor.
    ///
    /// # Errors
    /// [`RuntimeError::System`].
    pub fn hand_down(&self) -> Result<(), RuntimeError> {
        let set = rustix::io::fcntl_setfd(&self.0.descriptor, rustix::io::FdFlags::empty());
        set.map_err(|error| RuntimeError::System { action: "hand the stop word down", source: error.into() })
    }

    fn map(descriptor: OwnedFd) -> io::Result<Self> {
        // SAFETY: atomics only; the file has the length of a page, which its seals keep.
        let page = unsafe { Mapped::new(&descriptor) }?;
        Ok(Self(Arc::new(Memory { page, descriptor })))
    }

    fn head(&self) -> &Head {
        &self.0.page.head
    }

    fn row(&self, role: Role) -> &Row {
        &self.0.page.rows[role.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(word: &StopWord) -> std::path::PathBuf {
        format!("/proc/self/fd/{}", word.descriptor()).into()
    }

    #[test]
    fn a_stop_reaches_all_that_have_the_page_and_stays() {
        let word = StopWord::create("testrunaaa", 100).unwrap();
        let other = StopWord::open(&link(&word)).unwrap();
        assert!(word.is_armed() && other.is_armed() && other.stopped_ns() == 0);
        other.latch();
        let first_ns = word.stopped_ns();
        assert!(!word.is_armed() && first_ns > 0);
        word.latch();
        assert_eq!((word.is_armed(), other.stopped_ns(), other.period_ns()), (false, first_ns, 100));
    }

    #[test]
    fn any_value_but_the_armed_one_is_a_stop() {
        let word = StopWord::create("testrunbbb", 1).unwrap();
        for bit in 0..64 {
            word.head().word.store(ARMED ^ (1 << bit), Ordering::SeqCst);
            assert!(!word.is_armed(), "bit {bit}");
        }
    }

    #[test]
    fn the_page_is_found_by_its_name_and_cannot_be_cut() {
        let word = StopWord::create("testrunccc", 1).unwrap();
        let target = std::fs::read_link(link(&word)).unwrap();
        assert_eq!(StopWord::run_id_of_link(&target), Some("testrunccc"));
        assert_eq!(StopWord::run_id_of_link(Path::new("/memfd:other (deleted)")), None);
        let file = OpenOptions::new().write(true).open(link(&word)).unwrap();
        assert!(file.set_len(0).is_err() && file.set_len(1 << 20).is_err());
        assert!(StopWord::open(Path::new("/dev/null")).is_err());
    }

    #[test]
    fn only_what_was_started_by_the_orchestrator_is_listed() {
        let word = StopWord::create("testruneee", 1).unwrap();
        let own = std::process::id();
        assert_eq!(word.has_started(own), None, "nothing is listed");
        word.enlist(own);
        let other = StopWord::open(&link(&word)).unwrap();
        assert_eq!((other.has_started(own), other.has_started(1)), (Some(true), Some(false)));
        // Places of processes that have ended are used again.
        for _ in 0..=MAX_STARTED {
            let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
            word.enlist(child.id());
            let pid = child.id();
            child.kill().and_then(|()| child.wait()).unwrap();
            assert_eq!(word.has_started(pid), Some(true));
        }
        word.head().pid_namespace.store(1, Ordering::SeqCst);
        assert_eq!(other.has_started(own), None, "the numbers are those of another namespace");
        word.claim();
        word.head().pid_namespace.store(1, Ordering::SeqCst);
        assert_eq!(word.orchestrator().0, own, "it is found by its number there");
        word.head().orchestrator_ticks.store(1, Ordering::SeqCst);
        assert_eq!(word.orchestrator().0, 0, "another process has that number there");
    }

    #[test]
    fn a_stop_is_confirmed_by_what_the_wheels_do_since() {
        let word = StopWord::create("testrunddd", 1).unwrap();
        assert_eq!((word.wheels(Role::Robot).0, word.obeyed_by(Role::Robot)), (Wheels::Unknown, 0));
        word.report(Role::Robot, Wheels::Resting);
        let (wheels, seen_ns) = word.wheels(Role::Robot);
        assert!(wheels >= Wheels::Blocked && seen_ns <= monotonic_ns());
        assert_eq!(word.obeyed_by(Role::Robot), std::process::id());
        assert_eq!(word.orchestrator().0, std::process::id());
    }
}
