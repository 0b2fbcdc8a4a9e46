//! A system of its own for tests and instruments, called benches here: this process is its orchestrator.
//!
//! A bench plays some roles itself and starts processes for the others. [`PrivateSystem`] has what every bench needs: the
//! claim of an id, the files, the bus, the directive, and the states that processes report. It works in
//! [`PrivateSystem::turn`], which a bench calls every few milliseconds, as [`poll_until`] does.
//!
//! A bench is dropped in this order: its processes, its ports, and last the [`PrivateSystem`].

use std::collections::BTreeMap;
use std::ffi::OsString;

use console::exit::Failure;
use runtime::{
    Bus, Domain, HandoverData, Observer, RuntimeError, Shutdown, StopWord, monotonic_ns, write_handover,
};
use shared_types::{
    Actuation, ActuationKind, Authority, Checkpoint, Directive, Header, Heartbeat, Phase, ProcessState, Role,
    StageStamps,
};

use crate::child::{Child, ChildError, Launch};
use crate::child_log::ChildLog;
use crate::directives::Directives;
use crate::environment::environment_of;
use crate::lock::{Claim, SystemLock};

/// An answer that has not come after this time does not come [ns].
pub const ANSWER_NS: u64 = 5_000_000_000;
/// A process that has not reached a state of the start barrier after this time does not reach it [ns].
pub const START_NS: u64 = 30_000_000_000;
/// Longest sleep between two polls; queues last longer at 500 Hz [ns].
pub const POLL_NS: u64 = 5_000_000;

/// A system whose orchestrator is this process.
pub struct PrivateSystem {
    // Dropped in this order: the ports, the bus, and last all files of the system.
    /// The directive and its topic; another publisher may take their place, as after the death of an orchestrator.
    pub directives: Directives,
    /// Whether directives are withheld, as if the orchestrator were gone.
    pub withholds_directives: bool,
    heartbeats: Observer<Heartbeat>,
    /// The latest state that each incarnation has reported.
    states: BTreeMap<u32, u32>,
    /// The bus, with all topics.
    pub bus: Bus,
    /// The directory of the system.
    pub domain: Domain,
    /// Latched when the wheels are to stay blocked.
    pub stop_word: StopWord,
    /// Removes what the ports above used. A [`Fleet`](crate::fleet::Fleet) takes it, and is dropped after this.
    pub lock: Option<SystemLock>,
}

impl PrivateSystem {
    /// Claims the id and makes the system, after what an earlier one has left was removed.
    ///
    /// `write_settings` writes what the processes find in the directory; `incarnation_of` tells who has authority.
    ///
    /// # Errors
    /// As [`Claim::take_new`], those of `write_settings`, and errors of the bus.
    pub fn create(
        system_id: &str,
        period_ns: u64,
        incarnation_of: impl Fn(Role) -> u32,
        write_settings: impl FnOnce(&Domain) -> anyhow::Result<()>,
    ) -> anyhow::Result<Self> {
        let (domain, lock) = Claim::take_new(system_id)?;
        let stop_word = StopWord::create(domain.run_id(), period_ns)?;
        stop_word.hand_down()?;
        write_settings(&domain)?;
        let bus = Bus::create(&domain, period_ns)?;
        let mut directive = Directive::default();
        directive.header.incarnation = 1;
        for role in Role::ALL {
            let incarnation = incarnation_of(*role);
            directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
        }
        Ok(Self {
            directives: Directives::new(&bus, directive)?,
            withholds_directives: false,
            heartbeats: Observer::new(&bus)?,
            states: BTreeMap::new(),
            bus,
            domain,
            stop_word,
            lock: Some(lock),
        })
    }

    /// Publishes in which phase the system is.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn announce(&mut self, phase: Phase) -> Result<(), RuntimeError> {
        self.direct(|directive| directive.phase = phase.wire())
    }

    /// Changes the directive and publishes it at once, unless directives are withheld.
    ///
    /// # Errors
    /// [`RuntimeError::Bus`] when iceoryx2 refuses.
    pub fn direct(&mut self, change: impl FnOnce(&mut Directive)) -> Result<(), RuntimeError> {
        change(&mut self.directives.current);
        self.directives.changed = true;
        self.publish_directive()
    }

    /// Publishes the directive when it is time, and hands all heartbeats that came to `each`.
    ///
    /// # Errors
    /// A signal, exit code 1, and errors of the bus.
    pub fn turn(&mut self, shutdown: &Shutdown, mut each: impl FnMut(&Heartbeat)) -> anyhow::Result<()> {
        if shutdown.requested() {
            return Err(Failure::interrupted());
        }
        self.publish_directive()?;
        let states = &mut self.states;
        self.heartbeats.poll(|beat| {
            states.insert(beat.header.incarnation, beat.state);
            each(beat);
        })?;
        Ok(())
    }

    fn publish_directive(&mut self) -> Result<(), RuntimeError> {
        let now_ns = monotonic_ns();
        if self.withholds_directives || !self.directives.is_due(now_ns) {
            return Ok(());
        }
        self.directives.publish(now_ns)
    }

    /// Whether the process with authority for a role has reported this state or a later one.
    pub fn has_reached(&self, role: Role, state: ProcessState) -> bool {
        self.states.get(&self.incarnation(role)).is_some_and(|latest| *latest >= state.wire())
    }

    /// The incarnation with authority for a role.
    pub fn incarnation(&self, role: Role) -> u32 {
        self.directives.current.authority[role.index()].incarnation
    }

    /// Writes what the process of a role finds that is started next: a state, as a successor does, or none.
    ///
    /// # Errors
    /// [`RuntimeError::File`] when it can't be written.
    pub fn hand_over(&self, role: Role, state: Option<Checkpoint>) -> Result<(), RuntimeError> {
        let data = |checkpoint| HandoverData { checkpoint, ended_ns: 0, actuations: Vec::new(), moved_ns: 0 };
        write_handover(&self.domain, role, state.map(data).as_ref())
    }

    /// Starts the process with authority for a role; `restart` tells it that one ran before.
    ///
    /// # Errors
    /// As [`Child::spawn`].
    pub fn launch(
        &self,
        role: Role,
        command: Vec<OsString>,
        restart: bool,
        log: &ChildLog,
    ) -> Result<Child, ChildError> {
        let incarnation = self.incarnation(role);
        let environment = environment_of(&self.domain, &self.stop_word, role, incarnation, restart);
        Child::spawn(&Launch { command, environment }, log)
    }
}

