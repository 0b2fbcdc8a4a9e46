//! A simulated world for the tests of the supervisor: it carries out its actions, and fails on those that must never come.

use shared_types::{Phase, ProcessState, Role};

use super::due::feeders;
use super::policy::nanoseconds;
use super::slot::{Life, Slot};
use super::{Action, Event, ProcessExit, ProcessPolicy, Severity, Supervisor, VisibleState};

/// The state of one role in the world.
#[derive(Debug, Clone, Default)]
pub(super) struct Place {
    /// Asked for, not answered.
    pub(super) pending: Option<u32>,
    /// The living process.
    pub(super) process: Option<Process>,
    /// A dead process was not cleaned up yet.
    dirty: bool,
    /// Clean-up was asked for and is not done.
    pub(super) cleaning: bool,
    granted: u32,
    pub(super) spawns: u32,
    /// Deaths before readiness without a healthy run between.
    dead_starts: u32,
    /// Times of all deaths after readiness that were not requested [ns].
    deaths: Vec<u64>,
    /// Since when it has had all its inputs and no output [ns].
    mute_since_ns: Option<u64>,
}

/// A living process.
#[derive(Debug, Clone)]
pub(super) struct Process {
    pub(super) incarnation: u32,
    reached: Option<ProcessState>,
    ready_ns: Option<u64>,
    pub(super) terminated_ns: Option<u64>,
    pub(super) killed: bool,
    /// The reader that dropped its outputs.
    refused: Option<Role>,
}

/// The supervisor and all it acts on.
#[derive(Debug, Clone)]
pub(super) struct World {
    pub(super) supervisor: Supervisor,
    policies: Vec<ProcessPolicy>,
    pub(super) now_ns: u64,
    places: [Place; shared_types::ROLES],
    last_incarnation: u32,
    pub(super) stopping: bool,
    pub(super) all_stopped: bool,
    pub(super) failure: Option<(Role, String)>,
    pub(super) phases: Vec<Phase>,
    lockstep: bool,
    /// All actions but log lines, for tests of their order.
    pub(super) actions: Vec<Action>,
    /// The log lines.
    pub(super) log: Vec<(Severity, String)>,
}

impl Process {
    fn new(incarnation: u32) -> Self {
        Self { incarnation, reached: None, ready_ns: None, terminated_ns: None, killed: false, refused: None }
    }

    fn is_asked_to_end(&self) -> bool {
        self.killed || self.terminated_ns.is_some()
    }
}

/// The state of a role that an adopting orchestrator finds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Found {
    Alive,
    Gone,
    NeverStarted,
}

impl World {
    /// A world whose orchestrator died in `phase`; all incarnations so far are below 100.
    pub(super) fn adopted(
        policies: Vec<ProcessPolicy>,
        lockstep: bool,
        phase: Phase,
        found: impl Fn(Role) -> Found,
    ) -> Self {
        let mut world = Self::new(policies, lockstep);
        world.last_incarnation = 99;
        world.phases = vec![phase.min(Phase::Driving)];
        for (role, incarnation) in world.roles().into_iter().zip(10..) {
            let place = &mut world.places[role.index()];
            let pid = match found(role) {
                Found::NeverStarted => continue,
                Found::Gone => {
                    place.dirty = true;
                    None
                }
                Found::Alive => {
                    let reached = (phase == Phase::Driving).then_some(ProcessState::Connected);
                    place.process = Some(Process { reached, ..Process::new(incarnation) });
                    Some(1000 + incarnation)
                }
            };
            (place.granted, place.spawns) = (incarnation, 1);
            world.send(Event::Adopted { role, pid, incarnation, restarts: 2 });
        }
        world.send(Event::Resume { phase, last_incarnation: 99 });
        world
    }

    pub(super) fn new(policies: Vec<ProcessPolicy>, lockstep: bool) -> Self {
        let supervisor = Supervisor::new(policies.clone());
        Self {
            supervisor: if lockstep { supervisor.in_lockstep() } else { supervisor },
            policies,
            now_ns: 1_000_000_000,
            places: Default::default(),
            last_incarnation: 0,
            stopping: false,
            all_stopped: false,
            failure: None,
            phases: Vec::new(),
            lockstep,
            actions: Vec::new(),
            log: Vec::new(),
        }
    }

    /// All five roles at 10 Hz, started and driving.
    pub(super) fn driving() -> Self {
        let mut world = Self::new(policies(), false);
        world.send(Event::Start);
        world.bring_up();
        assert_eq!(world.phases, [Phase::Starting, Phase::Connecting, Phase::Driving]);
        world.actions.clear();
        world
    }

    pub(super) fn place(&self, role: Role) -> &Place {
        &self.places[role.index()]
    }

