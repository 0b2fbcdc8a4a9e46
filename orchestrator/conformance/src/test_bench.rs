//! A system with one process in it, the candidate; the stand plays all the others.
//!
//! Each case has a stand of its own, so no case depends on another. The stand is the orchestrator of a system with
//! an id of its own: it creates the bus, gives incarnations, speaks directives. It publishes what the candidate
//! reads from a recorded drive whose stamps are moved to now, and keeps all that the candidate says.
//!
//! Waiting never depends on how fast the machine is: it ends with what is waited for, or after seconds. Scans are
//! published when they are due; when the machine held the stand up, all later ones move back.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use anyhow::Context;
use console::exit::{Exit, Failure};
use runtime::{Bus, Domain, HandoverData, Observer, Publisher, StopWord, monotonic_ns, write_handover};
use shared_types::{
    Actuation, ActuationKind, Authority, Checkpoint, Directive, Heartbeat, Phase, ProcessState, Role,
    StageStamps, Topic,
};
use supervision::child::{Child, Launch};
use supervision::child_log::ChildLog;
use supervision::environment::environment_of;
use supervision::lock::{Claim, SystemLock};

use super::case::{Trouble, failed, require};
use super::drive::Drive;
use super::message::{Message, Publishers, Subscribers};
use super::suite::{Setup, Suite, write_settings};

/// A process that has not reached a state of the start barrier after this time does not reach it [ns].
pub(crate) const START_NS: u64 = 30_000_000_000;
/// An answer that has not come after this time does not come [ns].
pub(crate) const ANSWER_NS: u64 = 5_000_000_000;
/// The directive is repeated this often [ns].
const REPEAT_NS: u64 = 100_000_000;
/// Longest sleep between two looks [ns].
const POLL_NS: u64 = 5_000_000;
/// Incarnation of the first candidate of a stand; those after it count on.
const CANDIDATE: u32 = 7;
/// Incarnations that the stand speaks as: this, plus the index of the role.
const OTHERS: u32 = 100;
/// An incarnation without authority.
pub(crate) const STRANGER: u32 = 999;

/// Something that the candidate said.
#[derive(Debug, Clone)]
pub(crate) struct Received {
    /// What.
    pub(crate) message: Message,
    /// When the stand heard it [ns].
    pub(crate) at_ns: u64,
}

/// What the stand tells a robot after each scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Order {
    /// Velocity [m/s] and steering angle [rad] sent.
    Drive(f64, f64),
    /// Block the wheels.
    Block,
    /// Say nothing.
    Silence,
}

/// A system with one process in it.
pub(crate) struct TestBench<'a> {
    // Dropped in this order: the candidate, the ports, the bus, and last all files of the system.
    pub(crate) child: Option<Child>,
    pub(crate) suite: &'a Suite,
    pub(crate) setup: Setup,
    pub(crate) drive: Arc<Drive>,
    pub(crate) directive: Directive,
    /// Whether directives are kept back, as after the death of an orchestrator.
    pub(crate) mute: bool,
    /// Whether the candidate may end.
    pub(crate) may_end: bool,
    /// What a robot is told after each scan.
    pub(crate) order: Order,
    /// What a robot was told last.
    pub(crate) last_actuation: Option<Message>,
    /// All that was said, oldest first.
    pub(crate) received: Vec<Received>,
    pub(crate) heartbeats: Vec<Heartbeat>,
    pub(crate) checkpoints: Vec<Checkpoint>,
    /// The scan that is played next.
    pub(crate) scan_id: u64,
    /// Incarnation of the newest candidate.
    pub(crate) incarnation: u32,
    /// The machine's time when the drive's own time was zero [ns].
    offset_ns: u64,
    said_ns: u64,
    dirty: bool,
    log: ChildLog,
    publishers: Publishers,
    subscribers: Subscribers,
    beats: Observer<Heartbeat>,
    states: Observer<Checkpoint>,
    voice: Publisher<Directive>,
    pub(crate) bus: Bus,
    pub(crate) domain: Domain,
    word: StopWord,
    // Dropped last: removes what the ports above used.
    _lock: SystemLock,
}

