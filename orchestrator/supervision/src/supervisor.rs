//! Keeps the processes of a run alive: a state machine that decides and does nothing.
//!
//! The caller passes each event with its time to [`Supervisor::handle`], which returns the actions to carry out.
//! There is no clock, no process and no bus in here, so a test can try each sequence of events.
//!
//! * **Start.** All processes are asked for at once, the actuator first and the robot last, so that usually
//!   the wheels can be blocked before they can turn. The phase is `Starting` until all are
//!   attached, `Connecting` until all are connected, then `Driving`; it never goes back. A process restarted
//!   while driving attaches and connects on its own.
//! * **Death.** Exit, then clean-up on the bus, then a pause, then the next incarnation; never another order,
//!   because a dead node holds its ports until it is cleaned up. The first death of a ready process costs no
//!   pause, later ones double it; a healthy run forgets them. Too many deaths before the first valid output, or
//!   within a minute, end the run. So does any death of the robot, and in lock-step any death at all, where a gap
//!   would change the result.
//! * **Hang.** A connected process that makes no progress while driving is killed, then treated as dead. So is one
//!   that has all its inputs and still no first output when the start timeout is over. In the other phases
//!   processes wait for each other, and only the start timeout counts.
//! * **Adoption.** The caller reports the processes of an orchestrator that died one by one; then the run continues in
//!   the phase in which it was. A process that ended meanwhile is treated as dead.
//! * **Swap.** A swap starts its process itself, under a number of [`Supervisor::next_incarnation`], and reports
//!   it when it has taken over ([`Event::Replaced`]); until then the supervisor knows the old one only.
//! * **Failure.** After a failure no process is started any more. While the loop drives, the caller is given time to
//!   bring the robot to rest before it asks for the stop.
//! * **Stop.** Three waves: controller, obstacles and estimator; when they are gone the actuator, which blocks
//!   the wheels before it ends; then the robot, which receives that. In each wave TERM, grace, KILL.
//!
//! Incarnations are unique and strictly increasing over all roles, so an event about a dead incarnation is
//! recognised and ignored. Assumptions, and where they fail: times do not go backwards (an earlier time only
//! delays what is due); the caller sends [`Event::Tick`] after all other events at hand, else a process may be
//! judged before an event that is still in the queue. Only time in which the caller watched counts as silence: a gap
//! of more than a third of the hang limit between two events, as when the whole machine stood still, does not count.
//! A process that could run but gets no processor is not hung, for ten limits at most.

mod death;
mod due;
mod event;
mod exit;
mod policy;
#[cfg(test)]
mod rules;
mod slot;
#[cfg(test)]
mod tests;
mod turn;
#[cfg(test)]
mod world;

pub use event::{Action, Event, Severity};
pub use exit::ProcessExit;
pub use policy::{MIN_HANG_AFTER_MS, ProcessPolicy, Restart};
pub use slot::{ProcessView, VisibleState};

use shared_types::{Phase, ProcessState, Role};

use policy::nanoseconds;
use slot::{Alive, EndReason, Life, Refused, Slot};
use turn::Turn;

/// A process in lock-step is called hung after this time at the earliest [ms].
const LOCKSTEP_HANG_AFTER_MS: u64 = 5_000;

/// Decides which process is started, stopped, killed and given authority.
#[derive(Debug, Clone)]
pub struct Supervisor {
    /// In the order in which they are started.
    slots: Vec<Slot>,
    lockstep: bool,
    started: bool,
    phase: Phase,
    last_incarnation: u32,
    last_event_ns: Option<u64>,
    failure: Option<(Role, String)>,
    /// Until when a run that failed while it drove waits for [`Event::StopRequested`].
    halting_until_ns: Option<u64>,
    all_stopped: bool,
}

impl Supervisor {
    /// A supervisor of one process per policy, of which the last counts where a role occurs twice.
    pub fn new(policies: Vec<ProcessPolicy>) -> Self {
        let mut slots: Vec<Slot> = Vec::with_capacity(policies.len());
        for policy in policies {
            slots.retain(|slot| slot.policy.role != policy.role);
            slots.push(Slot::new(policy));
        }
        slots.sort_by_key(|slot| start_rank(slot.policy.role));
        Self {
            slots,
            lockstep: false,
            started: false,
            phase: Phase::Starting,
            last_incarnation: 0,
            last_event_ns: None,
            failure: None,
            halting_until_ns: None,
            all_stopped: false,
        }
    }

