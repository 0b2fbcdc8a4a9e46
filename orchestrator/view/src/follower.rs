//! A running system, followed from outside: observers of its topics, and its status.
//!
//! The system may not run yet, may end, and may start again: then its run id is another one, and all is opened anew. A
//! death of the orchestrator or of a process changes nothing here.

use runtime::{Bus, Domain, Observer, RuntimeError, monotonic_ns};
use session::control::SystemStatus;
use shared_types::{Actuation, Command, Directive, Obstacles, Pose, Sample, Scan, Truth};

use crate::statuses::{Known, Statuses};

/// Time between two tries to open the bus, and between two checks that the run is still there [ns].
const RETRY_NS: u64 = 250_000_000;

/// What a follower hands on. Samples of processes that are not in charge are left out.
#[derive(Debug, Clone, Copy)]
pub enum News<'a> {
    /// A run was found.
    Found(&'a Domain),
    /// The run has ended.
    Gone,
    /// An answer to the question for the status.
    Status(&'a SystemStatus),
    /// What the orchestrator tells all processes.
    Directive(&'a Directive),
    /// A scan.
    Scan(&'a Scan),
    /// A pose.
    Pose(&'a Pose),
    /// What the scanner sees.
    Obstacles(&'a Obstacles),
    /// A command of the controller.
    Command(&'a Command),
    /// What only the emulated robot knows.
    Truth(&'a Truth),
    /// What the wheels do; it comes after the samples that it answers.
    Actuation(&'a Actuation),
}

/// Follows the system of one id, whenever there is one.
pub struct Follower {
    statuses: Statuses,
    known: Known,
    /// The run that was found, until its end was told: its bus may fail before.
    found: Option<Domain>,
    attached: Option<Attached>,
    answers: u64,
    next_try_ns: u64,
}

impl Follower {
    /// Waits for a system of that id.
    ///
    /// # Errors
    /// A thread that can't be started.
    pub fn start(system_id: &str) -> anyhow::Result<Self> {
        Ok(Self {
            statuses: Statuses::start(system_id)?,
            known: Known::default(),
            found: None,
            attached: None,
            answers: 0,
            next_try_ns: 0,
        })
    }

    /// Hands all that has come to `each`. Call it before a queue of 16 samples is full.
    pub fn poll(&mut self, mut each: impl FnMut(News<'_>)) {
        self.known = self.statuses.known();
        self.reopen(&mut each);
        let Some(attached) = &mut self.attached else { return };
        if let Some(status) = self.known.status.as_ref().filter(|_| self.known.answers != self.answers) {
            self.answers = self.known.answers;
            each(News::Status(status));
        }
        if attached.receive(&mut each).is_err() {
            self.attached = None;
        }
    }

    /// The run that is followed.
    pub fn domain(&self) -> Option<&Domain> {
        self.attached.as_ref().map(|attached| &attached.domain)
    }

    /// The last answer of the run to the question for its status.
    pub fn status(&self) -> Option<&SystemStatus> {
        self.known.status.as_ref().filter(|_| self.attached.is_some())
    }

    /// Why the last question for the status had no answer.
    pub fn trouble(&self) -> Option<&str> {
        self.known.trouble.as_deref().filter(|_| self.attached.is_some())
    }

    /// For how long there was no answer [s]; `None` before the first one.
    pub fn silent_s(&self) -> Option<f64> {
        self.status().map(|_| monotonic_ns().saturating_sub(self.known.answered_ns) as f64 * 1e-9)
    }

    /// Opens the bus of a new run, and closes that of one that is over.
    fn reopen(&mut self, each: &mut impl FnMut(News<'_>)) {
        let now_ns = monotonic_ns();
        if now_ns < self.next_try_ns {
            return;
        }
        self.next_try_ns = now_ns + RETRY_NS;
        if self.found.as_ref().is_some_and(|domain| !domain.is_current()) {
            (self.found, self.attached) = (None, None);
            each(News::Gone);
        }
        let Some(domain) = self.known.domain.as_ref().filter(|_| self.attached.is_none()) else { return };
        // A run that starts has not created its topics yet: the next try finds them.
        if let Ok(attached) = Attached::open(domain) {
            (self.found, self.attached) = (Some(domain.clone()), Some(attached));
            each(News::Found(domain));
        }
    }
}

/// The observers of one run.
struct Attached {
    domain: Domain,
    directive: Directive,
    directives: Observer<Directive>,
    scans: Observer<Scan>,
    poses: Observer<Pose>,
    obstacles: Observer<Obstacles>,
    commands: Observer<Command>,
    truths: Observer<Truth>,
    actuations: Observer<Actuation>,
    /// Dropped after its observers.
    _bus: Bus,
}

impl Attached {
    fn open(domain: &Domain) -> Result<Self, RuntimeError> {
        let bus = Bus::open(domain, "view")?;
        Ok(Self {
            domain: domain.clone(),
            directive: Directive::default(),
            directives: Observer::new(&bus)?,
            scans: Observer::new(&bus)?,
            poses: Observer::new(&bus)?,
            obstacles: Observer::new(&bus)?,
            commands: Observer::new(&bus)?,
            truths: Observer::new(&bus)?,
            actuations: Observer::new(&bus)?,
            _bus: bus,
        })
    }

    fn receive(&mut self, each: &mut impl FnMut(News<'_>)) -> Result<(), RuntimeError> {
        self.directives.poll(|new| {
            self.directive = *new;
            each(News::Directive(new));
        })?;
        let directive = &self.directive;
        hand_on(&self.scans, directive, |new| each(News::Scan(new)))?;
        hand_on(&self.poses, directive, |new| each(News::Pose(new)))?;
        hand_on(&self.obstacles, directive, |new| each(News::Obstacles(new)))?;
        hand_on(&self.commands, directive, |new| each(News::Command(new)))?;
        hand_on(&self.truths, directive, |new| each(News::Truth(new)))?;
        hand_on(&self.actuations, directive, |new| each(News::Actuation(new)))
    }
}

/// Hands on the samples of the process in charge.
fn hand_on<S: Sample>(
    observer: &Observer<S>,
    directive: &Directive,
    mut each: impl FnMut(&S),
) -> Result<(), RuntimeError> {
    observer.poll(|new| {
        if directive.counts(S::TOPIC, new.header()) {
            each(new);
        }
    })?;
    Ok(())
}
