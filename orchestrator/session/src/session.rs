//! One run from the first process to the last: events in, decisions of the supervisor and the referee carried out.
//!
//! The loop below does one thing after the other, each in a method of its own: take samples, take heartbeats,
//! reap processes, answer commands, let the supervisor and the referee decide, speak to the processes.
//! Nothing of the driving depends on it: the processes talk to each other, and go on when it hangs or dies.

mod candidate;
mod conclusion;
mod refusals;
mod registry_file;
mod requests;
mod shadowing;
mod status;
mod swapping;

use audit::digest::Digests;
use audit::ledger::{PROCESS_RESTARTED, SampleAudit};
use audit::samples::{Samples, ScanRecord};
use console::progress::Progress;
use emulator::{Referee, Scenario};
use plan::Plan;
use report::recorder::{Recorder, RunInfo, RunResult};
use report::{Outcome, ProcessReport};
use runtime::{Bus, Domain, Shutdown, StopWord, Wheels, monotonic_ns, wait_for};
use shared_types::{Authority, Phase, ProcessState, Role};
use supervision::fleet::Fleet;
use supervision::supervisor::{Action, Event, Severity, Supervisor, VisibleState};

use crate::control::ControlSocket;
use crate::directives::Directives;
use crate::service_manager::ServiceManager;
use crate::startup::{RunOptions, Startup};
use crate::vitals::Vitals;

pub(crate) use conclusion::Conclusion;
use conclusion::Step;
pub(crate) use registry_file::RegistryFile;
pub(crate) use shadowing::Shadows;
pub(crate) use swapping::Swaps;

/// In lock-step the robot may be this many scans ahead of what was recorded: half of what topics can hold.
const GRANT_AHEAD: u64 = 8;
/// In lock-step a scan that is not answered within this time of the machine's clock ends the run [ns].
const LOCKSTEP_TIMEOUT_NS: u64 = 20_000_000_000;

/// Is told of every scan that was recorded.
pub(crate) type ScanObserver = Box<dyn FnMut(&ScanRecord)>;

/// Everything a run is made of.
pub struct Session {
    pub(crate) domain: Domain,
    pub(crate) word: StopWord,
    pub(crate) scenario: Scenario,
    pub(crate) lockstep: bool,
    pub(crate) duration_s: Option<f64>,
    pub(crate) period_ns: u64,
    pub(crate) supervisor: Supervisor,
    pub(crate) recorder: Recorder,
    pub(crate) progress: Progress,
    pub(crate) manager: ServiceManager,
    pub(crate) shutdown: Shutdown,
    pub(crate) control: ControlSocket,
    pub(crate) referee: Referee,
    pub(crate) samples: Samples,
    /// The account of all samples, and when it was closed last [ns].
    pub(crate) sample_audit: SampleAudit,
    pub(crate) closed_ns: u64,
    pub(crate) digests: Digests,
    pub(crate) vitals: Vitals,
    pub(crate) directives: Directives,
    pub(crate) registry_file: RegistryFile,
    pub(crate) swaps: Swaps,
    /// What the supervisor is told first: to start all, or who is there already.
    pub(crate) startup: Vec<Event>,
    /// Sees every recorded scan: for benches.
    pub(crate) on_scan: Option<ScanObserver>,
    pub(crate) shadows: Shadows,
    pub(crate) conclusion: Conclusion,
    pub(crate) moved_ns: u64,
    // Dropped last, in this order: the ports above, the bus, then the processes and all files of the system.
    pub(crate) bus: Bus,
    pub(crate) fleet: Fleet,
}