    /// The same for a run in lock-step, where any death ends the run, and where the period does not limit how long
    /// a process may take: a hang is found after seconds.
    #[must_use]
    pub fn in_lockstep(mut self) -> Self {
        for slot in &mut self.slots {
            slot.policy.hang_after_ms = slot.policy.hang_after_ms.max(LOCKSTEP_HANG_AFTER_MS);
        }
        self.lockstep = true;
        self
    }

    /// What the whole system is doing.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the run was ended and no process lives any more.
    pub fn is_finished(&self) -> bool {
        self.all_stopped
    }

    /// The state of each process, in the order in which they are started.
    pub fn processes(&self) -> impl Iterator<Item = ProcessView> {
        self.slots.iter().map(Slot::view)
    }

    /// The state of the process of a role.
    pub fn process(&self, role: Role) -> Option<ProcessView> {
        self.slots.iter().find(|slot| slot.policy.role == role).map(Slot::view)
    }

    /// Processes that have made no progress for half of the time after which they are hung: role, incarnation, and
    /// whether the whole time is over. Report those of the latter that get no processor with [`Event::Starved`].
    pub fn suspects(&self, now_ns: u64) -> impl Iterator<Item = (Role, u32, bool)> {
        let watched = self.slots.iter().filter(|_| self.phase == Phase::Driving);
        watched.filter_map(move |slot| {
            let deadline_ns = slot.hang_deadline_ns()?;
            let half_ns = nanoseconds(slot.policy.hang_after_ms) / 2;
            let suspected = deadline_ns <= now_ns.saturating_add(half_ns);
            suspected.then_some((slot.policy.role, slot.incarnation, deadline_ns <= now_ns))
        })
    }

    /// What is to be done, in this order, now that `event` has happened at `now_ns`.
    pub fn handle(&mut self, now_ns: u64, event: Event) -> Vec<Action> {
        let mut turn = Turn { now_ns, actions: Vec::new() };
        self.forgive_own_stall(now_ns);
        match event {
            Event::Start => self.start(&mut turn),
            Event::Adopted { role, pid, incarnation, restarts } => {
                self.adopted(now_ns, role, pid, incarnation, restarts);
            }
            Event::Resume { phase, last_incarnation } => self.resume(&mut turn, phase, last_incarnation),
            Event::Spawned { role, pid, incarnation } => self.spawned(&mut turn, role, pid, incarnation),
            Event::SpawnFailed { role, error } => self.spawn_failed(&mut turn, role, error),
            Event::StateReported { role, incarnation, state } => {
                self.state_reported(&mut turn, role, incarnation, state);
            }
            Event::Progress { role, incarnation } => {
                if let Some(alive) = self.slot(role).and_then(|slot| slot.alive(incarnation)) {
                    alive.progress_ns = now_ns;
                }
            }
            Event::Starved { role, incarnation } => self.starved(now_ns, role, incarnation),
            Event::DeviceReported { role, incarnation, text } => {
                if let Some(slot) = self.slot(role).filter(|slot| slot.incarnation == incarnation) {
                    slot.device = Some(text);
                }
            }
            Event::Refused { role, incarnation, reader, reason } => {
                self.refused(&mut turn, role, incarnation, Refused { reader, reason });
            }
            Event::InputsLate { reader } => self.forgive_late_inputs(reader),
            Event::Exited { role, incarnation, exit } => self.exited(&mut turn, role, incarnation, exit),
            Event::Tick => self.tick(&mut turn),
            Event::StopRequested => self.stop(&mut turn),
            Event::RestartRequested { role } => self.restart_requested(&mut turn, role),
            Event::Replaced { role, pid, incarnation, is_restart } => {
                self.replaced(&mut turn, role, pid, incarnation, is_restart);
            }
            Event::CleanedUp { role } => self.cleaned_up(&mut turn, role),
        }
        self.watch_first_outputs(&turn);
        turn.actions
    }

    /// The largest number given to a process so far.
    pub fn last_incarnation(&self) -> u32 {
        self.last_incarnation
    }