impl Suite {
    /// A stand without a candidate yet.
    pub(crate) fn bench(&self, setup: Setup) -> Result<TestBench<'_>, Trouble> {
        let number = self.stands.fetch_add(1, Ordering::Relaxed);
        Ok(TestBench::new(self, setup, number)?)
    }

    /// A stand whose candidate has started and waits for its first scan.
    pub(crate) fn started(&self, setup: Setup) -> Result<TestBench<'_>, Trouble> {
        let mut bench = self.bench(setup)?;
        bench.start()?;
        Ok(bench)
    }
}

impl<'a> TestBench<'a> {
    pub(super) fn new(suite: &'a Suite, setup: Setup, number: u32) -> anyhow::Result<Self> {
        let drive = suite.drive(setup.course)?;
        let (domain, lock) = Claim::take_new(&format!("c{}-{number}", std::process::id()))?;
        let word = StopWord::create(domain.run_id(), suite.period_ns)?;
        word.hand_down()?;
        write_settings(&domain, &drive, setup)?;
        let bus = Bus::create(&domain)?;
        let mut directive =
            Directive { orchestrator_pid: u64::from(std::process::id()), ..Directive::default() };
        for role in Role::ALL {
            let incarnation = if *role == suite.role { CANDIDATE } else { speaker(*role) };
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        }
        Ok(Self {
            child: None,
            log: ChildLog::open(&domain.directory().join("candidate.log"))?,
            publishers: Publishers::new(&bus)?,
            subscribers: Subscribers::new(&bus, suite.role)?,
            beats: Observer::new(&bus)?,
            states: Observer::new(&bus)?,
            voice: Publisher::new(&bus)?,
            scan_id: setup.first_scan,
            suite,
            setup,
            drive,
            directive,
            mute: false,
            may_end: false,
            order: Order::Drive(0.7, 0.0),
            last_actuation: None,
            received: Vec::new(),
            heartbeats: Vec::new(),
            checkpoints: Vec::new(),
            incarnation: CANDIDATE,
            offset_ns: 0,
            said_ns: 0,
            dirty: true,
            bus,
            domain,
            word,
            _lock: lock,
        })
    }

    /// Starts the candidate; `restart` and `checkpoint` are what a successor is told.
    pub(crate) fn spawn(&mut self, restart: bool, checkpoint: Option<&Checkpoint>) -> Result<(), Trouble> {
        let role = self.suite.role;
        let handover = checkpoint.map(|checkpoint| HandoverData {
            checkpoint: Checkpoint { issued_ns: monotonic_ns(), ..*checkpoint },
            ended_ns: 0,
            actuations: Vec::new(),
        });
        write_handover(&self.domain, role, handover.as_ref())?;
        let environment = environment_of(&self.domain, &self.word, role, self.incarnation, restart);
        let launch = Launch { command: self.suite.command.clone(), environment };
        let child = Child::spawn(&launch, &self.log).map_err(Failure::process)?;
        self.child = Some(child);
        Ok(())
    }

    /// Ends the candidate at once and gives the next one its incarnation, as a supervisor does.
    pub(crate) fn replace(&mut self) -> Result<(), Trouble> {
        self.kill()?;
        self.incarnation += 1;
        let incarnation = self.incarnation;
        self.directive.authority[self.suite.role.index()] = Authority { incarnation, ..Authority::default() };
        self.dirty = true;
        self.heartbeats.clear();
        self.turn()
    }

    /// Kills and reaps the candidate and cleans up after it.
    pub(crate) fn kill(&mut self) -> Result<(), Trouble> {
        self.child = None;
        self.bus.clean_up_dead_processes();
        Ok(())
    }

    /// Starts the candidate and takes it through the start barrier.
    pub(crate) fn start(&mut self) -> Result<(), Trouble> {
        self.spawn(false, None)?;
        self.barrier()
    }

    /// Takes the candidate through the start barrier.
    pub(crate) fn barrier(&mut self) -> Result<(), Trouble> {
        self.attach()?;
        self.announce(Phase::Connecting)?;
        self.wait_for_state(ProcessState::Connected)?;
        self.announce(Phase::Driving)
    }

    /// Waits until the candidate has joined; one that does not cannot be started, which ends the suite.
    pub(crate) fn attach(&mut self) -> Result<(), Trouble> {
        self.wait_for_state(ProcessState::Attached).map_err(|trouble| match trouble {
            Trouble::Failed(reason) => {
                Trouble::Broken(Failure::process(format!("could not be started: {reason}")))
            }
            other => other,
        })
    }

