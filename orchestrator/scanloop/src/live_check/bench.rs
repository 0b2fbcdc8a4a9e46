//! A system without a controller: robot, estimator and obstacle detector run, and this process commands the wheels.
//!
//! It answers each odometry with an actuation: to block, unless a check orders a drive. When it stops answering, the
//! actuations end and the robot's dead man blocks the wheels. Dropping the bench blocks the wheels, then ends all
//! processes.

use console::exit::{Exit, Failure};
use plan::Plan;
use runtime::{Bus, Observer, Publisher, Shutdown, StopWord, latch_on_crash, monotonic_ns, wait_for};
use shared_types::{
    Actuation, ActuationKind, Authority, BlockReason, Directive, Heartbeat, Odometry, Phase, ProcessState,
    Role, StageStamps,
};
use supervision::fleet::Fleet;
use supervision::lock::Claim;
use supervision::supervisor::Event;

use super::feed::Feed;
use super::{POLL_NS, interrupted};

/// The directive is repeated this often [ns].
const REPEAT_NS: u64 = 100_000_000;
/// Scans before the observation.
const STARTING_SCANS: usize = 5;
/// The roles that are started.
const STARTED: [Role; 3] = [Role::Robot, Role::Estimator, Role::Obstacles];

/// What the robot is told in answer to each odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Order {
    /// Block the wheels.
    Block,
    /// Velocity [m/s] and steering angle [rad].
    Drive(f64, f64),
}

/// A system that this process commands.
pub(super) struct Bench {
    pub(super) feed: Feed,
    order: Order,
    /// When the order was first sent [ns].
    ordered_ns: Option<u64>,
    directive: Directive,
    directed_ns: u64,
    directives: Publisher<Directive>,
    actuations: Publisher<Actuation>,
    heartbeats: Observer<Heartbeat>,
    /// The latest state that each process has reported, by role.
    states: [Option<u32>; shared_types::ROLES],
    stop_word: StopWord,
    shutdown: Shutdown,
    // Dropped last, in this order: the ports above, the bus, then the processes and all files of the system.
    _bus: Bus,
    fleet: Fleet,
}

impl Bench {
    /// Starts the processes and waits until they are connected.
    ///
    /// # Errors
    /// A process that can't be started or does not connect in time, exit code 4; errors of the bus.
    pub(super) fn start(system_id: &str, plan: &Plan, shutdown: Shutdown) -> anyhow::Result<Self> {
        let (domain, lock) = Claim::take_new(system_id)?;
        let stop_word = StopWord::create(domain.run_id(), plan.system.period_ns())?;
        latch_on_crash(&stop_word);
        shutdown.latch_also(&stop_word)?;
        plan.write_settings(&domain, false)?;
        let bus = Bus::create(&domain, plan.system.period_ns())?;
        let all = plan.system.roles();
        let entries: Vec<_> = all.filter(|entry| STARTED.contains(&entry.role())).cloned().collect();
        let (realtime, logs) = (&plan.system.realtime, domain.directory().to_path_buf());
        let fleet = Fleet::new(domain, lock, stop_word.clone(), realtime, &entries, logs, false)?;
        let mut directive =
            Directive { orchestrator_pid: u64::from(std::process::id()), ..Directive::default() };
        directive.header.incarnation = 1;
        for role in Role::ALL {
            let incarnation = incarnation_of(*role);
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        }
        let mut bench = Self {
            feed: Feed::open(&bus)?,
            order: Order::Block,
            ordered_ns: None,
            directive,
            directed_ns: 0,
            directives: Publisher::new(&bus)?,
            actuations: Publisher::new(&bus)?,
            heartbeats: Observer::new(&bus)?,
            states: Default::default(),
            stop_word,
            shutdown,
            _bus: bus,
            fleet,
        };
        bench.start_processes(plan)?;
        Ok(bench)
    }

    fn start_processes(&mut self, plan: &Plan) -> anyhow::Result<()> {
        for role in STARTED {
            if let Event::SpawnFailed { error, .. } = self.fleet.spawn(role, incarnation_of(role), None) {
                return Err(Failure::process(format!("{role} could not be started: {error}")));
            }
        }
        self.wait_for_state(plan, ProcessState::Attached)?;
        self.direct(Phase::Connecting)?;
        self.feed.connect();
        self.wait_for_state(plan, ProcessState::Connected)?;
        STARTED.iter().for_each(|role| self.fleet.connected(incarnation_of(*role)));
        self.direct(Phase::Driving)
    }

