//! One process of the loop: its ports, its barrier, its heartbeat.

mod state;
mod waiting;

use std::cell::{Cell, RefCell};
use std::fmt::Display;
use std::rc::Rc;
use std::sync::Arc;

use bytemuck::Pod;
use iceoryx2::prelude::{Node, ipc};
use serde::de::DeserializeOwned;
use shared_types::{
    Actuation, Checkpoint, Described, Device, DeviceState, Directive, Header, Heartbeat, Journal,
    JournalKind, KnownScan, LayoutRow, Layouts, Phase, ProcessState, Role, Sample, SampleType, StageStamps,
    Topic,
};

use self::waiting::Need;
use crate::alarm::Alarm;
use crate::bell::{Bells, bit};
use crate::counters::{Counters, add_input};
use crate::crash::report_crashes;
use crate::enclosed::Enclosed;
use crate::guard::Guard;
use crate::input::{Input, Reader};
use crate::journal::{Notes, Publish};
use crate::orphan::OrphanCleanup;
use crate::output::{Connect, Output, Writer, may_write};
use crate::own::{ByteTopic, Member, NamedTopic, OwnFields, OwnTopics, Place};
use crate::reserve::require_room_of;
use crate::settings::{self, RunSettings};
use crate::shared::Shared;
use crate::silence::Silence;
use crate::{
    Bus, Clock, Domain, Realtime, RuntimeError, Shutdown, StopWord, Wheels, domain, layouts, monotonic_ns,
    tamper,
};

/// Time between two heartbeats: ten a second are enough to see a process live.
const HEARTBEAT_NS: u64 = 95_000_000;
/// Longest sleep [ns]: the most that a lost wake-up costs when there is no other deadline.
pub(crate) const MAX_WAIT_NS: u64 = 100_000_000;
/// How long a candidate waits for the state of the running process, on top of two and a half periods [ns].
const JOIN_NS: u64 = 20_000_000;
/// A checkpoint that was older than this when its process ended is not used [ns].
const CHECKPOINT_AGE_NS: u64 = 500_000_000;
/// Nor is one that has waited longer than this for a successor: twice the longest pause before a restart [ns].
const HANDOVER_AGE_NS: u64 = 10_000_000_000;

/// A process of the loop.
pub struct Process {
    domain: Domain,
    settings: toml::Table,
    run: RunSettings,
    realtime: Realtime,
    /// Until when this process does not poll, because it shares its processor [ns].
    crowded_until_ns: Cell<u64>,
    /// Until when the stage does not prepare, because it took too long [ns].
    unprepared_until_ns: u64,
    bus: Bus,
    bells: Arc<Bells>,
    shared: Rc<Shared>,
    shutdown: Shutdown,
    directive: Input<Directive>,
    heartbeat: Output<Heartbeat>,
    checkpoint: Output<Checkpoint>,
    inputs: Vec<Enclosed<Rc<Reader>>>,
    outputs: Vec<Rc<dyn Connect>>,
    handed_scan: Cell<u64>,
    /// Newest actuations sent before this process was started, and by how much their times were moved [ns].
    handed_actuations: RefCell<(Vec<Actuation>, i64)>,
    state: ProcessState,
    next_heartbeat_ns: u64,
    directive_seen_ns: u64,
    silence: Silence,
    polled_ns: u64,
    rung: u32,
    /// Start of the work that [`Process::wait_for_time`] waits for.
    due_ns: u64,
    alarm: Alarm,
    /// Bits of all topics that wake this process.
    topics: u32,
    listens: bool,
    // Dropped last, when this process has left the bus.
    cleanup: OrphanCleanup,
}

impl Process {
    /// Joins the system that started this process, as `role`.
    ///
    /// # Errors
    /// [`RuntimeError::NotInASystem`] when the process was started by hand, [`RuntimeError::Layout`] when it was built
    /// against other samples than the system, and errors of the bus.
    pub fn attach(role: Role) -> Result<Self, RuntimeError> {
        report_crashes();
        let (_, incarnation) = domain::identity()?;
        let domain = Domain::of_this_process()?;
        layouts::verify(&domain, role, &Layouts::built_in())?;
        Self::attach_as(role, domain, incarnation)
    }

