//! A page of shared memory between the orchestrator and the companions of a system.
//!
//! The orchestrator writes the phase, its last turn, and whose samples count. Each running companion writes a report of
//! its own. Nothing waits for anything here. A companion that writes nonsense into its report misleads the orchestrator
//! about itself alone; the loop does not read the page.
#![expect(unsafe_code, reason = "shared memory is mapped from a file")]

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use rustix::fs::OFlags;
use shared_types::{Authority, Phase, ProcessState, ROLES, Role};

use crate::reserve::allocate;
use crate::shared_memory::Mapped;
use crate::{Domain, RuntimeError};

/// Companions of one system, at most.
pub const MAX_COMPANIONS: usize = 64;
/// Name of the file in the directory of the bus, with the version of its layout.
const FILE: &str = "companions.v1";

/// Whose samples count, for one role or companion.
#[repr(C)]
struct Right {
    incarnation: AtomicU32,
    previous: AtomicU32,
    from_scan: AtomicU64,
    /// The report of the process in charge.
    report: AtomicU32,
    /// 1 while lock-step waits for the companion.
    holds: AtomicU32,
    reserved: AtomicU64,
}

/// What one running companion reports.
#[repr(C, align(64))]
struct Cell {
    incarnation: AtomicU32,
    state: AtomicU32,
    pid: AtomicU64,
    activations: AtomicU64,
    taken: AtomicU64,
    answered: AtomicU64,
    answered_scan: AtomicU64,
    published: AtomicU64,
    published_ns: AtomicU64,
    invalid: AtomicU64,
    foreign: AtomicU64,
    missed: AtomicU64,
}

#[repr(C)]
struct Page {
    phase: AtomicU32,
    reserved: AtomicU32,
    beat_ns: AtomicU64,
    rest: [AtomicU64; 6],
    roles: [Right; ROLES],
    companions: [Right; MAX_COMPANIONS],
    /// Two for each companion: its process and the one that takes over.
    reports: [Cell; 2 * MAX_COMPANIONS],
}

const _: () = assert!(size_of::<Right>() == 32 && size_of::<Cell>() == 128);
const _: () =
    assert!(std::mem::offset_of!(Page, roles) == 64 && std::mem::offset_of!(Page, companions) == 224);
const _: () = assert!(std::mem::offset_of!(Page, reports) == 2304);

/// The page of one system.
#[derive(Debug, Clone)]
pub struct CompanionPage(Arc<Mapped<Page>>);

/// What a companion reports about itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CompanionSelfReport {
    /// Its incarnation; 0 when no process has reported.
    pub incarnation: u32,
    /// `ProcessState`.
    pub state: u32,
    /// Its process id.
    pub pid: u64,
    /// Passes through its loop.
    pub activations: u64,
    /// Samples taken of the first topic that it reads.
    pub taken: u64,
    /// Of these, those that it is done with.
    pub answered: u64,
    /// Scan of the newest of them.
    pub answered_scan: u64,
    /// Samples published.
    pub published: u64,
    /// When the newest one was published [ns of CLOCK_MONOTONIC].
    pub published_ns: u64,
    /// Inputs dropped because of their content.
    pub invalid: u64,
    /// Inputs dropped because their writer was not in charge.
    pub foreign: u64,
    /// Sequence numbers of its inputs that never arrived.
    pub missed: u64,
}

impl CompanionPage {
    /// Creates the page of a system, or opens the one that another orchestrator left.
    ///
    /// # Errors
    /// [`RuntimeError::File`] and [`RuntimeError::SharedMemory`].
    pub fn create(domain: &Domain) -> Result<Self, RuntimeError> {
        // SAFETY: atomics only.
        unsafe { create_file(domain, FILE) }.map(|page| Self(Arc::new(page)))
    }

    /// Opens the page of a running system.
    ///
    /// # Errors
    /// [`RuntimeError::File`].
    pub fn open(domain: &Domain) -> Result<Self, RuntimeError> {
        // SAFETY: as above.
        unsafe { open_file(domain, FILE) }.map(|page| Self(Arc::new(page)))
    }

    /// The orchestrator has taken a turn at `now_ns`, in that phase.
    pub fn beat(&self, now_ns: u64, phase: u32) {
        self.0.phase.store(phase, Ordering::SeqCst);
        self.0.beat_ns.store(now_ns, Ordering::SeqCst);
    }

    /// Whose samples count for a role.
    pub fn set_role(&self, role: Role, authority: &Authority) {
        self.0.roles[role.index()].set(authority);
    }

    /// Whose samples count for a companion, which report is that of the process in charge, and whether lock-step waits
    /// for it.
    pub fn set_companion(&self, index: usize, authority: &Authority, report: usize, holds: bool) {
        let right = &self.0.companions[index];
        right.report.store(report as u32, Ordering::SeqCst);
        right.holds.store(u32::from(holds), Ordering::SeqCst);
        right.set(authority);
    }

    /// Clears a report for a process that is about to start.
    pub fn clear_report(&self, report: usize) {
        let cell = &self.0.reports[report];
        cell.incarnation.store(0, Ordering::SeqCst);
        cell.state.store(0, Ordering::SeqCst);
        for number in cell.numbers() {
            number.store(0, Ordering::SeqCst);
        }
    }

