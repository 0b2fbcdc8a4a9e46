//! A system with one process in it, the candidate; the test bench plays all the others.
//!
//! Each case has a test bench of its own, so no case depends on another. The bench is the orchestrator of a system
//! with an id of its own: it creates the bus, gives incarnations and publishes directives. It publishes what the
//! candidate reads from a recorded drive whose stamps are moved to now, and keeps all that the candidate publishes.
//!
//! Waiting never depends on how fast the machine is: it ends with what is waited for, or after seconds. Scans are
//! published when they are due; when the machine delayed the bench, all later scans move back.

mod button;
mod candidate;
mod play;
mod robot;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use runtime::{Observer, TopicPublishers};
use shared_types::{Checkpoint, Directive, Heartbeat, Phase, Role, Topic};
use supervision::child::Child;
use supervision::child_log::ChildLog;
use supervision::directives::Directives;
use supervision::private_system::{Order, PrivateSystem, poll_until};

pub(crate) use self::button::Button;
use super::case::{Tried, failed};
use super::drive::{Course, Drive};
use super::message::Message;
use super::ports::Subscribers;
use super::suite::{Setup, Suite};

pub(crate) use supervision::private_system::ANSWER_NS;

/// Incarnation of the first candidate; the next ones count up.
const CANDIDATE: u32 = 7;
/// Incarnations of the other roles, which the bench plays: this, plus the index of the role.
const OTHERS: u32 = 100;
/// Topics of the roles that the bench plays.
const PLAYED: [Topic; 6] =
    [Topic::Scan, Topic::Odometry, Topic::Pose, Topic::Obstacles, Topic::Command, Topic::Actuation];
/// An incarnation without authority.
pub(crate) const FOREIGN: u32 = 999;

/// A system with one process in it.
pub(crate) struct TestBench<'a> {
    // Dropped in this order: the candidate, the ports, and last the system.
    pub(crate) child: Option<Child>,
    pub(crate) suite: &'a Suite,
    pub(crate) setup: Setup,
    pub(crate) drive: Arc<Drive>,
    /// Whether the candidate may end.
    pub(crate) may_end: bool,
    /// What a robot is told after each scan; `None` is nothing.
    pub(crate) order: Option<Order>,
    /// What a robot was told last.
    pub(crate) last_actuation: Option<Message>,
    /// All that was received, oldest first.
    pub(crate) received: Vec<Message>,
    pub(crate) heartbeats: Vec<Heartbeat>,
    pub(crate) checkpoints: Vec<Checkpoint>,
    /// The scan that is played next.
    pub(crate) scan_id: u64,
    /// The machine's time when the drive's own time was zero [ns].
    offset_ns: u64,
    pub(crate) log: Arc<ChildLog>,
    /// An emergency stop from outside, if the setup has one.
    pub(crate) button: Option<Button>,
    publishers: TopicPublishers,
    subscribers: Subscribers,
    checkpoint_observer: Observer<Checkpoint>,
    pub(crate) system: PrivateSystem,
}

impl Suite {
    /// A test bench without a candidate yet.
    pub(crate) fn bench(&self, setup: Setup) -> Tried<TestBench<'_>> {
        Ok(TestBench::new(self, setup)?)
    }

    /// A test bench whose candidate has started and waits for its first scan.
    pub(crate) fn started(&self, setup: Setup) -> Tried<TestBench<'_>> {
        let mut bench = self.bench(setup)?;
        bench.start()?;
        Ok(bench)
    }

    /// A started test bench in real time that begins at this scan of a course.
    pub(crate) fn started_on(&self, course: Course, first_scan: u64) -> Tried<TestBench<'_>> {
        self.started(Setup { course, first_scan, ..Setup::default() })
    }
}