impl Session {
    /// A session that is about to drive.
    ///
    /// # Errors
    /// Errors of the bus, and a control socket that can't be made.
    pub(crate) fn new(
        domain: &Domain,
        plan: &Plan,
        manner: RunOptions,
        startup: Startup,
    ) -> anyhow::Result<Self> {
        let Plan { scenario, system } = plan;
        let Startup { bus, word, fleet, shutdown, events, directive, first_scan } = startup;
        shutdown.latch_also(&word)?;
        let control = ControlSocket::open(domain)?;
        let period_ns = system.period_ns();
        let policies = Role::ALL
            .iter()
            .filter_map(|role| fleet.entry(*role).map(|entry| entry.policy(*role, period_ns)))
            .collect();
        let supervisor = Supervisor::new(policies);
        let supervisor = if manner.lockstep { supervisor.in_lockstep() } else { supervisor };
        let info = RunInfo {
            run_id: domain.run_id().to_owned(),
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            lockstep: manner.lockstep,
            first_scan,
            goal_m: [scenario.goal.x_m, scenario.goal.y_m],
        };
        Ok(Self {
            samples: Samples::new(&bus, period_ns)?,
            sample_audit: if first_scan == 0 {
                SampleAudit::midway()
            } else {
                SampleAudit::new(manner.lockstep)
            },
            closed_ns: 0,
            vitals: Vitals::new(&bus)?,
            directives: Directives::new(&bus, directive)?,
            digests: Digests::default(),
            referee: Referee::new(scenario),
            progress: Progress::new(manner.quiet),
            manager: ServiceManager::new(),
            recorder: Recorder::new(info),
            domain: domain.clone(),
            word,
            scenario: scenario.clone(),
            lockstep: manner.lockstep,
            duration_s: manner.duration_s,
            registry_file: RegistryFile::default(),
            swaps: Swaps::default(),
            startup: events,
            on_scan: None,
            shadows: Shadows::default(),
            conclusion: Conclusion::new(manner.lockstep, period_ns),
            moved_ns: 0,
            period_ns,
            bus,
            fleet,
            supervisor,
            shutdown,
            control,
        })
    }

    /// Calls `listener` with each scan that is recorded: for a bench.
    pub fn listen(&mut self, listener: Box<dyn FnMut(&ScanRecord)>) {
        self.on_scan = Some(listener);
    }

    /// Drives until all processes have ended.
    ///
    /// # Errors
    /// Errors of the bus. The processes are then killed when the session is dropped.
    pub fn drive(&mut self) -> anyhow::Result<RunResult> {
        self.moved_ns = monotonic_ns();
        for event in std::mem::take(&mut self.startup) {
            self.handle(event)?;
        }
        while !self.supervisor.is_finished() {
            self.sleep();
            self.heed_stop();
            self.samples.poll(&self.directives.current, &mut self.sample_audit)?;
            self.observe_swap()?;
            self.observe_shadows()?;
            self.take_heartbeats()?;
            self.reap()?;
            self.serve()?;
            self.record(false)?;
            self.audit();
            self.advance_end()?;
            self.advance_swap()?;
            self.advance_shadows();
            // Starts and clean-ups take long on a busy machine: nobody is judged by news that waited meanwhile.
            self.take_heartbeats()?;
            self.excuse_starved()?;
            self.handle(Event::Tick)?;
            self.update_registry();
            self.keep_room();
            self.speak()?;
            self.show();
        }
        self.take_heartbeats()?;
        self.samples.poll(&self.directives.current, &mut self.sample_audit)?;
        self.record(true)?;
        self.reconcile(true);
        self.progress.finish();
        Ok(self.ending())
    }

    /// What was recorded; everything else of the system is gone when this returns.
    pub fn finish(self) -> (Recorder, Digests) {
        let Self { recorder, digests, .. } = self;
        (recorder, digests)
    }

    fn sleep(&self) {
        let longest_ns = match (self.lockstep, self.swaps.is_busy()) {
            (true, _) => 500_000,
            // A new process that hangs is replaced at 1.2 periods, not a look later.
            (false, true) => (self.period_ns / 20).clamp(500_000, 5_000_000),
            (false, false) => (4 * self.period_ns).clamp(1_000_000, 20_000_000),
        };
        let mut descriptors = vec![self.control.descriptor()];
        // After a signal it stays readable.
        if !self.shutdown.requested() {
            descriptors.push(self.shutdown.descriptor());
        }
        descriptors.extend(self.fleet.descriptors());
        wait_for(&descriptors, longest_ns);
    }