    /// The report with that number.
    pub fn report(&self, report: usize) -> CompanionSelfReport {
        let cell = &self.0.reports[report];
        let read = |number: &AtomicU64| number.load(Ordering::SeqCst);
        CompanionSelfReport {
            incarnation: cell.incarnation.load(Ordering::SeqCst),
            state: cell.state.load(Ordering::SeqCst),
            pid: read(&cell.pid),
            activations: read(&cell.activations),
            taken: read(&cell.taken),
            answered: read(&cell.answered),
            answered_scan: read(&cell.answered_scan),
            published: read(&cell.published),
            published_ns: read(&cell.published_ns),
            invalid: read(&cell.invalid),
            foreign: read(&cell.foreign),
            missed: read(&cell.missed),
        }
    }

    /// Writes the report of a process; its scan is written last, because lock-step waits for it.
    pub(crate) fn write_report(&self, report: usize, content: &CompanionSelfReport) {
        let cell = &self.0.reports[report];
        let numbers = [
            content.pid,
            content.activations,
            content.taken,
            content.answered,
            content.published,
            content.published_ns,
            content.invalid,
            content.foreign,
            content.missed,
            content.answered_scan,
        ];
        cell.incarnation.store(content.incarnation, Ordering::SeqCst);
        cell.state.store(content.state, Ordering::SeqCst);
        for (place, number) in cell.numbers().into_iter().zip(numbers) {
            place.store(number, Ordering::SeqCst);
        }
    }

    /// The phase of the system.
    pub(crate) fn phase(&self) -> Phase {
        Phase::try_from(self.0.phase.load(Ordering::SeqCst)).unwrap_or(Phase::Starting)
    }

    /// When the orchestrator took its last turn [ns].
    pub(crate) fn beat_ns(&self) -> u64 {
        self.0.beat_ns.load(Ordering::SeqCst)
    }

    /// Whose samples count for a role.
    pub(crate) fn role(&self, role: Role) -> Authority {
        self.0.roles[role.index()].authority()
    }

    /// Whose samples count for a companion.
    pub(crate) fn companion(&self, index: usize) -> Authority {
        self.0.companions[index].authority()
    }

    /// Whether lock-step waits for a companion, and the newest scan that it is done with.
    pub(crate) fn progress(&self, index: usize) -> (bool, u64) {
        let right = &self.0.companions[index];
        let report = right.report.load(Ordering::SeqCst) as usize;
        let scan = self.0.reports.get(report).map_or(0, |cell| cell.answered_scan.load(Ordering::SeqCst));
        (right.holds.load(Ordering::SeqCst) == 1, scan)
    }
}

/// Creates a file of shared memory for all processes of a system, or opens the one that another orchestrator left.
///
/// # Safety
/// `P` consists of atomics only, for which any bytes are valid.
pub(super) unsafe fn create_file<P>(domain: &Domain, name: &str) -> Result<Mapped<P>, RuntimeError> {
    let folder = domain.bus_folder()?;
    let error = |source| RuntimeError::file(folder.path().join(name), source);
    let file = folder.open_file(name, OFlags::RDWR | OFlags::CREATE).map_err(error)?;
    let length = size_of::<P>() as u64;
    allocate(&file, length, length)?;
    // Where the file system can't allocate, the file is still empty.
    if file.metadata().map_err(error)?.len() < length {
        file.set_len(length).map_err(error)?;
    }
    // SAFETY: the file is as large as the page, and it is never made smaller; the caller guarantees the rest.
    unsafe { Mapped::new(&file) }.map_err(error)
}

/// Opens such a file.
///
/// # Safety
/// As for [`create_file`].
pub(super) unsafe fn open_file<P>(domain: &Domain, name: &str) -> Result<Mapped<P>, RuntimeError> {
    let folder = domain.bus_folder()?;
    let error = |source| RuntimeError::file(folder.path().join(name), source);
    let file = folder.open_file(name, OFlags::RDWR).map_err(error)?;
    if file.metadata().map_err(error)?.len() < size_of::<P>() as u64 {
        return Err(error(std::io::Error::other("the page is not finished")));
    }
    // SAFETY: as in `create_file`.
    unsafe { Mapped::new(&file) }.map_err(error)
}

impl Right {
    /// Readers may see any of the three values earlier than the others: each order gives a right that was or will be.
    fn set(&self, authority: &Authority) {
        self.previous.store(authority.previous, Ordering::SeqCst);
        self.from_scan.store(authority.from_scan, Ordering::SeqCst);
        self.incarnation.store(authority.incarnation, Ordering::SeqCst);
    }

    fn authority(&self) -> Authority {
        Authority {
            incarnation: self.incarnation.load(Ordering::SeqCst),
            previous: self.previous.load(Ordering::SeqCst),
            from_scan: self.from_scan.load(Ordering::SeqCst),
        }
    }
}

impl Cell {
    fn numbers(&self) -> [&AtomicU64; 10] {
        [
            &self.pid,
            &self.activations,
            &self.taken,
            &self.answered,
            &self.published,
            &self.published_ns,
            &self.invalid,
            &self.foreign,
            &self.missed,
            &self.answered_scan,
        ]
    }
}

impl CompanionSelfReport {
    /// The state that it reports.
    pub fn state(&self) -> Option<ProcessState> {
        (self.incarnation != 0).then(|| ProcessState::try_from(self.state).ok()).flatten()
    }
}