    /// Says in which phase the system is.
    pub(crate) fn announce(&mut self, phase: Phase) -> Result<(), Trouble> {
        self.directive.phase = phase.wire();
        if phase == Phase::Driving {
            self.begin();
        }
        self.dirty = true;
        self.turn()
    }

    /// Changes the directive and says it at once.
    pub(crate) fn direct(&mut self, change: impl FnOnce(&mut Directive)) -> Result<(), Trouble> {
        change(&mut self.directive);
        self.dirty = true;
        self.turn()
    }

    /// Waits until the candidate says that it has come this far.
    pub(crate) fn wait_for_state(&mut self, state: ProcessState) -> Result<(), Trouble> {
        let reached = |bench: &Self| bench.heartbeats.iter().any(|beat| beat.state >= state.wire());
        if self.until(START_NS, reached)? {
            return Ok(());
        }
        let last = self.heartbeats.last().and_then(|beat| ProcessState::try_from(beat.state).ok());
        let said = last.map_or("nothing".to_owned(), |state| format!("`{state}`"));
        failed(format!(
            "did not say `{state}` within {} s; it said {said}{}",
            START_NS / 1_000_000_000,
            self.words()
        ))
    }

    /// Lets the drive begin now, with the next scan.
    pub(crate) fn begin(&mut self) {
        if !self.setup.lockstep {
            let lead_ns = self.suite.period_ns / 2;
            self.offset_ns = (monotonic_ns() + lead_ns).saturating_sub(self.drive.ready_ns(self.scan_id));
        }
    }

    /// When a scan is due on the machine's clock [ns].
    pub(crate) fn due_ns(&self, scan_id: u64) -> u64 {
        self.drive.ready_ns(scan_id) + self.offset_ns
    }

    /// Waits until the scan is due.
    pub(crate) fn wait_until_due(&mut self, scan_id: u64) -> Result<(), Trouble> {
        if self.setup.lockstep {
            return self.turn();
        }
        let due_ns = self.due_ns(scan_id);
        self.until(due_ns.saturating_sub(monotonic_ns()), |_| monotonic_ns() >= due_ns)?;
        // The data of a scan that is said late are as fresh as those of one in time.
        let late_ns = monotonic_ns().saturating_sub(due_ns);
        if late_ns > self.suite.period_ns / 4 {
            self.offset_ns += late_ns;
        }
        Ok(())
    }

    /// The sample of a topic about a scan as its writer would say it now.
    pub(crate) fn message(&self, topic: Topic, scan_id: u64) -> Result<Message, Trouble> {
        let recorded = self.drive.message(topic, scan_id);
        let mut message = recorded.with_context(|| format!("scan {scan_id} has no {topic}"))?;
        let writer = topic.writer().context("a topic of the loop")?;
        message.shift(self.offset_ns);
        let lockstep = self.setup.lockstep;
        let header = message.header_mut();
        (header.scan_id, header.incarnation) = (scan_id, speaker(writer));
        if !lockstep {
            let now = monotonic_ns();
            *header.stage_mut(writer) =
                StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
        }
        Ok(message)
    }

    /// The samples that make the candidate answer a scan; each carries the stamps of those before it.
    pub(crate) fn inputs(&self, scan_id: u64) -> Result<Vec<Message>, Trouble> {
        let mut inputs: Vec<Message> = Vec::new();
        for topic in asking(self.suite.role) {
            let mut message = self.message(*topic, scan_id)?;
            for before in &inputs {
                if let Some(writer) = before.topic().writer() {
                    *message.header_mut().stage_mut(writer) = *before.header().stage(writer);
                }
            }
            inputs.push(message);
        }
        Ok(inputs)
    }

    /// Publishes a sample; layout and sequence are filled and stay in the message.
    pub(crate) fn publish(&mut self, message: &mut Message) -> Result<(), Trouble> {
        Ok(self.publishers.publish(message, false)?)
    }

    /// Publishes a sample exactly as it is.
    pub(crate) fn publish_exactly(&mut self, message: &Message) -> Result<(), Trouble> {
        Ok(self.publishers.publish(&mut message.clone(), true)?)
    }

    /// Publishes what makes the candidate answer the next scan, when it is due; returns its id.
    pub(crate) fn ask(&mut self) -> Result<u64, Trouble> {
        let scan_id = self.scan_id;
        self.wait_until_due(scan_id)?;
        for mut message in self.inputs(scan_id)? {
            self.publish(&mut message)?;
        }
        self.scan_id += 1;
        Ok(scan_id)
    }