    /// Whether no process is started any more.
    fn is_ending(&self) -> bool {
        self.phase == Phase::Stopping || self.halting_until_ns.is_some()
    }

    /// A number for a process that the caller starts itself and reports with [`Event::Replaced`].
    pub fn next_incarnation(&mut self) -> u32 {
        self.last_incarnation += 1;
        self.last_incarnation
    }

    fn start(&mut self, turn: &mut Turn) {
        if self.started || self.phase == Phase::Stopping {
            return;
        }
        self.started = true;
        turn.push(Action::Announce(Phase::Starting));
        (0..self.slots.len()).for_each(|index| self.spawn(turn, index));
    }

    fn adopted(&mut self, now_ns: u64, role: Role, pid: Option<u32>, incarnation: u32, restarts: u32) {
        let started = self.started || self.phase == Phase::Stopping;
        let Some(slot) = self.slot(role) else { return };
        if started || slot.life != Life::Idle {
            return;
        }
        (slot.incarnation, slot.restarts) = (incarnation, restarts);
        if let Some(pid) = pid {
            slot.life = Life::Alive(Alive::new(pid, now_ns));
        }
    }

    fn resume(&mut self, turn: &mut Turn, phase: Phase, last_incarnation: u32) {
        if self.started || self.phase == Phase::Stopping {
            return;
        }
        self.started = true;
        self.last_incarnation =
            self.slots.iter().map(|slot| slot.incarnation).fold(last_incarnation, u32::max);
        self.phase = phase.min(Phase::Driving);
        if phase == Phase::Stopping {
            return self.stop(turn);
        }
        for slot in &mut self.slots {
            if let Life::Alive(alive) = &mut slot.life {
                // A process that hangs reports nothing, not even its state: it is watched as one that drives.
                match phase {
                    Phase::Driving => alive.reached = Some(ProcessState::Connected),
                    _ => alive.start_deadline_ns = Some(turn.in_ms(slot.policy.start_timeout_ms)),
                }
            }
        }
        for index in 0..self.slots.len() {
            let (role, incarnation) = (self.slots[index].policy.role, self.slots[index].incarnation);
            if self.phase == Phase::Stopping || self.slots[index].life != Life::Idle {
                continue;
            }
            if incarnation == 0 {
                self.spawn(turn, index);
            } else if self.lockstep || self.slots[index].policy.effective_restart() == Restart::Never {
                self.fail(turn, role, "ended while no orchestrator watched".to_owned());
            } else {
                turn.warn(format!("{role} ended while no orchestrator watched; restarted"));
                self.slots[index].life = Life::CleaningUp { due_ns: turn.now_ns };
                turn.push(Action::CleanUp { role });
            }
        }
    }

    /// Asks for the next incarnation. Authority goes first: its first output is to count.
    fn spawn(&mut self, turn: &mut Turn, index: usize) {
        self.last_incarnation += 1;
        let incarnation = self.last_incarnation;
        let slot = &mut self.slots[index];
        let role = slot.policy.role;
        slot.restarts += u32::from(slot.incarnation != 0);
        slot.incarnation = incarnation;
        (slot.refused, slot.device) = (None, None);
        slot.life = Life::Spawning;
        turn.push(Action::Grant { role, incarnation });
        turn.push(Action::Spawn { role, incarnation });
    }

    fn spawned(&mut self, turn: &mut Turn, role: Role, pid: u32, incarnation: u32) {
        let ending = self.is_ending();
        let Some(slot) = self.slot(role) else { return };
        if slot.life != Life::Spawning || slot.incarnation != incarnation {
            return;
        }
        let deadline_ns = turn.in_ms(slot.policy.start_timeout_ms);
        let start_deadline_ns = (!ending).then_some(deadline_ns);
        slot.life = Life::Alive(Alive { start_deadline_ns, ..Alive::new(pid, turn.now_ns) });
        turn.info(format!("{role} started as process {pid}, incarnation {incarnation}"));
        self.continue_stop(turn);
    }