    /// [`Process::attach`] to a given system as a given incarnation.
    pub(crate) fn attach_as(role: Role, domain: Domain, incarnation: u32) -> Result<Self, RuntimeError> {
        let shutdown = Shutdown::on_signals()?;
        let settings = settings::read(&domain, role, incarnation)?;
        let run: RunSettings = settings::table(&domain, role, &settings, "run")?;
        let realtime: Realtime = settings::table(&domain, role, &settings, "realtime")?;
        realtime.apply_timer_slack();
        require_room_of(role, run.period_ns)?;
        let bus = Bus::open(&domain, role.name())?;
        let bells = Arc::clone(bus.bells());
        shutdown.ring_also(&bells, role)?;
        let word = StopWord::inherited().unwrap_or_else(|error| {
            tracing::warn!(%error, "this process will not see the stop word, and is ended when the run is stopped");
            None
        });
        let shared = Rc::new(Shared {
            role,
            incarnation,
            guard: Guard::new(role, word),
            notes: Notes::default(),
            tamper: RefCell::new(tamper::take()),
            device: RefCell::new(Device::default()),
            clock: run.clock.clock(),
            counters: Counters::default(),
            stamps: Cell::default(),
            directive: RefCell::default(),
            period_ns: run.period_ns,
            produced: Cell::new(false),
            worked: Cell::new(false),
            expected_ns: Cell::new(0),
            acquired_ns: Cell::new(0),
            known_scan: Cell::default(),
            answered_in_ns: Cell::new([0; 2]),
        });
        let directive = Input::new(&bus, Rc::clone(&shared))?;
        let heartbeat = Output::new(&bus, Rc::clone(&shared))?;
        let checkpoint = Output::new(&bus, Rc::clone(&shared))?;
        let journal = Rc::new(Writer::new(&bus, Rc::clone(&shared), Journal::TYPE)?);
        shared.notes.publish_by(role, &(Rc::clone(&journal) as Rc<dyn Publish>));
        Ok(Self {
            directive,
            heartbeat,
            checkpoint,
            inputs: Vec::new(),
            outputs: vec![journal as Rc<dyn Connect>],
            handed_scan: Cell::new(0),
            handed_actuations: RefCell::default(),
            state: ProcessState::Attached,
            next_heartbeat_ns: 0,
            directive_seen_ns: monotonic_ns(),
            silence: Silence::default(),
            polled_ns: 0,
            // The first poll finds whatever was published before.
            rung: bells.role(role).poll().wrapping_sub(1),
            due_ns: 0,
            alarm: Alarm::new(),
            topics: bit(Topic::Directive),
            listens: false,
            realtime,
            crowded_until_ns: Cell::new(0),
            unprepared_until_ns: 0,
            bells,
            cleanup: OrphanCleanup::new(&domain, shared.guard.word()),
            domain,
            settings,
            run,
            bus,
            shared,
            shutdown,
        })
    }

    /// One table of the settings of this role, usually [`crate::settings_table`]; empty when it is absent.
    ///
    /// # Errors
    /// [`RuntimeError::Settings`] with the key that does not fit.
    pub fn settings<T: DeserializeOwned>(&self, name: &str) -> Result<T, RuntimeError> {
        settings::table(&self.domain, self.shared.role, &self.settings, name)
    }

    /// The error for a table of settings that is not allowed.
    pub(crate) fn refuse_settings(&self, table: &str, reason: &dyn Display) -> RuntimeError {
        let path = self.domain.directory().join(settings::settings_file(self.shared.role));
        RuntimeError::settings(path, format_args!("{table}: {reason}"))
    }

    /// Scan period [ns].
    pub fn period_ns(&self) -> u64 {
        self.run.period_ns
    }

    /// Age above which an arriving input is dropped: three scan periods, at least [`shared_types::YOUNG_NS`] [ns].
    pub fn max_age_ns(&self) -> u64 {
        self.shared.max_age_ns()
    }

    /// The clock of the loop.
    pub fn clock(&self) -> &Clock {
        &self.shared.clock
    }

    /// The time of the loop, for a stage that is about to use what it has taken [ns]. A replay hands it the same time, so
    /// nothing that an output follows from may come from another clock.
    pub fn now_ns(&self) -> u64 {
        let now_ns = self.shared.clock.now_ns();
        self.note(JournalKind::Used, now_ns);
        now_ns
    }

    /// Notes in the journal what outputs follow from and no sample shows.
    pub fn note(&self, kind: JournalKind, value: u64) {
        self.shared.notes.note(kind, value);
    }

    /// Notes in the journal that the newest directive, which has this header, was taken.
    pub fn note_taken(&self, directive: &Header) {
        self.shared.notes.note_sample(JournalKind::Taken, Topic::Directive, directive);
    }

    /// The newest directive; its `stop` is 1 also when [`Process::must_stop`].
    pub fn directive(&self) -> Directive {
        let directive = *self.shared.directive.borrow();
        Directive { stop: if self.must_stop() { 1 } else { directive.stop }, ..directive }
    }