    /// One scan: the candidate is asked, and its first answer is returned.
    ///
    /// A robot asks, and is told its [`Order`].
    pub(crate) fn round(&mut self) -> Result<Received, Trouble> {
        if self.suite.role == Role::Robot {
            return self.robot_round();
        }
        let scan_id = self.ask()?;
        let answer = self.answer(scan_id)?;
        self.conclude(scan_id)?;
        Ok(answer)
    }

    /// Several rounds.
    pub(crate) fn rounds(&mut self, count: usize) -> Result<Vec<Received>, Trouble> {
        (0..count).map(|_| self.round()).collect()
    }

    /// Waits for the first answer to a scan.
    pub(crate) fn answer(&mut self, scan_id: u64) -> Result<Received, Trouble> {
        if self.until(ANSWER_NS, |bench| bench.first_answer(scan_id).is_some())?
            && let Some(answer) = self.first_answer(scan_id)
        {
            return Ok(answer.clone());
        }
        failed(format!("no answer to scan {scan_id} within {} s{}", ANSWER_NS / 1_000_000_000, self.words()))
    }

    /// Says what follows from the answer: an estimator hears what was sent to the robot.
    pub(crate) fn conclude(&mut self, scan_id: u64) -> Result<(), Trouble> {
        if self.suite.role == Role::Estimator {
            let mut actuation = self.message(Topic::Actuation, scan_id)?;
            self.publish(&mut actuation)?;
        }
        Ok(())
    }

    fn robot_round(&mut self) -> Result<Received, Trouble> {
        let last = self.scan_id - 1;
        let is_new = move |received: &Received| {
            matches!(received.message, Message::Odometry(_)) && received.message.scan_id() > last
        };
        if self.setup.lockstep {
            self.directive.granted_scan = self.scan_id;
            self.dirty = true;
        }
        self.until(ANSWER_NS, |bench| bench.received.iter().any(is_new))?;
        let Some(odometry) = self.received.iter().rev().find(|received| is_new(received)).cloned() else {
            return failed(format!(
                "no scan after scan {last} within {} s{}",
                ANSWER_NS / 1_000_000_000,
                self.words()
            ));
        };
        self.scan_id = odometry.message.scan_id() + 1;
        if let Some(mut actuation) = self.actuation(&odometry.message) {
            self.publish(&mut actuation)?;
            self.last_actuation = Some(actuation);
        }
        Ok(odometry)
    }

    /// What a robot is told because of its scan.
    pub(crate) fn actuation(&self, odometry: &Message) -> Option<Message> {
        let (kind, velocity, steering) = match self.order {
            Order::Drive(velocity, steering) => (ActuationKind::Drive, velocity, steering),
            Order::Block => (ActuationKind::Block, 0.0, 0.0),
            Order::Silence => return None,
        };
        let mut header = odometry.header().answer();
        header.incarnation = speaker(Role::Actuator);
        let now = if self.setup.lockstep { header.scan_published_ns() } else { monotonic_ns() };
        for role in [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator] {
            *header.stage_mut(role) =
                StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
        }
        Some(Message::Actuation(Box::new(Actuation {
            header,
            kind: kind.wire(),
            answers: 1,
            desired_velocity_mps: velocity,
            desired_steering_rad: steering,
            sent_velocity_mps: velocity,
            sent_steering_rad: steering,
            ..Actuation::default()
        })))
    }

    /// The first answer to a scan, if it has come.
    pub(crate) fn first_answer(&self, scan_id: u64) -> Option<&Received> {
        self.answers(scan_id).next()
    }

    /// All answers to a scan so far.
    pub(crate) fn answers(&self, scan_id: u64) -> impl Iterator<Item = &Received> {
        let is_answer =
            move |received: &&Received| received.message.scan_id() == scan_id && received.message.is_answer();
        self.received.iter().filter(is_answer)
    }

    /// That nothing but what is harmless was said about a scan.
    pub(crate) fn require_no_answer(&self, scan_id: u64, after: &str) -> Result<(), Trouble> {
        let bad = self
            .received
            .iter()
            .find(|received| received.message.scan_id() == scan_id && !received.message.is_harmless());
        require(bad.is_none(), || {
            format!("it published {} of scan {scan_id} after {after}", self.suite.role.writes()[0])
        })
    }