/// Calls `turn` until it finds something, or for `limit_ns`; `sleep` waits in between, at most as long as it is told.
///
/// # Errors
/// Those of `turn`.
pub fn poll_until<B, T, E>(
    bench: &mut B,
    limit_ns: u64,
    mut turn: impl FnMut(&mut B) -> Result<Option<T>, E>,
    sleep: impl Fn(&B, u64),
) -> Result<Option<T>, E> {
    let end_ns = monotonic_ns().saturating_add(limit_ns);
    loop {
        let (found, left_ns) = (turn(bench)?, end_ns.saturating_sub(monotonic_ns()));
        if found.is_some() || left_ns == 0 {
            return Ok(found);
        }
        sleep(bench, left_ns.min(POLL_NS));
    }
}

/// What a robot is told in answer to a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Block the wheels.
    Block,
    /// Velocity [m/s] and steering angle [rad], both as desired and as sent.
    Drive(f64, f64),
}

impl Order {
    /// The answer of this incarnation to an odometry with that header, as if all stages had worked at `now_ns`.
    pub fn answer(self, odometry: &Header, incarnation: u32, now_ns: u64) -> Actuation {
        let (kind, velocity, steering) = match self {
            Self::Block => (ActuationKind::Block, 0.0, 0.0),
            Self::Drive(velocity, steering) => (ActuationKind::Drive, velocity, steering),
        };
        let mut header = Header { incarnation, ..odometry.answer() };
        for role in [Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator] {
            *header.stage_mut(role) = stamps_at(now_ns);
        }
        Actuation {
            header,
            kind: kind.wire(),
            answers: 1,
            desired_velocity_mps: velocity,
            desired_steering_rad: steering,
            sent_velocity_mps: velocity,
            sent_steering_rad: steering,
            ..Actuation::default()
        }
    }
}

/// Stamps of a stage that took no time.
pub fn stamps_at(now_ns: u64) -> StageStamps {
    StageStamps { woken_ns: now_ns, taken_ns: now_ns, computed_ns: now_ns, published_ns: now_ns }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_finds_its_incarnation_and_state_and_nothing_is_left_at_the_end() {
        let id = format!("private{}", std::process::id() % 1_000_000);
        let written = |domain: &Domain| Ok(domain.folder().write("settings", b"")?);
        let incarnation_of = |role: Role| 40 + role.wire();
        let mut system = PrivateSystem::create(&id, 100_000_000, incarnation_of, written).unwrap();
        let (domain, role) = (system.domain.clone(), Role::Estimator);
        assert!(domain.directory().join("settings").exists());
        system.hand_over(role, None).unwrap();
        let log = ChildLog::open(&domain.directory().join("process.log")).unwrap();
        let script = "echo $SCANLOOP_ROLE $SCANLOOP_INCARNATION $SCANLOOP_RESTART";
        let command = ["sh", "-c", script].map(OsString::from).to_vec();
        let mut child = system.launch(role, command, true, &log).unwrap();
        child.wait_for(std::time::Duration::from_secs(10)).unwrap();
        let printed = format!("; its last log lines: estimator {} 1", system.incarnation(role));
        assert_eq!((system.incarnation(role), log.last_lines_suffix()), (incarnation_of(role), printed));
        system.announce(Phase::Connecting).unwrap();
        assert!(!system.has_reached(role, ProcessState::Attached), "it has reported nothing");
        drop(system);
        assert!(!domain.exists() && !domain.bus_directory().exists());
    }

    #[test]
    fn polling_ends_with_what_is_found_or_after_its_limit() {
        let up_to = |last: u32| {
            let turn = |turns: &mut u32| {
                *turns += 1;
                Ok::<_, ()>((*turns == last).then_some(*turns))
            };
            poll_until(&mut 0, 20_000_000, turn, |_, left_ns| _ = runtime::wait_for(&[], left_ns))
        };
        assert_eq!((up_to(2), up_to(u32::MAX)), (Ok(Some(2)), Ok(None)));
    }

    #[test]
    fn an_order_is_answered_as_if_by_all_stages() {
        let odometry = Header { scan_id: 3, ..Header::default() };
        let [blocks, drives] =
            [Order::Block, Order::Drive(0.5, 0.1)].map(|order| order.answer(&odometry, 9, 70));
        assert_eq!((blocks.kind, drives.kind), (ActuationKind::Block.wire(), ActuationKind::Drive.wire()));
        assert_eq!((drives.header.scan_id, drives.header.incarnation), (3, 9));
        assert_eq!((drives.sent_velocity_mps, drives.desired_steering_rad), (0.5, 0.1));
        assert_eq!(drives.header.stage(Role::Controller).published_ns, 70);
    }
}
