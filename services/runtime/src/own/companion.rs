//! A process that fills no role.

use std::rc::Rc;

use bytemuck::Pod;
use shared_types::{Described, LayoutRow, Phase, ProcessState, Sample, StageStamps};

use super::builtin::{Feed, LoopTopic};
use super::member::{Member, Place};
use super::page::{CompanionSelfReport, MAX_COMPANIONS};
use super::table::CompanionRow;
use super::topic::{ByteTopic, NamedTopic};
use crate::crash::report_crashes;
use crate::environment::{COMPANION_VARIABLE, REPORT_VARIABLE};
use crate::{Bus, Clock, Domain, OwnTopics, RuntimeError, Shutdown, domain, monotonic_ns, wait_for};

/// Longest sleep [ns].
const MAX_WAIT_NS: u64 = 100_000_000;
/// Time between two polls of the phase during the start [ns].
const START_POLL_NS: u64 = 2_000_000;

/// A companion: a process of your own beside the five of the loop.
///
/// ```no_run
/// use runtime::Companion;
/// use shared_types::{Header, StageStamps, Truth};
///
/// shared_types::plain_state! {
///     /// What an inertial sensor measures.
///     pub struct Imu {
///         /// Identity and stamps of the sample that this one answers
///         pub header: Header,
///         /// Yaw rate [rad/s]
///         pub yaw_rate_radps: f64,
///         /// When the process that published it worked on it
///         pub stage: StageStamps,
///     }
/// }
///
/// fn main() -> Result<(), runtime::RuntimeError> {
///     let mut companion = Companion::attach()?;
///     let truths = companion.input::<Truth>()?;
///     let imu = companion.open::<Imu>("imu")?;
///     if !companion.start()? {
///         return Ok(());
///     }
///     while companion.wait(None)? {
///         while let Some(truth) = truths.take()? {
///             let yaw_rate_radps = truth.yaw_rate_radps;
///             imu.publish(&mut Imu { header: truth.header.answer(), yaw_rate_radps, ..Imu::default() })?;
///         }
///     }
///     Ok(())
/// }
/// ```
pub struct Companion {
    member: Rc<Member>,
    shutdown: Shutdown,
    /// The first topic that it reads.
    first: Option<Trigger>,
    feeds: Vec<Rc<dyn Feed>>,
    ports: Vec<ByteTopic>,
    bus: Bus,
}

enum Trigger {
    Loop(Rc<dyn Feed>),
    Own(ByteTopic),
}

impl Companion {
    /// Joins the system that started this process.
    ///
    /// # Errors
    /// [`RuntimeError::NotInASystem`] when the process was started by hand, and errors of the bus.
    pub fn attach() -> Result<Self, RuntimeError> {
        report_crashes();
        let (_, incarnation) = domain::identity()?;
        let domain = Domain::of_this_process()?;
        let name = domain::variable(COMPANION_VARIABLE)?;
        let text = domain::variable(REPORT_VARIABLE)?;
        let report = text.parse().ok().filter(|report| *report < 2 * MAX_COMPANIONS);
        let report = report.ok_or(RuntimeError::Environment { variable: REPORT_VARIABLE, value: text })?;
        let unknown = || RuntimeError::NotInASystem(COMPANION_VARIABLE);
        let index = OwnTopics::of(&domain)?.and_then(|table| table.index_of(&name)).ok_or_else(unknown)?;
        let member = Member::new(&domain, Place::Companion { index, report }, &name, incarnation)?;
        let (shutdown, bus) = (Shutdown::on_signals()?, Bus::open(&domain, &name)?);
        Ok(Self { member, shutdown, first: None, feeds: Vec::new(), ports: Vec::new(), bus })
    }