    /// Listens for a number of scan periods.
    pub(crate) fn receive_for(&mut self, periods: f64) -> Result<(), Trouble> {
        self.until((periods * self.suite.period_ns as f64) as u64, |_| false).map(|_| ())
    }

    /// Listens until something holds, or for `limit_ns`; tells whether it holds.
    pub(crate) fn until(
        &mut self,
        limit_ns: u64,
        mut done: impl FnMut(&Self) -> bool,
    ) -> Result<bool, Trouble> {
        let end_ns = monotonic_ns().saturating_add(limit_ns);
        loop {
            self.turn()?;
            if done(self) {
                return Ok(true);
            }
            let left_ns = end_ns.saturating_sub(monotonic_ns());
            if left_ns == 0 {
                return Ok(false);
            }
            self.subscribers.wait(left_ns.min(POLL_NS));
        }
    }

    /// Takes all that was said, and speaks when it is time.
    pub(crate) fn turn(&mut self) -> Result<(), Trouble> {
        if self.suite.shutdown.requested() {
            let message = "interrupted by a signal".to_owned();
            return Err(Trouble::Broken(Failure { exit: Exit::NotReached, message }.into()));
        }
        let now = monotonic_ns();
        if !self.mute && (self.dirty || now.saturating_sub(self.said_ns) >= REPEAT_NS) {
            self.directive.issued_ns = now;
            self.voice.publish(&mut self.directive, self.dirty)?;
            (self.dirty, self.said_ns) = (false, now);
        }
        self.subscribers
            .receive(|message| self.received.push(Received { message, at_ns: monotonic_ns() }))?;
        let incarnation = self.incarnation;
        self.beats.poll(|beat| {
            if beat.header.incarnation == incarnation {
                self.heartbeats.push(*beat);
            }
        })?;
        self.states.poll(|checkpoint| self.checkpoints.push(*checkpoint))?;
        if !self.may_end
            && let Some(exit) = self.exit()?
        {
            return failed(format!("the process ended: {exit}{}", self.words()));
        }
        Ok(())
    }

    /// Lets another orchestrator speak: directives of another writer, which count from 1 again.
    pub(crate) fn renew_publisher(&mut self) -> Result<(), Trouble> {
        self.voice = Publisher::new(&self.bus)?;
        self.directive.orchestrator_pid = u64::from(u32::MAX);
        self.directive.header.incarnation += 1;
        self.dirty = true;
        self.turn()
    }

    /// How the candidate ended, if it has.
    pub(crate) fn exit(&mut self) -> Result<Option<supervision::supervisor::Exit>, Trouble> {
        Ok(self.child.as_mut().map(|child| child.try_wait()).transpose()?.flatten())
    }

    /// Last lines of the candidate's output, to be put behind a reason.
    pub(crate) fn words(&self) -> String {
        match self.log.last_lines(3) {
            Ok(lines) if !lines.is_empty() => format!("; its last words: {}", lines.join(" | ")),
            _ => String::new(),
        }
    }

    /// Names of all files that the system has in shared memory, those in the directory of its bus included.
    pub(crate) fn shared_memory(&self) -> Result<BTreeSet<String>, Trouble> {
        let mut names = BTreeSet::new();
        let mut directories = vec![self.domain.bus_directory()];
        while let Some(directory) = directories.pop() {
            // What is being removed may be gone.
            for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
                let path = entry.path();
                names.insert(path.display().to_string());
                if path.is_dir() {
                    directories.push(path);
                }
            }
        }
        let files = std::fs::read_dir("/dev/shm")?.flatten();
        let files = files.map(|entry| entry.file_name().to_string_lossy().into_owned());
        names.extend(files.filter(|name| name.starts_with(self.domain.shared_memory_prefix())));
        Ok(names)
    }
}

/// Topics whose samples make a role answer a scan.
pub(crate) fn asking(role: Role) -> &'static [Topic] {
    match role {
        // What was sent to the robot is a by-the-way.
        Role::Estimator => &[Topic::Odometry],
        _ => role.reads(),
    }
}

/// The incarnation that the stand speaks as in place of a role.
pub(crate) fn speaker(role: Role) -> u32 {
    OTHERS + role as u32
}
