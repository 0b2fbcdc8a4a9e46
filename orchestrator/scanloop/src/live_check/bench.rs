//! A system without a controller: robot, estimator and obstacle detector run, and this process commands the wheels.
//!
//! It answers each odometry with an actuation: to block, unless a check orders a drive. When it stops answering, the
//! actuations end and the robot's dead man blocks the wheels. Dropping the bench blocks the wheels, then ends all
//! processes.

use anyhow::Context;
use console::exit::{Exit, Failure};
use plan::Plan;
use runtime::{Publisher, Shutdown, latch_on_crash, monotonic_ns, wait_for};
use shared_types::{Actuation, BlockReason, Phase, ProcessState, Role};
use supervision::fleet::Fleet;
use supervision::private_system::{Order, PrivateSystem, poll_until};
use supervision::supervisor::Event;

use super::feed::Feed;

/// Scans before the observation.
const STARTING_SCANS: usize = 5;
/// The roles that are started.
const STARTED: [Role; 3] = [Role::Robot, Role::Estimator, Role::Obstacles];

/// A system that this process commands.
pub(super) struct Bench {
    pub(super) feed: Feed,
    order: Order,
    /// When the order was first sent [ns].
    ordered_ns: Option<u64>,
    actuations: Publisher<Actuation>,
    shutdown: Shutdown,
    // Dropped last, in this order: the ports above, the bus, then the processes and all files of the system.
    system: PrivateSystem,
    fleet: Fleet,
}

impl Bench {
    /// Starts the processes and waits until they are connected.
    ///
    /// # Errors
    /// A process that can't be started or does not connect in time, exit code 4; errors of the bus.
    pub(super) fn start(system_id: &str, plan: &Plan, shutdown: Shutdown) -> anyhow::Result<Self> {
        let write_settings = |domain: &_| plan.write_settings(domain, false);
        let period_ns = plan.system.period_ns();
        let mut system = PrivateSystem::create(system_id, period_ns, incarnation_of, write_settings)?;
        latch_on_crash(&system.stop_word);
        shutdown.latch_also(&system.stop_word)?;
        let lock = system.lock.take().context("the lock of the system")?;
        let all = plan.system.roles();
        let entries: Vec<_> = all.filter(|entry| STARTED.contains(&entry.role())).cloned().collect();
        let (domain, stop_word) = (system.domain.clone(), system.stop_word.clone());
        let (realtime, logs) = (&plan.system.realtime, domain.directory().to_path_buf());
        let fleet = Fleet::new(domain, lock, stop_word, realtime, &entries, logs, false)?;
        let mut bench = Self {
            feed: Feed::open(&system.bus, &plan.system.vehicle)?,
            order: Order::Block,
            ordered_ns: None,
            actuations: Publisher::new(&system.bus)?,
            shutdown,
            system,
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
        self.system.announce(Phase::Connecting)?;
        self.feed.connect();
        self.wait_for_state(plan, ProcessState::Connected)?;
        STARTED.iter().for_each(|role| self.fleet.connected(incarnation_of(*role)));
        Ok(self.system.announce(Phase::Driving)?)
    }

    /// Waits until all processes report this state or a later one.
    fn wait_for_state(&mut self, plan: &Plan, state: ProcessState) -> anyhow::Result<()> {
        let limits = plan.system.roles().map(|entry| entry.start_timeout_s);
        let limit_s = limits.fold(0.0, f64::max);
        let missing = |bench: &Self| STARTED.into_iter().find(|role| !bench.system.has_reached(*role, state));
        if self.until((limit_s * 1e9) as u64, |bench| missing(bench).is_none())? {
            return Ok(());
        }
        let role = missing(self).map_or("a process", Role::name);
        Err(Failure::process(format!("{role} did not report `{state}` within {limit_s} s")))
    }

    /// Observes with blocked wheels from now on for this long [ns].
    pub(super) fn observe(&mut self, duration_ns: u64) -> anyhow::Result<()> {
        // The first scans of processes that just started are late as a rule.
        let start_ns = 2 * self.system.stop_word.period_ns();
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
        let turn = |bench: &mut Self| bench.turn().map(|()| done(bench).then_some(()));
        let sleep = |bench: &Self, left_ns| _ = wait_for(&[bench.shutdown.descriptor()], left_ns);
        Ok(poll_until(self, limit_ns, turn, sleep)?.is_some())
    }

    fn turn(&mut self) -> anyhow::Result<()> {
        self.system.turn(&self.shutdown, |_| {})?;
        self.require_life()?;
        if self.feed.poll()?
            && let Some(odometry) = self.feed.newest
        {
            let now_ns = monotonic_ns();
            let reason = if self.order == Order::Block { BlockReason::Commanded } else { BlockReason::None };
            let answer = self.order.answer(&odometry.header, incarnation_of(Role::Actuator), now_ns);
            self.actuations.publish(&mut Actuation { reason: reason.wire(), ..answer }, true)?;
            self.ordered_ns.get_or_insert(monotonic_ns());
        }
        Ok(())
    }

    /// Passes while no stop has come and all processes live.
    fn require_life(&mut self) -> anyhow::Result<()> {
        // A signal latches the stop word too; the next turn tells of it.
        if !self.system.stop_word.is_armed() && !self.shutdown.requested() {
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
}

/// One process fills each role; this process is the actuator.
fn incarnation_of(role: Role) -> u32 {
    role.index() as u32 + 1
}