    fn take_heartbeats(&mut self) -> anyhow::Result<()> {
        let mut events = Vec::new();
        let candidate: Vec<u32> =
            self.swaps.candidate().into_iter().chain(self.shadows.incarnations()).collect();
        self.vitals.poll(&candidate, &mut self.sample_audit, |event| events.push(event))?;
        for event in events {
            if let Event::StateReported { incarnation, state, .. } = event {
                self.swap_received(incarnation, state);
                self.shadow_received(incarnation, state);
                if state >= ProcessState::Connected {
                    self.fleet.connected(incarnation);
                }
            }
            self.handle(event)?;
        }
        self.blame_writers()
    }

    /// On a machine that has too much to do a process may wait longer for a processor than one that hangs is given.
    fn excuse_starved(&mut self) -> anyhow::Result<()> {
        let suspects: Vec<_> = self.supervisor.suspects(monotonic_ns()).collect();
        self.fleet.forget_suspects(|role| suspects.iter().any(|(suspect, ..)| *suspect == role));
        for (role, incarnation, is_over) in suspects {
            if self.fleet.is_starved(role, incarnation) && is_over {
                self.handle(Event::Starved { role, incarnation })?;
            }
        }
        Ok(())
    }

    fn reap(&mut self) -> anyhow::Result<()> {
        let ended = self.fleet.reap();
        for incarnation in self.fleet.take_departed() {
            self.sample_audit.ended(incarnation, monotonic_ns());
        }
        for (role, incarnation, exit) in ended {
            self.sample_audit.ended(incarnation, monotonic_ns());
            if self.shadow_ended(role, incarnation, exit) || self.swap_ended(role, incarnation, exit)? {
                continue;
            }
            if self.conclusion.is_open() {
                self.recorder.outage_began(role, PROCESS_RESTARTED);
                self.progress.warn(&format!("{role} ({}) ended: {exit}", self.fleet.label(role)));
                for line in self.fleet.last_words(role) {
                    self.progress.note(&format!("  {role}: {line}"));
                }
            }
            self.handle(Event::Exited { role, incarnation, exit })?;
        }
        Ok(())
    }

    /// Hands complete scans to the recorder and the referee, in order.
    fn record(&mut self, flush: bool) -> anyhow::Result<()> {
        while self.is_recorded()
            && let Some(scan) = self.samples.next(flush)
        {
            self.moved_ns = monotonic_ns();
            self.digest(&scan);
            if let Some(on_scan) = &mut self.on_scan {
                on_scan(&scan);
            }
            scan.poses.iter().for_each(|pose| self.recorder.pose(pose));
            scan.obstacles.iter().for_each(|obstacles| self.recorder.obstacles(obstacles));
            scan.commands.iter().for_each(|command| self.recorder.command(command));
            self.recorder.truth(&scan.truth);
            scan.actuations.iter().for_each(|actuation| self.recorder.actuation(actuation));
            if self.conclusion.is_open() {
                self.judge(&scan.truth);
            }
            self.swap_recorded(&scan)?;
        }
        Ok(())
    }

    /// In lock-step nothing after the scan that decided the outcome belongs to the run.
    fn is_recorded(&self) -> bool {
        !self.lockstep || self.conclusion.is_open()
    }

    /// In lock-step equal runs have equal samples; in real time stamps differ.
    fn digest(&mut self, scan: &ScanRecord) {
        if self.lockstep {
            self.digests.add(&scan.truth);
            scan.poses.iter().for_each(|sample| self.digests.add(sample));
            scan.obstacles.iter().for_each(|sample| self.digests.add(sample));
            scan.commands.iter().for_each(|sample| self.digests.add(sample));
            scan.actuations.iter().for_each(|sample| self.digests.add(sample));
        }
    }

