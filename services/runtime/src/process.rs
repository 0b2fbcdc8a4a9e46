//! One process of the loop: its ports, its barrier, its wait, its heartbeat.

use std::cell::{Cell, RefCell};
use std::os::fd::BorrowedFd;
use std::rc::Rc;

use serde::de::DeserializeOwned;
use shared_types::{
    Checkpoint, Described, Directive, Heartbeat, Layouts, Phase, ProcessState, Role, Sample, StageStamps,
};

use crate::counters::{Counters, count};
use crate::handover::{self, Handover};
use crate::input::{Drain, Input};
use crate::output::{Connect, Output, may_write};
use crate::settings::{self, RunSettings};
use crate::wake::{borrow, wait_for};
use crate::{Bus, Clock, Domain, RuntimeError, Shutdown, environment, layouts, monotonic_ns};

/// Time between two heartbeats: ten a second are enough to see a process live.
const HEARTBEAT_NS: u64 = 95_000_000;
/// Longest sleep: what a lost wake-up costs at most when there is no other deadline.
const LONGEST_WAIT_NS: u64 = 100_000_000;
/// Inputs older than this many scan periods when they arrive are not used any more.
const MAX_AGE_PERIODS: u64 = 3;
/// A checkpoint older than this describes another situation [ns].
const CHECKPOINT_AGE_NS: u64 = 500_000_000;

/// What ports of one process share.
pub(crate) struct Shared {
    pub(crate) role: Role,
    pub(crate) incarnation: u32,
    pub(crate) clock: Clock,
    pub(crate) counters: Counters,
    pub(crate) stamps: Cell<StageStamps>,
    pub(crate) directive: RefCell<Directive>,
    pub(crate) max_age_ns: u64,
    pub(crate) produced: Cell<bool>,
}

impl Shared {
    /// Notes that the process has begun to use a sample.
    pub(crate) fn taken<S: Sample>(&self, sample: &S) {
        self.clock.advance_to(sample.header().scan_published_ns());
        let now = self.clock.now_ns();
        let woken_ns = if self.clock.is_simulated() { now } else { self.stamps.get().woken_ns };
        self.stamps.set(StageStamps { woken_ns, taken_ns: now, ..StageStamps::default() });
        count(&self.counters.used, 1);
    }
}

/// A process of the loop.
pub struct Process {
    domain: Domain,
    settings: toml::Table,
    run: RunSettings,
    bus: Bus,
    shared: Rc<Shared>,
    shutdown: Shutdown,
    directive: Input<Directive>,
    heartbeat: Output<Heartbeat>,
    checkpoint: Option<Output<Checkpoint>>,
    inputs: Vec<Rc<dyn Drain>>,
    outputs: Vec<Rc<dyn Connect>>,
    state: ProcessState,
    next_heartbeat_ns: u64,
    directive_seen_ns: u64,
}

impl Process {
    /// Joins the system that started this process, as `role`.
    ///
    /// # Errors
    /// [`RuntimeError::NotInASystem`] when the process was started by hand, [`RuntimeError::Layout`] when it was built
    /// against other samples than the system, and errors of the bus.
    pub fn attach(role: Role) -> Result<Self, RuntimeError> {
        let (system_id, incarnation) = environment::identity()?;
        let domain = Domain::new(&system_id)?;
        layouts::verify(&domain, role, &Layouts::built_in())?;
        let shutdown = Shutdown::on_signals()?;
        let settings = settings::read(&domain)?;
        let run: RunSettings = settings::table(&domain, &settings, "run")?;
        let bus = Bus::open(&domain, role.name())?;
        let shared = Rc::new(Shared {
            role,
            incarnation,
            clock: run.clock.clock(),
            counters: Counters::default(),
            stamps: Cell::default(),
            directive: RefCell::default(),
            max_age_ns: MAX_AGE_PERIODS * run.period_ns,
            produced: Cell::new(false),
        });
        let directive = Input::new(&bus, Rc::clone(&shared))?;
        let heartbeat = Output::new(&bus, Rc::clone(&shared))?;
        Ok(Self {
            directive,
            heartbeat,
            checkpoint: None,
            inputs: Vec::new(),
            outputs: Vec::new(),
            state: ProcessState::Attached,
            next_heartbeat_ns: 0,
            directive_seen_ns: monotonic_ns(),
            domain,
            settings,
            run,
            bus,
            shared,
            shutdown,
        })
    }