    /// Waits until all processes report this state or a later one.
    fn wait_for_state(&mut self, plan: &Plan, state: ProcessState) -> anyhow::Result<()> {
        let limits = plan.system.roles().map(|entry| entry.start_timeout_s);
        let limit_s = limits.fold(0.0, f64::max);
        let missing = |bench: &Self| {
            let has = |role: &Role| bench.states[role.index()].is_some_and(|number| number >= state.wire());
            STARTED.into_iter().find(|role| !has(role))
        };
        if self.until((limit_s * 1e9) as u64, |bench| missing(bench).is_none())? {
            return Ok(());
        }
        let role = missing(self).map_or("a process", Role::name);
        Err(Failure::process(format!("{role} did not report `{state}` within {limit_s} s")))
    }

    /// Observes with blocked wheels from now on for this long [ns].
    pub(super) fn observe(&mut self, duration_ns: u64) -> anyhow::Result<()> {
        // The first scans of processes that just started are late as a rule.
        let start_ns = 2 * self.stop_word.period_ns();
        self.until(start_ns + duration_ns, |bench| bench.feed.observed.odometries >= STARTING_SCANS)?;
        self.feed.observed = Default::default();
        self.until(duration_ns, |_| false).map(|_| ())
    }

    /// Gives the order that each odometry is answered with from now on.
    pub(super) fn order(&mut self, order: Order) {
        (self.order, self.ordered_ns) = (order, None);
    }

    /// When the last order was first sent [ns]; `None` before.
    pub(super) fn ordered_ns(&self) -> Option<u64> {
        self.ordered_ns
    }

    /// Works until something holds, or for `limit_ns`; returns whether it holds.
    ///
    /// # Errors
    /// A signal, a stop by `scanloop stop`, a process that ended, and errors of the bus.
    pub(super) fn until(
        &mut self,
        limit_ns: u64,
        mut done: impl FnMut(&Self) -> bool,
    ) -> anyhow::Result<bool> {
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
            wait_for(&[self.shutdown.descriptor()], left_ns.min(POLL_NS));
        }
    }

    fn turn(&mut self) -> anyhow::Result<()> {
        self.require_life()?;
        if monotonic_ns().saturating_sub(self.directed_ns) >= REPEAT_NS {
            self.publish_directive(false)?;
        }
        let states = &mut self.states;
        self.heartbeats.poll(|beat| {
            if let Ok(role) = Role::try_from(beat.role) {
                states[role.index()] = Some(beat.state);
            }
        })?;
        if self.feed.poll()?
            && let Some(odometry) = self.feed.newest
        {
            self.actuations.publish(&mut actuation(&odometry, self.order), true)?;
            self.ordered_ns.get_or_insert(monotonic_ns());
        }
        Ok(())
    }

    /// Passes while no signal or stop has come and all processes live.
    fn require_life(&mut self) -> anyhow::Result<()> {
        if self.shutdown.requested() {
            return Err(interrupted());
        }
        if !self.stop_word.is_armed() {
            let message = "ended by `scanloop stop`".to_owned();
            return Err(Failure { exit: Exit::NotReached, message }.into());
        }
        match self.fleet.reap().ended.first() {
            Some((role, _, exit)) => {
                let reason = self.fleet.reason_of(*role, *exit);
                Err(Failure::process(format!("the process of the {role} ended: {reason}")))
            }
            None => Ok(()),
        }
    }

    /// Publishes in which phase the system is.
    fn direct(&mut self, phase: Phase) -> anyhow::Result<()> {
        self.directive.phase = phase.wire();
        self.publish_directive(true)
    }

    fn publish_directive(&mut self, wake: bool) -> anyhow::Result<()> {
        self.directed_ns = monotonic_ns();
        self.directive.issued_ns = self.directed_ns;
        Ok(self.directives.publish(&mut self.directive, wake)?)
    }
}

/// One process fills each role; this process is the actuator.
fn incarnation_of(role: Role) -> u32 {
    role.index() as u32 + 1
}

/// The answer to an odometry.
fn actuation(odometry: &Odometry, order: Order) -> Actuation {
    let (kind, reason, velocity, steering) = match order {
        Order::Block => (ActuationKind::Block, BlockReason::Commanded, 0.0, 0.0),
        Order::Drive(velocity, steering) => (ActuationKind::Drive, BlockReason::None, velocity, steering),
    };
    let mut header = odometry.header.answer();
    header.incarnation = incarnation_of(Role::Actuator);
    let now = monotonic_ns();
    for role in [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator] {
        *header.stage_mut(role) =
            StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
    }
    Actuation {
        header,
        kind: kind.wire(),
        reason: reason.wire(),
        answers: 1,
        desired_velocity_mps: velocity,
        desired_steering_rad: steering,
        sent_velocity_mps: velocity,
        sent_steering_rad: steering,
        ..Actuation::default()
    }
}