    fn judge(&mut self, truth: &shared_types::Truth) {
        if let Some(outcome) = self.referee.observe(truth, self.recorder.last_actuation()) {
            let reason = self.referee.reason().to_owned();
            self.decide(outcome, &reason);
        } else if self.duration_s.is_some_and(|duration_s| truth.time_s >= duration_s) {
            self.decide(Outcome::Timeout, "the duration asked for is over");
        }
    }

    fn decide(&mut self, outcome: Outcome, reason: &str) {
        if self.conclusion.is_open() {
            let is_explained = !matches!(outcome, Outcome::Stopped | Outcome::Timeout);
            let reason = if is_explained { reason.to_owned() } else { reason.to_owned() + &self.blame() };
            self.conclusion.decide(monotonic_ns(), outcome, reason);
            self.directives.stop();
        }
    }

    /// Ends the run when it was stopped from outside, or this process was asked to end.
    fn heed_stop(&mut self) {
        if self.shutdown.requested() {
            self.decide(Outcome::Interrupted, "interrupted by a signal");
        }
        if !self.word.is_armed() {
            self.decide(Outcome::Interrupted, "stopped by command");
        }
    }

    /// Moves the end of the run on: wheels at rest, answers in, processes ended.
    fn advance_end(&mut self) -> anyhow::Result<()> {
        self.heed_stop();
        let now = monotonic_ns();
        if self.lockstep
            && self.conclusion.is_open()
            && self.supervisor.phase() == Phase::Driving
            && now.saturating_sub(self.moved_ns) > LOCKSTEP_TIMEOUT_NS
        {
            let scan = self.samples.newest_scan();
            self.decide(
                Outcome::Failed,
                &format!("scan {scan} was not answered within 20 s of the machine's time"),
            );
        }
        let drives = self.supervisor.phase() == Phase::Driving;
        let is_answered = self.samples.answered_scan() >= self.samples.newest_scan();
        match self.conclusion.advance(now, drives, self.rests(), is_answered) {
            Some(Step::EndScans) => self.directives.enter(Phase::Stopping),
            Some(Step::EndProcesses) => {
                self.recorder.run_ended();
                self.sample_audit.run_ended();
                self.handle(Event::StopRequested)?;
            }
            None => {}
        }
        Ok(())
    }

    /// Whether the wheels rest since the end was decided. A robot that tells no truth is given the time to.
    fn rests(&self) -> bool {
        let Some((outcome, decided_ns)) = self.conclusion.resting() else { return false };
        // The referee has seen it stand.
        let stood =
            matches!(outcome, Outcome::Reached | Outcome::Missed | Outcome::Stopped | Outcome::Collision);
        let newest = self.samples.newest_truth().or(self.recorder.last_truth());
        newest.is_some_and(|truth| {
            truth.speed_mps <= 0.0 && (stood || truth.blocked == 1 && truth.header.acquired_ns > decided_ns)
        })
    }

    fn handle(&mut self, event: Event) -> anyhow::Result<()> {
        let mut events = vec![event];
        while let Some(event) = events.pop() {
            for action in self.supervisor.handle(monotonic_ns(), event) {
                if let Some(answer) = self.carry_out(action)? {
                    events.insert(0, answer);
                }
            }
        }
        Ok(())
    }