    pub(super) fn roles(&self) -> Vec<Role> {
        self.policies.iter().map(|policy| policy.role).collect()
    }

    pub(super) fn incarnation(&self, role: Role) -> u32 {
        self.place(role).process.as_ref().map_or(0, |process| process.incarnation)
    }

    /// Sends an event to the supervisor, checks its actions and carries them out.
    pub(super) fn send(&mut self, event: Event) {
        if event == Event::StopRequested {
            self.stopping = true;
        }
        let ticked = event == Event::Tick;
        self.watch();
        self.forgive_first_outputs();
        for action in self.supervisor.handle(self.now_ns, event) {
            self.take(action);
        }
        self.forgive_first_outputs();
        if ticked {
            self.check_kills();
        }
    }

    /// The caller watches also while nothing happens; all processes make progress meanwhile.
    fn watch(&mut self) {
        while let Some(then_ns) = self.supervisor.last_event_ns.map(|last_ns| last_ns + nanoseconds(100))
            && then_ns < self.now_ns
        {
            for (role, place) in Role::ALL.iter().zip(&self.places) {
                let incarnation = place.process.as_ref().map_or(0, |process| process.incarnation);
                self.supervisor.handle(then_ns, Event::Progress { role: *role, incarnation });
            }
        }
    }

    /// The caller is stopped for a time, and its processes with it; what it decides when it is back.
    pub(super) fn stall(&mut self, milliseconds: u64) -> Vec<Action> {
        self.now_ns += nanoseconds(milliseconds);
        self.supervisor.handle(self.now_ns, Event::Tick)
    }

    pub(super) fn answer(&mut self, role: Role, started: bool) {
        let place = &mut self.places[role.index()];
        let Some(incarnation) = place.pending.take() else { return };
        if started {
            place.process = Some(Process::new(incarnation));
            self.send(Event::Spawned { role, pid: 1000 + incarnation, incarnation });
        } else {
            place.dead_starts += 1;
            self.send(Event::SpawnFailed { role, error: format!("command `{role}` was not found") });
            self.check_lockstep();
        }
    }

    pub(super) fn report(&mut self, role: Role, state: ProcessState) {
        let now_ns = self.now_ns;
        let Some(process) = &mut self.places[role.index()].process else { return };
        let is_first = state == ProcessState::Ready && process.ready_ns.is_none();
        if state == ProcessState::Ready {
            process.ready_ns.get_or_insert(now_ns);
        }
        if state != ProcessState::Ending {
            process.reached = process.reached.max(Some(state));
        }
        let incarnation = process.incarnation;
        if is_first {
            // From now on only outputs that are dropped count against it.
            self.places[role.index()].mute_since_ns = None;
        }
        self.send(Event::StateReported { role, incarnation, state });
    }

    /// A reader dropped what a process wrote.
    pub(super) fn refuse(&mut self, role: Role, reader: Role) {
        let Some(process) = &mut self.places[role.index()].process else { return };
        let incarnation = process.incarnation;
        if !self.stopping {
            process.refused = Some(reader);
        }
        let reason = format!("its output was dropped by {reader}: not finite");
        self.send(Event::Refused { role, incarnation, reader, reason });
    }

    /// A reader drops its inputs because of their age.
    pub(super) fn inputs_late(&mut self, reader: Role) {
        self.places[reader.index()].mute_since_ns = None;
        self.send(Event::InputsLate { reader });
    }

    pub(super) fn progress(&mut self, role: Role) {
        let Some(process) = &self.place(role).process else { return };
        let incarnation = process.incarnation;
        self.send(Event::Progress { role, incarnation });
    }

    pub(super) fn die(&mut self, role: Role, exit: ProcessExit) {
        let healthy_ns = nanoseconds(self.policy(role).healthy_after_ms);
        let place = &mut self.places[role.index()];
        let Some(process) = place.process.take() else { return };
        place.dirty = true;
        let restart_asked = process.terminated_ns.is_some();
        // A process that was killed because its outputs were dropped did not start well, one that hung did.
        let is_unclear = process.killed && process.refused.is_some();
        if !restart_asked && !is_unclear && process.ready_ns.is_some() {
            place.deaths.push(self.now_ns);
        }
        match process.ready_ns {
            _ if is_unclear => {}
            Some(ready_ns) if self.now_ns - ready_ns >= healthy_ns && !restart_asked => place.dead_starts = 0,
            Some(_) => {}
            // A process that was asked to end did not fail to start.
            None => place.dead_starts += u32::from(!restart_asked),
        }
        self.send(Event::Exited { role, incarnation: process.incarnation, exit });
        self.check_lockstep();
    }

