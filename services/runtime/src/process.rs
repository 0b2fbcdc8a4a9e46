//! One process of the loop: its ports, its barrier, its wait, its heartbeat.

use std::cell::{Cell, RefCell};
use std::os::fd::BorrowedFd;
use std::rc::Rc;
use std::sync::Arc;

use serde::de::DeserializeOwned;
use shared_types::{
    Checkpoint, Described, Directive, Heartbeat, Layouts, Phase, ProcessState, Role, Sample, StageStamps,
    Topic,
};

use crate::bell::{ANY, Bells, bit};
use crate::counters::{Counters, add_account, count};
use crate::ear::Ear;
use crate::handover::{self, Handover};
use crate::input::{Drain, Input};
use crate::orphan::{self, Janitor};
use crate::output::{Connect, Output, may_write};
use crate::settings::{self, RunSettings};
use crate::wake::wait_for;
use crate::{
    Bus, Clock, Domain, Observer, Realtime, RuntimeError, Shutdown, environment, layouts, monotonic_ns,
};

/// Time between two heartbeats: ten a second are enough to see a process live.
const HEARTBEAT_NS: u64 = 95_000_000;
/// A heartbeat that is due waits for this long at most for a moment in which nobody is kept from running by it.
const HEARTBEAT_PATIENCE_NS: u64 = 30_000_000;
/// Sleeps that are longer than this leave caches cold [ns].
const COLD_NS: u64 = 5_000_000;
/// How long nothing must have happened for that [ns].
const QUIET_NS: u64 = 2_000_000;
/// Longest sleep: what a lost wake-up costs at most when there is no other deadline.
pub(crate) const LONGEST_WAIT_NS: u64 = 100_000_000;
/// Inputs older than this many scan periods when they arrive are not used any more.
const MAX_AGE_PERIODS: u64 = 3;
/// The state of a running process is waited for this long, besides two and a half periods [ns].
const JOIN_NS: u64 = 20_000_000;
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
    /// Something was published since the last sleep.
    pub(crate) worked: Cell<bool>,
    pub(crate) taken_ns: Cell<u64>,
}

impl Shared {
    /// Notes that the process has begun to use a sample.
    pub(crate) fn taken<S: Sample>(&self, sample: &S) {
        self.clock.advance_to(sample.header().scan_published_ns());
        let now = self.clock.now_ns();
        self.taken_ns.set(now);
        let woken_ns = if self.clock.is_simulated() { now } else { self.stamps.get().woken_ns };
        self.stamps.set(StageStamps { woken_ns, taken_ns: now, ..StageStamps::default() });
        self.counters.take(self.role, sample);
    }
}

/// A process of the loop.
pub struct Process {
    domain: Domain,
    settings: toml::Table,
    run: RunSettings,
    realtime: Realtime,
    bus: Bus,
    bells: Arc<Bells>,
    shared: Rc<Shared>,
    shutdown: Shutdown,
    directive: Input<Directive>,
    heartbeat: Output<Heartbeat>,
    checkpoint: Option<Output<Checkpoint>>,
    inputs: Vec<Rc<dyn Drain>>,
    outputs: Vec<Rc<dyn Connect>>,
    handed_scan: Cell<u64>,
    state: ProcessState,
    next_heartbeat_ns: u64,
    directive_seen_ns: u64,
    looked_ns: u64,
    rung: u32,
    listens: bool,
    // Dropped last, when nothing of this process is on the bus any more.
    janitor: Janitor,
}