    fn state_reported(&mut self, turn: &mut Turn, role: Role, incarnation: u32, state: ProcessState) {
        let phase = self.phase;
        let Some(alive) = self.slot(role).and_then(|slot| slot.alive(incarnation)) else { return };
        // Heartbeats repeat the state, and a late one may carry an earlier state: only a later one counts.
        if state == ProcessState::Ending || alive.reached >= Some(state) {
            return;
        }
        alive.reached = Some(state);
        alive.progress_ns = turn.now_ns;
        // A process that is attached in the first phase waits for the others, not for itself.
        if state >= ProcessState::Connected || phase == Phase::Starting {
            alive.start_deadline_ns = None;
        }
        if state == ProcessState::Ready {
            alive.ready_ns = Some(turn.now_ns);
            turn.info(format!("{role} is ready, incarnation {incarnation}"));
        }
        self.advance_phase(turn);
    }

    fn advance_phase(&mut self, turn: &mut Turn) {
        let all_reached = |slots: &[Slot], state| slots.iter().all(|slot| slot.has_reached(state));
        if self.phase == Phase::Starting && all_reached(&self.slots, ProcessState::Attached) {
            self.phase = Phase::Connecting;
            turn.push(Action::Announce(Phase::Connecting));
            for slot in &mut self.slots {
                if let Life::Alive(alive) = &mut slot.life
                    && alive.reached < Some(ProcessState::Connected)
                {
                    alive.start_deadline_ns = Some(turn.in_ms(slot.policy.start_timeout_ms));
                }
            }
        }
        if self.phase == Phase::Connecting && all_reached(&self.slots, ProcessState::Connected) {
            self.phase = Phase::Driving;
            turn.push(Action::Announce(Phase::Driving));
            for slot in &mut self.slots {
                if let Life::Alive(alive) = &mut slot.life {
                    alive.progress_ns = turn.now_ns;
                }
            }
        }
    }

    /// The state and the deaths of the process before do not matter any more.
    fn replaced(&mut self, turn: &mut Turn, role: Role, pid: u32, incarnation: u32, is_restart: bool) {
        let finished = self.all_stopped;
        let Some(slot) = self.slot(role) else { return };
        if finished || incarnation <= slot.incarnation {
            return turn.warn(format!("{role} is not replaced by incarnation {incarnation}"));
        }
        slot.incarnation = incarnation;
        (slot.refused, slot.device) = (None, None);
        if is_restart {
            slot.restarts += 1;
        } else {
            slot.forget_deaths();
        }
        slot.life = Life::Alive(Alive {
            reached: Some(ProcessState::Ready),
            ready_ns: Some(turn.now_ns),
            ..Alive::new(pid, turn.now_ns)
        });
        turn.info(format!("{role} is filled by process {pid}, incarnation {incarnation}"));
        self.continue_stop(turn);
    }

    fn restart_requested(&mut self, turn: &mut Turn, role: Role) {
        let (stopping, lockstep) = (self.is_ending(), self.lockstep);
        let Some(index) = self.index(role) else { return };
        let slot = &mut self.slots[index];
        if stopping || lockstep || role == Role::Robot {
            let why = if stopping { "the run ends" } else { "its end would be the end of the run" };
            return turn.warn(format!("{role} is not restarted: {why}"));
        }
        match &mut slot.life {
            Life::Alive(alive) if alive.ending.is_none() => {
                alive.ending = Some(EndReason::Restart);
                alive.start_deadline_ns = None;
                alive.kill_ns = Some(turn.in_ms(slot.policy.grace_ms));
                turn.push(Action::Terminate { role });
            }
            Life::CleaningUp { due_ns } => *due_ns = turn.now_ns,
            Life::Waiting { .. } => self.spawn(turn, index),
            // It is starting, or ending to be started again, or there is no run.
            _ => {}
        }
    }

    fn index(&self, role: Role) -> Option<usize> {
        self.slots.iter().position(|slot| slot.policy.role == role)
    }

    fn slot(&mut self, role: Role) -> Option<&mut Slot> {
        self.slots.iter_mut().find(|slot| slot.policy.role == role)
    }
}

/// Against the flow of data: readers are asked for before writers.
const fn start_rank(role: Role) -> u8 {
    match role {
        Role::Actuator => 0,
        Role::Controller => 1,
        Role::Obstacles => 2,
        Role::Estimator => 3,
        Role::Robot => 4,
    }
}