    /// Opens a topic of the loop for reading.
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`] when `reads` does not name it, and errors of the bus.
    pub fn input<S: Sample>(&mut self) -> Result<LoopTopic<S>, RuntimeError> {
        let (name, member) = (S::TOPIC.name(), &self.member);
        let Place::Companion { index, .. } = member.place else { unreachable!("a companion has a number") };
        if !member.table.companion[index].reads.iter().any(|topic| topic == name) {
            return Err(RuntimeError::NoOwnTopic { process: member.name.clone(), topic: name.to_owned() });
        }
        let (topic, source) = LoopTopic::open(&self.bus, member)?;
        if member.is_first(name) {
            self.first = Some(Trigger::Loop(Rc::clone(&source) as Rc<dyn Feed>));
        }
        self.feeds.push(source);
        Ok(topic)
    }

    /// Opens a topic of your own, for reading or writing as the system file says.
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`] when this process neither reads nor writes it, [`RuntimeError::Layout`] with the
    /// field that differs, and errors of the bus.
    pub fn open<S: Pod + Described>(&mut self, name: &str) -> Result<NamedTopic<S>, RuntimeError> {
        let (topic, port) = NamedTopic::open(&self.bus, &self.member, name)?;
        self.keep(port);
        Ok(topic)
    }

    /// [`Companion::open`] for another language, with the fields as it lays them out.
    ///
    /// # Errors
    /// As [`Companion::open`].
    pub fn open_rows(&mut self, name: &str, mine: &[LayoutRow]) -> Result<ByteTopic, RuntimeError> {
        let topic = ByteTopic::open_rows(&self.bus, &self.member, name, mine)?;
        self.keep(topic.clone());
        Ok(topic)
    }

    /// [`Companion::open`] with the layout that the system has: for programs that copy samples and read no field but the
    /// header.
    ///
    /// # Errors
    /// [`RuntimeError::NoOwnTopic`] when this process neither reads nor writes it, and errors of the bus.
    pub fn open_bytes(&mut self, name: &str) -> Result<ByteTopic, RuntimeError> {
        let topic = ByteTopic::open(&self.bus, &self.member, name, &|_| Ok(()))?;
        self.keep(topic.clone());
        Ok(topic)
    }

    /// What the system file says about this process.
    pub fn uses(&self) -> &CompanionRow {
        let Place::Companion { index, .. } = self.member.place else {
            unreachable!("a companion has a number")
        };
        &self.member.table.companion[index]
    }

    fn keep(&mut self, topic: ByteTopic) {
        if self.member.is_first(topic.name()) {
            self.first = Some(Trigger::Own(topic.clone()));
        }
        self.ports.push(topic);
    }

    /// Waits until the system drives; false when asked to end.
    ///
    /// # Errors
    /// [`RuntimeError::SharedMemory`] when there is no room for what the ports need, and errors of the bus.
    pub fn start(&mut self) -> Result<bool, RuntimeError> {
        self.bus.allocate()?;
        self.enter(ProcessState::Attached);
        loop {
            let phase = self.member.page.phase();
            if phase >= Phase::Connecting {
                self.ports.iter().for_each(ByteTopic::connect);
                self.feeds.iter().for_each(|feed| feed.connect());
                self.enter(ProcessState::Connected);
            }
            if phase >= Phase::Driving {
                return Ok(!self.must_end());
            }
            if self.must_end() {
                return Ok(false);
            }
            self.turn();
            wait_for(&[self.shutdown.descriptor()], START_POLL_NS);
        }
    }

    /// Sleeps until a sample of the first topic may have come, the deadline has passed, or a tenth of a second has.
    /// The sample that was taken last counts as answered. False when the process must end.
    ///
    /// # Errors
    /// Errors of the bus.
    pub fn wait(&mut self, deadline_ns: Option<u64>) -> Result<bool, RuntimeError> {
        self.member.finish();
        if self.must_end() {
            return Ok(false);
        }
        let left_ns = deadline_ns.map_or(MAX_WAIT_NS, |deadline| deadline.saturating_sub(monotonic_ns()));
        let timeout_ns = left_ns.min(MAX_WAIT_NS);
        match &self.first {
            Some(Trigger::Loop(feed)) => {
                feed.sleep(timeout_ns);
                feed.poll()?;
            }
            Some(Trigger::Own(topic)) => {
                if let Some(reader) = topic.reading() {
                    wait_for(&[reader.descriptor(), self.shutdown.descriptor()], timeout_ns);
                    reader.poll()?;
                }
            }
            None => _ = wait_for(&[self.shutdown.descriptor()], timeout_ns),
        }
        let woken_ns = self.member.clock.now_ns();
        self.member.stamps.set(StageStamps { woken_ns, ..StageStamps::default() });
        self.turn();
        Ok(!self.must_end())
    }

    /// The clock of the loop.
    pub fn clock(&self) -> &Clock {
        &self.member.clock
    }

    /// Scan period [ns].
    pub fn period_ns(&self) -> u64 {
        self.member.table.run.period_ns
    }

    /// What this process has reported.
    pub fn report(&self) -> CompanionSelfReport {
        *self.member.report.borrow()
    }

    fn must_end(&self) -> bool {
        self.shutdown.requested() || self.member.silent_ns() > self.member.table.run.orphan_timeout_ns
    }

    fn turn(&self) {
        let report = &mut *self.member.report.borrow_mut();
        report.activations += 1;
        if report.published + report.answered > 0 && report.state == ProcessState::Connected.wire() {
            report.state = ProcessState::Ready.wire();
        }
        self.member.write(report);
    }

    fn enter(&self, state: ProcessState) {
        let report = &mut *self.member.report.borrow_mut();
        report.state = state.wire();
        self.member.write(report);
    }
}