/// What a process sleeps for.
#[derive(Clone, Copy, PartialEq)]
enum Need {
    /// An input, whichever.
    Any,
    /// All inputs: one that does not complete them need not wake.
    All,
    /// A time, as exactly as the settings allow, or an input before it.
    Time,
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
        Self::enrol(role, domain, incarnation)
    }

    /// Joins a system as one incarnation of a role.
    pub(crate) fn enrol(role: Role, domain: Domain, incarnation: u32) -> Result<Self, RuntimeError> {
        let shutdown = Shutdown::on_signals()?;
        let settings = settings::read(&domain)?;
        let run: RunSettings = settings::table(&domain, &settings, "run")?;
        let realtime: Realtime = settings::table(&domain, &settings, "realtime")?;
        realtime.apply_timer_slack();
        let mut bus = Bus::open(&domain, role.name())?;
        // Opened for writing with the first checkpoint; until then the orchestrator may die.
        bus.hold::<Checkpoint>()?;
        let bells = Arc::clone(bus.bells());
        shutdown.ring_also(&bells, role)?;
        let shared = Rc::new(Shared {
            role,
            incarnation,
            clock: run.clock.clock(),
            counters: Counters::default(),
            stamps: Cell::default(),
            directive: RefCell::default(),
            max_age_ns: MAX_AGE_PERIODS * run.period_ns,
            produced: Cell::new(false),
            worked: Cell::new(false),
            taken_ns: Cell::new(0),
        });
        let directive = Input::new(&bus, Rc::clone(&shared))?;
        let heartbeat = Output::new(&bus, Rc::clone(&shared))?;
        Ok(Self {
            directive,
            heartbeat,
            checkpoint: None,
            inputs: Vec::new(),
            outputs: Vec::new(),
            handed_scan: Cell::new(0),
            state: ProcessState::Attached,
            next_heartbeat_ns: 0,
            directive_seen_ns: monotonic_ns(),
            looked_ns: 0,
            // Whatever was rung before is found by the first look.
            rung: bells.role(role).look().wrapping_sub(1),
            listens: false,
            realtime,
            bells,
            janitor: Janitor::new(&domain),
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

    /// Whether the outputs of this process count, now or from a scan on that was told; known from [`Process::start`] on.
    pub fn is_in_charge(&self) -> bool {
        self.directive().authority[self.shared.role.index()].incarnation == self.shared.incarnation
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

    /// The bus of this process.
    pub(crate) fn bus(&self) -> &Bus {
        &self.bus
    }

    /// Makes one more end of connections when the start barrier says so.
    pub(crate) fn connects(&mut self, end: Rc<dyn Connect>) {
        self.outputs.push(end);
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
            if !self.sleep(LONGEST_WAIT_NS, Need::Any)? {
                return Ok(false);
            }
            let phase = Phase::try_from(self.directive().phase).unwrap_or(Phase::Starting);
            if phase >= Phase::Connecting && self.state == ProcessState::Attached {
                self.outputs.iter().for_each(|output| output.connect());
                for input in &self.inputs {
                    input.drain()?;
                }
                self.realtime.apply_memory();
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
        self.wait_until(deadline_ns, Need::Any)
    }

    /// [`Process::wait`] for a process that [`crate::join`]s its inputs: while several are missing, only the one declared last
    /// wakes it, and then the next that is missing.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_joined(&mut self) -> Result<bool, RuntimeError> {
        self.wait_until(None, Need::All)
    }

    /// [`Process::wait`] for a process whose work begins at a time, not with an input: with `realtime.poll_us` it is
    /// awake before that time, so that it need not be woken.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait_for_time(&mut self, due_ns: u64) -> Result<bool, RuntimeError> {
        self.wait_until(Some(due_ns), Need::Time)
    }

    fn wait_until(&mut self, deadline_ns: Option<u64>, need: Need) -> Result<bool, RuntimeError> {
        if self.shared.produced.get() && self.state == ProcessState::Connected {
            self.enter(ProcessState::Ready)?;
        }
        let remaining = match deadline_ns {
            Some(deadline) if !self.shared.clock.is_simulated() => {
                deadline.saturating_sub(monotonic_ns()).min(LONGEST_WAIT_NS)
            }
            _ => LONGEST_WAIT_NS,
        };
        // Only the time itself is met exactly, not the end of a sleep before it.
        let need = if need == Need::Time && remaining == LONGEST_WAIT_NS { Need::Any } else { need };
        self.sleep(remaining, need)
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
        let Some(checkpoint) = handover::read(&self.domain, self.shared.role)? else {
            tracing::warn!("the process before this one left no state");
            return Ok(Handover::Lost);
        };
        // In lock-step the loop rests while a process starts, so its state does not age.
        let age_ns = monotonic_ns().saturating_sub(checkpoint.issued_ns);
        if age_ns > CHECKPOINT_AGE_NS && !self.shared.clock.is_simulated() {
            tracing::warn!("the state of the process before this one is {} ms old", age_ns / 1_000_000);
            return Ok(Handover::Lost);
        }
        self.handed_scan.set(checkpoint.header.scan_id);
        Ok(Handover::State(checkpoint))
    }

    /// The scan after which the state was taken that [`Process::resume`] has found; 0 without one.
    pub fn handed_scan(&self) -> u64 {
        self.handed_scan.get()
    }

    /// The newest state of the running process that this one was started beside, and the scan after which it was
    /// taken: to be called after [`Process::start`], because what was handed over at the start has aged since.
    ///
    /// `None` when this process was not started beside another, when that one publishes no state of this type
    /// for two and a half periods, and in lock-step, where the loop rests while a process starts.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn join<T: bytemuck::Pod + Described>(&mut self) -> Result<Option<(u64, T)>, RuntimeError> {
        let Some(beside) = environment::beside() else { return Ok(None) };
        if self.shared.clock.is_simulated() {
            return Ok(None);
        }
        let states = Observer::<Checkpoint>::new(&self.bus)?;
        let begun_ns = monotonic_ns();
        let until_ns = begun_ns + JOIN_NS + self.run.period_ns / 2 * 5;
        while monotonic_ns() < until_ns && self.sleep(self.run.period_ns / 20, Need::Any)? {
            let mut newest = None;
            states.poll(|checkpoint| {
                let is_fresh = checkpoint.header.incarnation == beside && checkpoint.issued_ns >= begun_ns;
                if is_fresh && checkpoint.role == self.shared.role.wire() {
                    newest = checkpoint.state().ok().map(|state| (checkpoint.header.scan_id, state));
                }
            })?;
            if newest.is_some() {
                return Ok(newest);
            }
        }
        Ok(None)
    }

    fn sleep(&mut self, longest_ns: u64, need: Need) -> Result<bool, RuntimeError> {
        let now = monotonic_ns();
        let beats = self.shared.counters.news.get() || now >= self.next_heartbeat_ns;
        // Who was just woken by an output may be waiting for this processor: words can wait until it is quiet.
        let rests =
            beats && self.shared.worked.take() && now < self.next_heartbeat_ns + HEARTBEAT_PATIENCE_NS;
        let (longest_ns, need) =
            if rests { (longest_ns.min(QUIET_NS), Need::Any) } else { (longest_ns, need) };
        let beats = beats && !rests;
        if beats {
            self.beat()?;
        }
        let timed_out = if self.listens {
            !self.sleep_on_events(longest_ns)
        } else {
            !self.sleep_and_warm_up(now, now + longest_ns, need)?
        };
        let woken_ns = self.shared.clock.now_ns();
        let counters = &self.shared.counters;
        count(&counters.activations, 1);
        count(&counters.timeouts, u64::from(timed_out));
        self.shared.stamps.set(StageStamps { woken_ns, ..StageStamps::default() });
        // Before anything is emptied: what comes later rings again.
        self.rung = self.bells.role(self.shared.role).look();
        self.listen_where_needed(beats);
        self.looked_ns = monotonic_ns();
        self.directive.drain()?;
        if let Some(directive) = self.directive.take_newest() {
            *self.shared.directive.borrow_mut() = *directive;
            self.directive_seen_ns = self.looked_ns;
            // Before anything newer is taken: what was kept aside comes first.
            self.inputs.iter().for_each(|input| input.review());
        }
        for input in &self.inputs {
            input.drain()?;
        }
        let alone_ns = self.looked_ns.saturating_sub(self.directive_seen_ns);
        let orphaned = alone_ns > orphan::limit_ns(self.shared.role, self.run.orphan_timeout_ns);
        if orphaned {
            tracing::error!("no orchestrator for {} s: ending", alone_ns / 1_000_000_000);
            self.janitor.is_orphaned();
        }
        let goes_on = !self.shutdown.requested() && !orphaned;
        if !goes_on {
            self.realtime.give_way();
        }
        Ok(goes_on)
    }

    /// [`Process::sleep_on_bell`], with one wake-up shortly before something is due.
    ///
    /// After a tenth of a second of sleep most of the time that a hop takes is spent on waiting for memory. Nothing is
    /// taken here: what comes meanwhile is taken in the usual order, after the directive.
    fn sleep_and_warm_up(&mut self, now: u64, until_ns: u64, need: Need) -> Result<bool, RuntimeError> {
        let due_ns = match need {
            Need::Time => until_ns,
            Need::Any | Need::All => self.shared.taken_ns.get() + self.run.period_ns,
        };
        let warm_up_ns = due_ns.saturating_sub(1000 * self.realtime.warm_up_us);
        let is_cold = warm_up_ns < due_ns && warm_up_ns > now + COLD_NS && warm_up_ns < until_ns;
        if !is_cold || self.shared.clock.is_simulated() {
            return Ok(self.sleep_on_bell(now, until_ns, need));
        }
        if self.bells.role(self.shared.role).sleep(self.rung, warm_up_ns, ANY) {
            return Ok(true);
        }
        let now = monotonic_ns();
        if now >= self.next_heartbeat_ns {
            self.beat()?;
        }
        self.inputs.iter().for_each(|input| input.warm_up());
        self.outputs.iter().for_each(|output| output.connect());
        Ok(self.sleep_on_bell(now, until_ns, need))
    }

    /// Sleeps on the doorbell; false after a time-out.
    fn sleep_on_bell(&self, now: u64, until_ns: u64, need: Need) -> bool {
        let bell = self.bells.role(self.shared.role);
        let poll_ns = if self.shared.clock.is_simulated() { 0 } else { 1000 * self.realtime.poll_us };
        if poll_ns == 0 {
            let bits = if need == Need::All { self.missing() } else { ANY };
            return bell.sleep(self.rung, until_ns, bits);
        }
        let (from_ns, to_ns) = match need {
            Need::Time => (until_ns.saturating_sub(poll_ns), until_ns),
            // The others are at work on what is missing.
            Need::All if self.inputs.iter().any(|input| !input.is_empty()) => (now, now + poll_ns),
            Need::All => (until_ns, until_ns),
            Need::Any => {
                let expected_ns = self.shared.taken_ns.get() + self.run.period_ns;
                (expected_ns.saturating_sub(poll_ns), expected_ns + poll_ns)
            }
        };
        let (from_ns, to_ns) = (from_ns.min(until_ns), to_ns.min(until_ns));
        if now < from_ns && bell.sleep(self.rung, from_ns, ANY) {
            return true;
        }
        while monotonic_ns() < to_ns {
            if bell.look() != self.rung {
                return true;
            }
            std::hint::spin_loop();
        }
        to_ns < until_ns && bell.sleep(self.rung, until_ns, ANY)
    }

    /// What a process that joins its inputs waits for: the last of those that are missing.
    fn missing(&self) -> u32 {
        let missing = self.inputs.iter().rev().find(|input| input.is_empty());
        missing.map_or(ANY, |input| bit(input.topic()) | bit(Topic::Directive))
    }

    /// Sleeps on the events of all topics, which writers of ours notify as well; false after a time-out.
    fn sleep_on_events(&self, longest_ns: u64) -> bool {
        if self.bells.role(self.shared.role).look() != self.rung {
            return true;
        }
        let mut descriptors: [BorrowedFd<'_>; 8] = std::array::from_fn(|_| self.shutdown.descriptor());
        let ears = self.inputs.iter().map(|input| input.ear()).chain([self.directive.ear()]);
        let mut used = 1;
        for (slot, descriptor) in descriptors[1..].iter_mut().zip(ears.filter_map(Ear::descriptor)) {
            *slot = descriptor;
            used += 1;
        }
        wait_for(&descriptors[..used], longest_ns)
    }

    /// Listens to events while a process that does not ring writes one of the topics read here. Called before topics
    /// are emptied, so what was published before is found, and what is published later is heard.
    fn listen_where_needed(&mut self, again: bool) {
        let mut needed = false;
        for input in &self.inputs {
            needed |= input.ear().is_needed(again);
        }
        if needed || self.listens {
            self.listens = needed;
            self.inputs.iter().for_each(|input| input.ear().listen(needed));
            self.directive.ear().listen(needed);
        }
    }

    /// Sleeps that lasted to their end.
    #[cfg(test)]
    pub(crate) fn timeouts(&self) -> u64 {
        self.shared.counters.timeouts.get()
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
            looked_ns: self.looked_ns,
            ..Heartbeat::default()
        };
        self.shared.counters.fill(&mut heartbeat);
        for input in &self.inputs {
            if let Some(port) = self.shared.role.reads().iter().position(|topic| *topic == input.topic()) {
                add_account(&mut heartbeat, port, input.account());
            }
        }
        heartbeat
    }

    fn beat(&mut self) -> Result<(), RuntimeError> {
        let mut heartbeat = self.heartbeat();
        self.next_heartbeat_ns = heartbeat.issued_ns + HEARTBEAT_NS;
        self.shared.counters.news.set(false);
        self.heartbeat.publish_silently(&mut heartbeat)
    }
}

impl Drop for Process {
    /// The last word says what became of the last samples; a process that is killed can't say it.
    fn drop(&mut self) {
        let _ = self.enter(ProcessState::Ending);
    }
}
