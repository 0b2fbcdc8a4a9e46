//! A system with one process in it, the candidate; the test bench plays all the others.
//!
//! Each case has a test bench of its own, so no case depends on another. The bench is the orchestrator of a system
//! with an id of its own: it creates the bus, gives incarnations and publishes directives. It publishes what the
//! candidate reads from a recorded drive whose stamps are moved to now, and keeps all that the candidate publishes.
//!
//! Waiting never depends on how fast the machine is: it ends with what is waited for, or after seconds. Scans are
//! published when they are due; when the machine delayed the bench, all later scans move back.

mod candidate;
mod play;
mod robot;

use std::sync::Arc;
use std::sync::atomic::Ordering;

use console::exit::{Exit, Failure};
use runtime::{Bus, Domain, Observer, Publisher, StopWord, monotonic_ns};
use shared_types::{Authority, Checkpoint, Directive, Heartbeat, Phase, Role, Topic};
use supervision::child::Child;
use supervision::child_log::ChildLog;
use supervision::lock::{Claim, SystemLock};

use super::case::{Tried, Trouble, failed};
use super::drive::{Course, Drive};
use super::message::Message;
use super::ports::{Publishers, Subscribers};
use super::suite::{Setup, Suite};

pub(crate) use robot::Order;

/// An answer that has not come after this time does not come [ns].
pub(crate) const ANSWER_NS: u64 = 5_000_000_000;
/// The directive is repeated this often [ns].
const REPEAT_NS: u64 = 100_000_000;
/// Longest sleep between two polls [ns].
const POLL_NS: u64 = 5_000_000;
/// Incarnation of the first candidate; the next ones count up.
const CANDIDATE: u32 = 7;
/// Incarnations of the other roles, which the bench plays: this, plus the index of the role.
const OTHERS: u32 = 100;
/// An incarnation without authority.
pub(crate) const FOREIGN: u32 = 999;

/// A system with one process in it.
pub(crate) struct TestBench<'a> {
    // Dropped in this order: the candidate, the ports, the bus, and last all files of the system.
    pub(crate) child: Option<Child>,
    pub(crate) suite: &'a Suite,
    pub(crate) setup: Setup,
    pub(crate) drive: Arc<Drive>,
    pub(crate) directive: Directive,
    /// Whether directives are withheld, as after the death of an orchestrator.
    pub(crate) withholds_directives: bool,
    /// Whether the candidate may end.
    pub(crate) may_end: bool,
    /// What a robot is told after each scan.
    pub(crate) order: Order,
    /// What a robot was told last.
    pub(crate) last_actuation: Option<Message>,
    /// All that was received, oldest first.
    pub(crate) received: Vec<Message>,
    pub(crate) heartbeats: Vec<Heartbeat>,
    pub(crate) checkpoints: Vec<Checkpoint>,
    /// The scan that is played next.
    pub(crate) scan_id: u64,
    /// Incarnation of the newest candidate.
    pub(crate) incarnation: u32,
    /// The machine's time when the drive's own time was zero [ns].
    offset_ns: u64,
    /// When the directive was published [ns].
    directive_ns: u64,
    /// Whether the directive has changed since.
    dirty: bool,
    log: Arc<ChildLog>,
    publishers: Publishers,
    subscribers: Subscribers,
    heartbeat_observer: Observer<Heartbeat>,
    checkpoint_observer: Observer<Checkpoint>,
    directive_publisher: Publisher<Directive>,
    pub(crate) bus: Bus,
    pub(crate) domain: Domain,
    stop_word: StopWord,
    // Dropped last: removes what the ports above used.
    _lock: SystemLock,
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
        let (domain, lock) = Claim::take_new(&format!("c{}-{number}", std::process::id()))?;
        let stop_word = StopWord::create(domain.run_id(), suite.period_ns)?;
        stop_word.hand_down()?;
        suite.write_settings(&domain, &drive, setup)?;
        let bus = Bus::create(&domain, suite.period_ns)?;
        let mut directive =
            Directive { orchestrator_pid: u64::from(std::process::id()), ..Directive::default() };
        for role in Role::ALL {
            let incarnation = if *role == suite.role { CANDIDATE } else { incarnation_of(*role) };
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        }
        Ok(Self {
            child: None,
            log: ChildLog::open(&domain.directory().join("candidate.log"))?,
            publishers: Publishers::new(&bus)?,
            subscribers: Subscribers::new(&bus, suite.role)?,
            heartbeat_observer: Observer::new(&bus)?,
            checkpoint_observer: Observer::new(&bus)?,
            directive_publisher: Publisher::new(&bus)?,
            scan_id: 1,
            suite,
            setup,
            drive,
            directive,
            withholds_directives: false,
            may_end: false,
            order: Order::Drive(0.7, 0.0),
            last_actuation: None,
            received: Vec::new(),
            heartbeats: Vec::new(),
            checkpoints: Vec::new(),
            incarnation: CANDIDATE,
            offset_ns: 0,
            directive_ns: 0,
            dirty: true,
            bus,
            domain,
            stop_word,
            _lock: lock,
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
        change(&mut self.directive);
        self.dirty = true;
        self.turn()
    }

    /// Publishes the directive from now on as another orchestrator does: the sequence counts from 1 again.
    pub(crate) fn renew_publisher(&mut self) -> Tried {
        self.directive_publisher = Publisher::new(&self.bus)?;
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
        let end_ns = monotonic_ns().saturating_add(limit_ns);
        loop {
            self.turn()?;
            let (found, left_ns) = (found(self), end_ns.saturating_sub(monotonic_ns()));
            if found.is_some() || left_ns == 0 {
                return Ok(found);
            }
            self.subscribers.wait(left_ns.min(POLL_NS));
        }
    }

    /// Publishes the directive when it is time, and takes all that was received.
    pub(crate) fn turn(&mut self) -> Tried {
        if self.suite.shutdown.requested() {
            let message = "interrupted by a signal".to_owned();
            return Err(Trouble::Broken(Failure { exit: Exit::NotReached, message }.into()));
        }
        let now = monotonic_ns();
        let is_due = self.dirty || now.saturating_sub(self.directive_ns) >= REPEAT_NS;
        if is_due && !self.withholds_directives {
            self.directive.issued_ns = now;
            self.directive_publisher.publish(&mut self.directive, self.dirty)?;
            (self.dirty, self.directive_ns) = (false, now);
        }
        self.subscribers.receive(|message| self.received.push(message))?;
        let own = |beat: &Heartbeat| beat.header.incarnation == self.incarnation;
        self.heartbeat_observer.poll(|beat| self.heartbeats.extend(own(beat).then_some(*beat)))?;
        self.checkpoint_observer.poll(|checkpoint| self.checkpoints.push(*checkpoint))?;
        match if self.may_end { None } else { self.exit()? } {
            Some(exit) => failed(format!("the process ended: {exit}{}", self.last_lines())),
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