    /// The settings of this role: the table `name` of the checked settings of the system.
    ///
    /// # Errors
    /// [`RuntimeError::Settings`] with the key that does not fit.
    pub fn settings<T: DeserializeOwned>(&self, name: &str) -> Result<T, RuntimeError> {
        settings::table(&self.domain, &self.settings, name)
    }

    /// Scan period [ns].
    pub fn period_ns(&self) -> u64 {
        self.run.period_ns
    }

    /// The clock of the loop.
    pub fn clock(&self) -> &Clock {
        &self.shared.clock
    }

    /// The newest word of the orchestrator.
    pub fn directive(&self) -> Directive {
        *self.shared.directive.borrow()
    }

    /// Opens a topic for reading; samples arrive from [`Process::start`] on.
    ///
    /// # Errors
    /// [`RuntimeError::NotYourTopic`] when the role does not read it, and errors of the bus.
    pub fn input<S: Sample>(&mut self) -> Result<Input<S>, RuntimeError> {
        let role = self.shared.role;
        if !role.reads().contains(&S::TOPIC) {
            return Err(RuntimeError::NotYourTopic { role, verb: "read", topic: S::TOPIC });
        }
        let input = Input::new(&self.bus, Rc::clone(&self.shared))?;
        self.inputs.push(Rc::new(input.clone()));
        Ok(input)
    }

    /// Opens a topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::NotYourTopic`] when another role writes it, and errors of the bus.
    pub fn output<S: Sample>(&mut self) -> Result<Rc<Output<S>>, RuntimeError> {
        let role = self.shared.role;
        if !may_write(role, S::TOPIC) {
            return Err(RuntimeError::NotYourTopic { role, verb: "write", topic: S::TOPIC });
        }
        let output = Rc::new(Output::new(&self.bus, Rc::clone(&self.shared))?);
        self.outputs.push(Rc::clone(&output) as Rc<dyn Connect>);
        Ok(output)
    }