    /// Whether the wheels must be blocked whatever any process commands: the run was stopped for good, or no directive
    /// came for `orphan_stop_s`.
    pub fn must_stop(&self) -> bool {
        self.shared.guard.must_stop()
    }

    /// Reports what the wheels do, so that a stop can be confirmed. A robot calls it each time it wakes; for an
    /// actuator its output does.
    pub fn report_wheels(&self, wheels: Wheels) {
        self.shared.guard.set_wheels(wheels);
        self.publish_wheels();
    }

    /// Reports what the devices behind this process do, and why in a few words, for `scanloop status`. A driver calls it
    /// each time it wakes; the next heartbeat follows at once when state or reason are new.
    pub fn report_device(&self, state: DeviceState, reason: &str) {
        if self.shared.device.borrow_mut().note(state, reason, monotonic_ns()) {
            self.shared.counters.is_urgent.set(true);
        }
    }

    pub(crate) fn publish_wheels(&self) {
        if self.is_in_charge() {
            self.shared.guard.publish_wheels();
        }
    }

    /// Whether the outputs of this process count, now or from an announced scan on; known after [`Process::start`].
    pub fn is_in_charge(&self) -> bool {
        self.shared.is_in_charge()
    }

    /// Opens a topic for reading; samples arrive from [`Process::start`] on.
    ///
    /// # Errors
    /// [`RuntimeError::NotYourTopic`] when the role does not read it, and errors of the bus.
    pub fn input<S: Sample>(&mut self) -> Result<Input<S>, RuntimeError> {
        self.open_input(S::TYPE).map(Input::of)
    }

    pub(crate) fn open_input(
        &mut self,
        of: &'static SampleType,
    ) -> Result<Enclosed<Rc<Reader>>, RuntimeError> {
        let role = self.shared.role;
        if !role.reads().contains(&of.topic) {
            return Err(RuntimeError::NotYourTopic { role, verb: "read", topic: of.topic });
        }
        let reader = Rc::new(Reader::new(&self.bus, Rc::clone(&self.shared), of)?);
        self.inputs.push(Enclosed::new(Rc::clone(&reader)));
        self.topics |= bit(of.topic);
        Ok(Enclosed::new(reader))
    }

    /// Opens a topic for writing.
    ///
    /// # Errors
    /// [`RuntimeError::NotYourTopic`] when another role writes it, and errors of the bus.
    pub fn output<S: Sample>(&mut self) -> Result<Rc<Output<S>>, RuntimeError> {
        self.open_output(S::TYPE).map(|writer| Rc::new(Output::of(writer)))
    }

    pub(crate) fn open_output(
        &mut self,
        of: &'static SampleType,
    ) -> Result<Enclosed<Rc<Writer>>, RuntimeError> {
        let role = self.shared.role;
        if !may_write(role, of.topic) {
            return Err(RuntimeError::NotYourTopic { role, verb: "write", topic: of.topic });
        }
        let writer = Rc::new(Writer::new(&self.bus, Rc::clone(&self.shared), of)?);
        self.outputs.push(Rc::clone(&writer) as Rc<dyn Connect>);
        Ok(Enclosed::new(writer))
    }