impl<'a> TestBench<'a> {
    fn new(suite: &'a Suite, setup: Setup) -> anyhow::Result<Self> {
        let number = suite.benches.fetch_add(1, Ordering::Relaxed);
        let drive = Arc::new(suite.drive(setup.course)?.starting_at(setup.first_scan));
        let system = PrivateSystem::create(
            &format!("c{}-{number}", std::process::id()),
            suite.period_ns,
            |role| if role == suite.role { CANDIDATE } else { incarnation_of(role) },
            |domain| suite.write_settings(domain, &drive, setup),
        )?;
        let button = setup.button.then(|| Button::open(&system.bus, &system.domain)).transpose()?;
        Ok(Self {
            child: None,
            button,
            log: ChildLog::open(&system.domain.directory().join("candidate.log"))?,
            publishers: TopicPublishers::open(&system.domain, "conformance", &PLAYED)?,
            subscribers: Subscribers::new(&system.bus, suite.role)?,
            checkpoint_observer: Observer::new(&system.bus)?,
            scan_id: 1,
            suite,
            setup,
            drive,
            may_end: false,
            order: Some(Order::Drive(suite.vehicle.mps(0.7), 0.0)),
            last_actuation: None,
            received: Vec::new(),
            heartbeats: Vec::new(),
            checkpoints: Vec::new(),
            offset_ns: 0,
            system,
        })
    }

    /// Publishes in which phase the system is.
    pub(crate) fn announce(&mut self, phase: Phase) -> Tried {
        if phase == Phase::Driving {
            self.begin();
        }
        self.direct(|directive| directive.phase = phase.wire())
    }

    /// Changes the directive and publishes it at once.
    pub(crate) fn direct(&mut self, change: impl FnOnce(&mut Directive)) -> Tried {
        self.system.direct(change)?;
        self.turn()
    }

    /// Publishes the directive from now on as another orchestrator does: the sequence counts from 1 again.
    pub(crate) fn renew_publisher(&mut self) -> Tried {
        self.system.directives = Directives::new(&self.system.bus, self.system.directives.current)?;
        self.direct(|directive| {
            directive.orchestrator_pid = u64::from(u32::MAX);
            directive.header.incarnation += 1;
        })
    }

    /// Receives for a number of scan periods.
    pub(crate) fn receive_for(&mut self, periods: f64) -> Tried {
        self.until((periods * self.suite.period_ns as f64) as u64, |_| false).map(|_| ())
    }

    /// Receives until something holds, or for `limit_ns`; returns whether it holds.
    pub(crate) fn until(&mut self, limit_ns: u64, done: impl Fn(&Self) -> bool) -> Tried<bool> {
        Ok(self.find(limit_ns, |bench| done(bench).then_some(()))?.is_some())
    }

    /// Receives until something is found, or for `limit_ns`.
    pub(crate) fn find<T>(&mut self, limit_ns: u64, found: impl Fn(&Self) -> Option<T>) -> Tried<Option<T>> {
        let turn = |bench: &mut Self| bench.turn().map(|()| found(bench));
        poll_until(self, limit_ns, turn, |bench, left_ns| _ = bench.subscribers.wait(left_ns))
    }

    /// Publishes the directive when it is time, and takes all that was received.
    pub(crate) fn turn(&mut self) -> Tried {
        let own = self.incarnation();
        let is_own = |beat: &Heartbeat| beat.header.incarnation == own;
        let keep = |beat: &Heartbeat| self.heartbeats.extend(is_own(beat).then_some(*beat));
        self.system.turn(&self.suite.shutdown, keep)?;
        if let Some(button) = &mut self.button {
            button.turn()?;
        }
        self.subscribers.receive(|message| self.received.push(message))?;
        self.checkpoint_observer.poll(|checkpoint| self.checkpoints.push(*checkpoint))?;
        match if self.may_end { None } else { self.exit()? } {
            Some(exit) => failed(format!("the process ended: {exit}{}", self.log.last_lines_suffix())),
            None => Ok(()),
        }
    }
}

/// Topics whose samples make a role answer a scan.
pub(crate) fn inputs_of(role: Role) -> &'static [Topic] {
    // An estimator also reads what was sent to the robot, but does not answer that.
    if role == Role::Estimator { &[Topic::Odometry] } else { role.reads() }
}

/// The incarnation that the bench publishes as in place of a role.
pub(crate) fn incarnation_of(role: Role) -> u32 {
    OTHERS + role as u32
}