    pub(super) fn clean(&mut self, role: Role) {
        let place = &mut self.places[role.index()];
        if std::mem::take(&mut place.cleaning) {
            place.dirty = false;
            self.send(Event::CleanedUp { role });
        }
    }

    pub(super) fn advance(&mut self, milliseconds: u64) {
        self.now_ns += nanoseconds(milliseconds);
    }

    /// All processes behave well until the loop drives.
    pub(super) fn bring_up(&mut self) {
        for _ in 0..100 {
            for role in self.roles() {
                self.clean(role);
                self.answer(role, true);
                self.progress(role);
                self.report(role, ProcessState::Attached);
                if self.supervisor.phase() >= Phase::Connecting {
                    self.report(role, ProcessState::Connected);
                }
                if self.supervisor.phase() == Phase::Driving {
                    self.report(role, ProcessState::Ready);
                }
                if let Some(Process { terminated_ns: Some(_), .. } | Process { killed: true, .. }) =
                    self.place(role).process
                {
                    self.die(role, ProcessExit::Signal(15));
                }
            }
            let all_ready = self.supervisor.processes().all(|view| view.state == VisibleState::Ready);
            if self.stopping || all_ready {
                return;
            }
            if let Some(deadline_ns) = self.supervisor.next_deadline() {
                self.now_ns = self.now_ns.max(deadline_ns.min(self.now_ns + nanoseconds(50)));
            }
            self.send(Event::Tick);
        }
        panic!("the loop never drove: {:?}", self.supervisor.processes().collect::<Vec<_>>());
    }

    /// Ends the run; processes end when asked, or only when killed.
    pub(super) fn bring_down(&mut self, obedient: bool) {
        self.send(Event::StopRequested);
        for _ in 0..100 {
            for role in self.roles() {
                self.answer(role, true);
                let place = self.place(role);
                let ends =
                    |process: &Process| process.killed || (obedient && process.terminated_ns.is_some());
                if place.process.as_ref().is_some_and(ends) {
                    self.die(role, ProcessExit::Signal(15));
                }
            }
            if self.all_stopped {
                assert_eq!(self.supervisor.next_deadline(), None);
                return;
            }
            if let Some(deadline_ns) = self.supervisor.next_deadline() {
                self.now_ns = self.now_ns.max(deadline_ns);
                self.send(Event::Tick);
            }
        }
        panic!("the run never ended: {:?}", self.supervisor.processes().collect::<Vec<_>>());
    }

    fn policy(&self, role: Role) -> ProcessPolicy {
        *self.policies.iter().find(|policy| policy.role == role).unwrap()
    }

    fn take(&mut self, action: Action) {
        let lives = self.places.iter().any(|place| place.process.is_some() || place.pending.is_some());
        assert!(!self.all_stopped || matches!(action, Action::Log(..)), "{action:?} after the end");
        match &action {
            Action::Log(severity, text) => self.log.push((*severity, text.clone())),
            other => self.actions.push(other.clone()),
        }
        match action {
            Action::Grant { role, incarnation } => {
                assert!(incarnation > self.last_incarnation, "incarnations increase over all roles");
                self.places[role.index()].granted = incarnation;
            }
            Action::Spawn { role, incarnation } => {
                let ProcessPolicy { start_limit: limit, restart_limit, restart_window_ms, .. } =
                    self.policy(role);
                let now_ns = self.now_ns;
                let place = &mut self.places[role.index()];
                let recent = |then_ns: &&u64| now_ns - **then_ns < nanoseconds(restart_window_ms);
                let deaths = place.deaths.iter().filter(recent).count();
                assert!(deaths <= restart_limit as usize, "{role} is restarted too often");
                assert!(!self.stopping, "{role} is started although the run ends");
                assert!(place.process.is_none() && place.pending.is_none(), "two incarnations of {role}");
                assert!(!place.dirty, "{role} is started before its remains are cleaned up");
                assert_eq!(place.granted, incarnation, "authority goes with the process");
                assert!(incarnation > self.last_incarnation);
                assert!(place.dead_starts < limit, "{role} is started beyond its limit");
                assert!(
                    place.spawns == 0 || (role != Role::Robot && !self.lockstep),
                    "{role} is started again"
                );
                self.last_incarnation = incarnation;
                place.pending = Some(incarnation);
                place.spawns += 1;
            }
            Action::Terminate { role } => {
                let now_ns = self.now_ns;
                let process =
                    self.places[role.index()].process.as_mut().expect("a process that can be asked to end");
                assert_eq!(process.terminated_ns, None, "{role} is asked to end twice");
                assert!(!process.killed, "{role} is asked to end after its kill");
                process.terminated_ns = Some(now_ns);
            }
            Action::Kill { role } => {
                self.places[role.index()].process.as_mut().expect("a process that can be killed").killed =
                    true;
            }
            Action::CleanUp { role } => {
                let place = &mut self.places[role.index()];
                assert!(place.process.is_none() && place.dirty, "{role} is cleaned up without a death");
                place.cleaning = true;
            }
            Action::Announce(phase) => {
                assert!(self.phases.last().is_none_or(|last| *last < phase), "phases never go back");
                self.stopping |= phase == Phase::Stopping;
                self.phases.push(phase);
            }
            Action::RunFailed { role, reason } => {
                assert_eq!(self.failure, None, "a run fails once");
                self.failure = Some((role, reason));
                self.stopping = true;
            }
            Action::AllStopped => {
                assert!(!lives && self.stopping, "all have stopped");
                self.all_stopped = true;
            }
            Action::Log(..) => {}
        }
    }