    /// Opens a topic of your own that `also_reads` of the system file gives to this process, before
    /// [`Process::start`].
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`] when the system file does not name it for this role, [`RuntimeError::Layout`] with
    /// the field that differs, and errors of the bus.
    pub fn open<S: Pod + Described>(&mut self, name: &str) -> Result<NamedTopic<S>, RuntimeError> {
        let (topic, port) = NamedTopic::open(&self.bus, &self.member()?, name)?;
        self.on_connect(move || port.connect());
        Ok(topic)
    }

    /// [`Process::open`] for another language, with the fields as it lays them out.
    ///
    /// # Errors
    /// As [`Process::open`].
    pub fn open_rows(&mut self, name: &str, mine: &[LayoutRow]) -> Result<ByteTopic, RuntimeError> {
        let topic = ByteTopic::open_rows(&self.bus, &self.member()?, name, mine)?;
        let port = topic.clone();
        self.on_connect(move || port.connect());
        Ok(topic)
    }

    /// The topics of your own that the system file gives to this process, with these fields, before [`Process::start`].
    ///
    /// # Errors
    /// A topic without one of the fields, and errors of the bus.
    pub(crate) fn open_own_fields(
        &mut self,
        fields: (&[&str], &str),
    ) -> Result<Vec<OwnFields>, RuntimeError> {
        let table = OwnTopics::of(&self.domain)?;
        let role = self.shared.role;
        let of_role = |table: &OwnTopics| {
            let rows = table.also_reads.iter().filter(|also| also.role == role.name());
            rows.map(|also| also.topic.clone()).collect::<Vec<_>>()
        };
        let mut opened = Vec::new();
        for name in table.as_ref().map(of_role).unwrap_or_default() {
            let (own, topic) = OwnFields::open(&self.bus, &self.member()?, &name, fields)?;
            self.on_connect(move || topic.connect());
            opened.push(own);
        }
        Ok(opened)
    }

    /// This process as a user of topics of your own.
    fn member(&self) -> Result<Rc<Member>, RuntimeError> {
        let Shared { role, incarnation, .. } = *self.shared;
        Member::new(&self.domain, Place::Role(role), role.name(), incarnation)
    }

    /// The role of this process.
    pub(crate) fn role(&self) -> Role {
        self.shared.role
    }

    /// The doorbells of the system.
    pub(crate) fn bells(&self) -> &Arc<Bells> {
        &self.bells
    }

    /// The node of this process on the bus, for services beside the topics: a bench has some.
    pub fn node(&self) -> &Node<ipc::Service> {
        self.bus.node()
    }

    /// Calls `connect` where [`Process::start`] connects the ports, and before inputs are due: for ports of other
    /// services.
    pub fn on_connect(&mut self, connect: impl Fn() + 'static) {
        self.outputs.push(Rc::new(connect));
    }

    /// Waits until all processes have opened their ports and all connections are made; false when asked to end.
    ///
    /// Without this barrier the first samples would be lost silently, because a publisher can't fill a connection
    /// before its reader has made the other end.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room for what the ports need, and errors of the bus.
    pub fn start(&mut self) -> Result<bool, RuntimeError> {
        self.bus.allocate()?;
        self.beat()?;
        loop {
            if !self.sleep(MAX_WAIT_NS, Need::Any, &mut |_| {})? {
                return Ok(false);
            }
            let directive = self.directive();
            let phase = Phase::try_from(directive.phase).unwrap_or(Phase::Starting);
            if phase >= Phase::Connecting && self.state == ProcessState::Attached {
                self.outputs.iter().for_each(|output| output.connect());
                self.checkpoint.writer().connect();
                for input in &self.inputs {
                    input.drain()?;
                }
                self.realtime.apply_memory();
                self.enter(ProcessState::Connected)?;
            }
            if phase >= Phase::Driving {
                return Ok(true);
            }
            if directive.issued_ns > 0 {
                // No scan was published yet.
                self.shared.known_scan.set(KnownScan::start(self.shared.clock.now_ns()));
            }
        }
    }

    /// Stamps the start of work that has no input: for the robot, whose scans start the chain.
    pub fn begin(&self) {
        self.set_alarm();
        let now = self.shared.clock.now_ns();
        self.shared.stamps.set(StageStamps { woken_ns: now, taken_ns: now, ..StageStamps::default() });
    }

    fn enter(&mut self, state: ProcessState) -> Result<(), RuntimeError> {
        self.state = state;
        self.beat()
    }

    /// The next heartbeat: state and counters of this process.
    pub fn heartbeat(&self) -> Heartbeat {
        let mut heartbeat = Heartbeat {
            role: self.shared.role.wire(),
            state: self.state.wire(),
            pid: u64::from(std::process::id()),
            obeys_stop: u32::from(self.shared.guard.word().is_some()),
            issued_ns: monotonic_ns(),
            looked_ns: self.polled_ns,
            device: *self.shared.device.borrow(),
            ..Heartbeat::default()
        };
        self.shared.counters.fill(&mut heartbeat);
        for input in &self.inputs {
            if let Some(port) = self.shared.role.reads().iter().position(|topic| *topic == input.topic()) {
                add_input(&mut heartbeat, port, input.account());
                heartbeat.refused[port] = input.refusal();
            }
        }
        heartbeat
    }

    fn beat(&mut self) -> Result<(), RuntimeError> {
        let mut heartbeat = self.heartbeat();
        self.next_heartbeat_ns = heartbeat.issued_ns + HEARTBEAT_NS;
        self.shared.counters.is_urgent.set(false);
        self.heartbeat.publish_silently(&mut heartbeat)
    }
}

impl Drop for Process {
    /// Publishes the last heartbeat, with the counters of the last samples. A killed process can't.
    fn drop(&mut self) {
        let _ = self.enter(ProcessState::Ending);
    }
}