    /// Does what the supervisor asks for; returns what it wants to hear about it.
    fn carry_out(&mut self, action: Action) -> anyhow::Result<Option<Event>> {
        match action {
            Action::Grant { role, incarnation } => {
                let authority = &mut self.directives.current.authority[role.index()];
                *authority = Authority { incarnation, ..Authority::default() };
                self.directives.changed = true;
                self.speak()?;
            }
            Action::Spawn { role, .. } if !self.word.is_armed() => {
                self.heed_stop();
                if self.supervisor.phase() != Phase::Driving {
                    self.handle(Event::StopRequested)?;
                }
                return Ok(Some(Event::SpawnFailed { role, error: "the run was stopped".to_owned() }));
            }
            Action::Spawn { role, incarnation } => {
                self.recorder.outage_ended(role);
                let answer = self.fleet.spawn(role, incarnation, self.left_behind(role).as_ref());
                self.update_registry();
                return Ok(Some(answer));
            }
            Action::Terminate { role } => self.fleet.signal(role, false),
            Action::Kill { role: Role::Robot } if !self.robot_rests() => return Ok(self.leave_robot()),
            Action::Kill { role } => self.fleet.signal(role, true),
            Action::CleanUp { role } => {
                self.bus.clean_up_dead_processes();
                return Ok(Some(Event::CleanedUp { role }));
            }
            Action::Announce(phase) => {
                if phase == Phase::Connecting {
                    self.samples.connect();
                }
                if phase == Phase::Driving {
                    self.sample_audit.driving();
                    self.directives.grant(GRANT_AHEAD);
                    self.moved_ns = monotonic_ns();
                }
                self.directives.enter(phase);
                self.speak()?;
            }
            Action::RunFailed { role, reason } => {
                let reason = format!("{role} ({}): {reason}", self.fleet.label(role));
                if self.supervisor.phase() == Phase::Driving {
                    self.decide(Outcome::Failed, &reason);
                } else if self.conclusion.fail(reason) {
                    self.recorder.run_ended();
                    self.sample_audit.run_ended();
                    self.directives.stop();
                }
                self.speak()?;
            }
            Action::AllStopped => {}
            Action::Log(severity, text) => match severity {
                Severity::Info => tracing::debug!("{text}"),
                Severity::Warn if self.conclusion.is_open() => self.progress.warn(&text),
                Severity::Error => self.progress.warn(&text),
                Severity::Warn => {}
            },
        }
        Ok(None)
    }

    /// Whether the robot is known to rest: by its own report, or by the truth of an emulated one that does not report.
    fn robot_rests(&self) -> bool {
        let (wheels, _) = self.word.wheels(Role::Robot);
        let newest = self.samples.newest_truth().or(self.recorder.last_truth());
        match wheels {
            Wheels::Resting => true,
            // Without a report and without a truth only one that was never sent anything is known to stand.
            Wheels::Unknown => newest.map_or_else(
                || self.samples.recent_actuations().next().is_none(),
                |truth| truth.speed_mps <= 0.0,
            ),
            Wheels::Turning | Wheels::Blocked => false,
        }
    }

    /// A robot that does not end and is not known to rest is left: it is the last that could stop itself.
    fn leave_robot(&mut self) -> Option<Event> {
        let role = Role::Robot;
        let incarnation = self.fleet.incarnation(role);
        let pid = self.fleet.leave(role)?;
        let text = format!("robot {pid} does not end, and is not known to rest: it is left");
        self.progress.warn(&text);
        self.conclusion.correct(text);
        Some(Event::Exited { role, incarnation, exit: supervision::supervisor::Exit::Unknown })
    }

    /// Publishes the directive when it changed, and from time to time for those who missed it.
    fn speak(&mut self) -> anyhow::Result<()> {
        let now = monotonic_ns();
        if self.directives.is_due(now) {
            match self.directives.changed {
                true => self.update_registry(),
                false => self.fleet.trim_logs(),
            }
            self.directives.publish(now)?;
        }
        Ok(())
    }

    fn ending(&mut self) -> RunResult {
        let undecided = (Outcome::Failed, "the processes ended");
        let (outcome, reason) = self.conclusion.decided().unwrap_or(undecided);
        let reason = reason.to_owned();
        let mut processes: Vec<_> = self
            .supervisor
            .processes()
            .map(|view| ProcessReport {
                role: view.role.name().to_owned(),
                implementation: self.fleet.label(view.role),
                pid: self.fleet.last_pid(view.role),
                restarts: view.restarts,
                state: if view.state == VisibleState::Stopped {
                    "exited".to_owned()
                } else {
                    view.state.name().to_owned()
                },
            })
            .collect();
        processes.sort_by_key(|process| process.role.parse::<Role>().map_or(usize::MAX, Role::index));
        RunResult {
            outcome,
            reason,
            processes,
            swaps: self.swaps.certificates(),
            ledger: self.sample_audit.report(),
        }
    }
}