    /// A process that was asked to end and lives after the grace is killed now at the latest.
    fn check_kills(&self) {
        for policy in &self.policies {
            if let Some(Process { terminated_ns: Some(asked_ns), killed, .. }) =
                self.place(policy.role).process
            {
                let over = asked_ns + nanoseconds(policy.grace_ms) <= self.now_ns;
                assert!(killed || !over, "{} ignores the request and lives", policy.role);
            }
            let Place { process: Some(process), mute_since_ns: Some(since_ns), .. } = self.place(policy.role)
            else {
                continue;
            };
            let over = since_ns + nanoseconds(policy.start_timeout_ms) <= self.now_ns;
            let ended = process.is_asked_to_end();
            assert!(ended || !over, "{} has all its inputs, no output and lives", policy.role);
        }
    }

    /// Updates how long each process has had all its inputs and no output.
    fn forgive_first_outputs(&mut self) {
        let ready = |process: &Process| process.ready_ns.is_some() && !process.is_asked_to_end();
        let readers = self.places.each_ref().map(|place| place.process.as_ref().is_some_and(ready));
        for process in self.places.iter_mut().filter_map(|place| place.process.as_mut()) {
            process.refused.take_if(|reader| readers[reader.index()]);
        }
        let serves = |role: Role| {
            let serves = |process: &Process| ready(process) && process.refused.is_none();
            !self.policies.iter().any(|policy| policy.role == role)
                || self.places[role.index()].process.as_ref().is_some_and(serves)
        };
        // Of a run that has failed only the end counts.
        let driving = self.supervisor.phase() == Phase::Driving && !self.stopping;
        let mute = Role::ALL.iter().map(|role| {
            let waits = |process: &Process| {
                process.reached == Some(ProcessState::Connected) && !process.is_asked_to_end()
            };
            let place = &self.places[role.index()];
            let is_dropped = |process: &Process| ready(process) && process.refused.is_some();
            let has_inputs = place.process.as_ref().is_some_and(waits) && feeders(*role).all(serves);
            driving && (has_inputs || place.process.as_ref().is_some_and(is_dropped))
        });
        let mute: Vec<bool> = mute.collect();
        for (place, mute) in self.places.iter_mut().zip(mute) {
            place.mute_since_ns = mute.then(|| place.mute_since_ns.unwrap_or(self.now_ns));
        }
    }

    fn check_lockstep(&self) {
        assert!(!self.lockstep || self.stopping, "a death in lock-step ends the run");
    }
}

/// The five policies at 10 Hz, with times that are easy to count in.
pub(super) fn policies() -> Vec<ProcessPolicy> {
    Role::ALL.iter().map(|role| ProcessPolicy::new(*role, 100)).collect()
}

impl Supervisor {
    /// When the next [`Event::Tick`] changes something at the earliest [ns].
    pub(super) fn next_deadline(&self) -> Option<u64> {
        let hangs = self.slots.iter().filter(|_| self.phase == Phase::Driving).filter_map(|slot| {
            // A caller that checks at the last moment that counts is late, and then none of the time counts.
            let poll_ns = self.last_event_ns.unwrap_or(0).saturating_add(slot.longest_gap_ns() / 2);
            Some(slot.hang_deadline_ns()?.min(poll_ns))
        });
        self.slots.iter().filter_map(deadline_ns).chain(hangs).chain(self.halting_until_ns).min()
    }
}

/// The next time at which something of a slot is due, hangs apart.
fn deadline_ns(slot: &Slot) -> Option<u64> {
    match slot.life {
        Life::Waiting { due_ns } => Some(due_ns),
        Life::Alive(alive) => [alive.start_deadline_ns, alive.kill_ns].into_iter().flatten().min(),
        _ => None,
    }
}