    /// Waits until all processes have opened their ports and all connections are made; false when asked to end.
    ///
    /// Without this barrier the first samples would be lost silently, because a publisher can't fill a
    /// connection whose reader has not made its half.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn start(&mut self) -> Result<bool, RuntimeError> {
        self.beat()?;
        loop {
            if !self.sleep(LONGEST_WAIT_NS)? {
                return Ok(false);
            }
            let phase = Phase::try_from(self.directive().phase).unwrap_or(Phase::Starting);
            if phase >= Phase::Connecting && self.state == ProcessState::Attached {
                self.outputs.iter().for_each(|output| output.connect());
                for input in &self.inputs {
                    input.drain()?;
                }
                self.enter(ProcessState::Connected)?;
            }
            if phase >= Phase::Driving {
                return Ok(true);
            }
        }
    }

    /// Sleeps until an input has something, the deadline of the clock has passed, or a tenth of a second has;
    /// then takes what has come. False when the process is to end.
    ///
    /// Simulated time has no deadlines: it only moves with samples.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait(&mut self, deadline_ns: Option<u64>) -> Result<bool, RuntimeError> {
        if self.shared.produced.get() && self.state == ProcessState::Connected {
            self.enter(ProcessState::Ready)?;
        }
        let remaining = match deadline_ns {
            Some(deadline) if !self.shared.clock.is_simulated() => {
                deadline.saturating_sub(monotonic_ns()).min(LONGEST_WAIT_NS)
            }
            _ => LONGEST_WAIT_NS,
        };
        self.sleep(remaining)
    }

    /// Notes that work begins without an input: for the robot, whose scans start the chain.
    pub fn begin(&self) {
        let now = self.shared.clock.now_ns();
        self.shared.stamps.set(StageStamps { woken_ns: now, taken_ns: now, ..StageStamps::default() });
    }

    /// Publishes the state of this process after a scan, for the one that may have to go on from it.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save<T: bytemuck::Pod + Described>(
        &mut self,
        header: &shared_types::Header,
        state: &T,
    ) -> Result<(), RuntimeError> {
        self.save_checkpoint(header, Checkpoint::of(self.shared.role, state))
    }

    /// [`Process::save`] of a state that is bytes already.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn save_checkpoint(
        &mut self,
        header: &shared_types::Header,
        mut checkpoint: Checkpoint,
    ) -> Result<(), RuntimeError> {
        if self.checkpoint.is_none() {
            self.checkpoint = Some(Output::new(&self.bus, Rc::clone(&self.shared))?);
        }
        let Some(output) = &self.checkpoint else { return Ok(()) };
        checkpoint.header = header.answer();
        checkpoint.issued_ns = monotonic_ns();
        output.publish_silently(&mut checkpoint)
    }

    /// The state that the process before this one left less than half a second ago.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the hand-over can't be read.
    pub fn resume<T: bytemuck::Pod + Described>(&self) -> Result<Handover<T>, RuntimeError> {
        Ok(match self.resume_checkpoint()? {
            Handover::FirstStart => Handover::FirstStart,
            Handover::Lost => Handover::Lost,
            Handover::State(checkpoint) => checkpoint.state().map(Handover::State).unwrap_or_else(|error| {
                tracing::warn!(%error, "the state of the process before this one can't be used");
                Handover::Lost
            }),
        })
    }

    /// [`Process::resume`] without a look at what the state is.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when the hand-over can't be read.
    pub fn resume_checkpoint(&self) -> Result<Handover<Checkpoint>, RuntimeError> {
        if !environment::is_restart() {
            return Ok(Handover::FirstStart);
        }
        let checkpoint = handover::read(&self.domain, self.shared.role)?;
        let age_ns = |checkpoint: &Checkpoint| monotonic_ns().saturating_sub(checkpoint.issued_ns);
        let fresh = checkpoint.filter(|checkpoint| age_ns(checkpoint) <= CHECKPOINT_AGE_NS);
        Ok(fresh.map_or(Handover::Lost, Handover::State))
    }

    fn sleep(&mut self, longest_ns: u64) -> Result<bool, RuntimeError> {
        let now = monotonic_ns();
        if now >= self.next_heartbeat_ns {
            self.beat()?;
        }
        let mut descriptors: [BorrowedFd<'_>; 8] = std::array::from_fn(|_| self.shutdown.descriptor());
        descriptors[1] = borrow(self.directive.descriptor());
        let mut used = 2;
        for (slot, input) in descriptors[2..].iter_mut().zip(&self.inputs) {
            *slot = borrow(input.descriptor());
            used += 1;
        }
        let timed_out = !wait_for(&descriptors[..used], longest_ns);
        let woken_ns = self.shared.clock.now_ns();
        let counters = &self.shared.counters;
        count(&counters.activations, 1);
        count(&counters.timeouts, u64::from(timed_out));
        self.shared.stamps.set(StageStamps { woken_ns, ..StageStamps::default() });
        self.directive.drain()?;
        if let Some(directive) = self.directive.take_newest() {
            *self.shared.directive.borrow_mut() = *directive;
            self.directive_seen_ns = monotonic_ns();
            // Before anything newer is taken: what was kept aside comes first.
            self.inputs.iter().for_each(|input| input.review());
        }
        for input in &self.inputs {
            input.drain()?;
        }
        let orphaned = monotonic_ns().saturating_sub(self.directive_seen_ns) > self.run.orphan_timeout_ns;
        if orphaned {
            tracing::error!("no orchestrator for {} s: ending", self.run.orphan_timeout_ns / 1_000_000_000);
        }
        Ok(!self.shutdown.requested() && !orphaned)
    }

    fn enter(&mut self, state: ProcessState) -> Result<(), RuntimeError> {
        self.state = state;
        self.beat()
    }

    /// What the next heartbeat will say: state and counters of this process.
    pub fn heartbeat(&self) -> Heartbeat {
        let mut heartbeat = Heartbeat {
            role: self.shared.role.wire(),
            state: self.state.wire(),
            pid: u64::from(std::process::id()),
            issued_ns: monotonic_ns(),
            ..Heartbeat::default()
        };
        self.shared.counters.fill(&mut heartbeat);
        heartbeat
    }

    fn beat(&mut self) -> Result<(), RuntimeError> {
        let mut heartbeat = self.heartbeat();
        self.next_heartbeat_ns = heartbeat.issued_ns + HEARTBEAT_NS;
        self.heartbeat.publish_silently(&mut heartbeat)
    }
}
