//! One run from the first process to the last: events in, decisions of the supervisor and the referee carried out.
//!
//! The loop below does one thing after the other, each in a method of its own: take samples, take heartbeats,
//! reap processes, answer commands, let the supervisor and the referee decide, speak to the processes.
//! Nothing of the driving depends on it: the processes talk to each other, and go on when it hangs or dies.

mod account;
mod candidate;
mod refusals;
mod shadowing;
mod swapping;

use std::time::Instant;

use audit::digest::Digests;
use audit::ledger::{Books, PROCESS_RESTARTED};
use audit::samples::{Samples, ScanRecord};
use console::progress::{COLUMNS, ProcessWord, Progress, line};
use emulator::{Referee, Scenario};
use report::recorder::{Ending, Recorder};
use report::{Outcome, ProcessReport};
use runtime::{Bus, Domain, Shutdown, StopWord, Voice, Wheels, monotonic_ns, wait_for};
use shared_types::{Authority, Directive, Phase, ProcessState, Role};
use supervision::fleet::Fleet;
use supervision::supervisor::{Action, Event, Severity, Supervisor};

use crate::control::{ControlSocket, ProcessStatus, Reply, Request, Status};
use crate::service_manager::ServiceManager;
use crate::vitals::Vitals;

pub(crate) use account::Word;
pub(crate) use shadowing::Shadows;
pub(crate) use swapping::Swaps;

/// In lock-step the robot may be this many scans ahead of what was recorded: half of what topics can hold.
const GRANT_AHEAD: u64 = 8;
/// The directive is repeated this often for those who missed it [ns].
const REPEAT_NS: u64 = 100_000_000;
/// A robot that does not come to rest within this time after the stop is not waited for [ns].
const REST_PATIENCE_NS: u64 = 1_500_000_000;
/// Scans on their way when the robot was told to publish no more are waited for this long [ns].
const DRAIN_PATIENCE_NS: u64 = 300_000_000;
/// In lock-step a scan that is not answered within this time of the machine's clock ends the run [ns].
const LOCKSTEP_PATIENCE_NS: u64 = 20_000_000_000;

/// Is told of every scan that was recorded.
pub(crate) type ScanListener = Box<dyn FnMut(&ScanRecord)>;

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
    pub(crate) books: Books,
    pub(crate) closed_ns: u64,
    pub(crate) digests: Digests,
    pub(crate) vitals: Vitals,
    pub(crate) voice: Voice<Directive>,
    pub(crate) directive: Directive,
    /// What the roster said last of the directive.
    pub(crate) written: Option<Word>,
    /// When to write again what could not be written; 0 when all is written [ns].
    pub(crate) rewrite_ns: u64,
    pub(crate) swaps: Swaps,
    /// What the supervisor is told first: to start all, or who is there already.
    pub(crate) beginning: Vec<Event>,
    /// Sees every recorded scan: for benches.
    pub(crate) on_scan: Option<ScanListener>,
    pub(crate) shadows: Shadows,
    pub(crate) end: End,
    pub(crate) dirty: bool,
    pub(crate) said_ns: u64,
    pub(crate) moved_ns: u64,
    // Dropped last, in this order: the ports above, the bus, then the processes and all files of the system.
    pub(crate) bus: Bus,
    pub(crate) fleet: Fleet,
}

/// How far the end of a run has come.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum End {
    /// The robot is on its way.
    NotYet,
    /// The outcome is known; the wheels are being blocked until this time at the latest.
    Resting(Outcome, String, u64),
    /// The robot publishes no more; answers on their way are waited for until this time at the latest.
    Draining(Outcome, String, u64),
    /// Processes are ending.
    Ending(Outcome, String),
}

impl Session {
    /// Calls `listener` with each scan that is recorded: for a bench.
    pub fn listen(&mut self, listener: Box<dyn FnMut(&ScanRecord)>) {
        self.on_scan = Some(listener);
    }

    /// Creates the services for payloads beside a topic, see [`runtime::BlobOutput`]: for a bench.
    ///
    /// # Errors
    /// As [`Bus::create_blobs`].
    pub fn create_blobs(&mut self, topic: shared_types::Topic) -> Result<(), runtime::RuntimeError> {
        self.bus.create_blobs(topic)
    }

    /// Drives until all processes have ended.
    ///
    /// # Errors
    /// Errors of the bus. The processes are then killed when the session is dropped.
    pub fn drive(&mut self) -> anyhow::Result<Ending> {
        self.moved_ns = monotonic_ns();
        for event in std::mem::take(&mut self.beginning) {
            self.handle(event)?;
        }
        while !self.supervisor.is_finished() {
            self.sleep();
            self.heed_stop();
            self.samples.poll(&self.directive, &mut self.books)?;
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
            self.keep_account();
            self.keep_room();
            self.speak()?;
            self.show();
        }
        self.take_heartbeats()?;
        self.samples.poll(&self.directive, &mut self.books)?;
        self.record(true)?;
        self.close_books(true);
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
        let beside: Vec<u32> = self.swaps.beside().into_iter().chain(self.shadows.incarnations()).collect();
        self.vitals.poll(&beside, &mut self.books, |event| events.push(event))?;
        for event in events {
            if let Event::StateReported { incarnation, state, .. } = event {
                self.swap_heard(incarnation, state);
                self.shadow_heard(incarnation, state);
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
            self.books.ended(incarnation, monotonic_ns());
        }
        for (role, incarnation, exit) in ended {
            self.books.ended(incarnation, monotonic_ns());
            if self.shadow_ended(role, incarnation, exit) || self.swap_ended(role, incarnation, exit)? {
                continue;
            }
            if self.end == End::NotYet {
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

    fn serve(&mut self) -> anyhow::Result<()> {
        if !wait_for(&[self.control.descriptor()], 0) {
            return Ok(());
        }
        let stopped = !self.word.is_armed();
        let mut requests = Vec::new();
        let status = Reply::Status(Box::new(self.status()));
        let Self { control, swaps, shadows, fleet, supervisor, lockstep, .. } = self;
        control.serve(|request| match request {
            Request::Status => status.clone(),
            Request::Swap(_) | Request::Shadow(_) | Request::Restart { .. } if stopped => {
                Reply::Refused("the run was stopped".to_owned())
            }
            Request::Swap(request) if shadows.concern(&request.role) => {
                Reply::Refused(format!("a process runs in the shadow of {}: end that first", request.role))
            }
            Request::Swap(request) => swaps.ask(request, fleet, supervisor),
            Request::Shadow(_) if *lockstep => Reply::Refused(
                "a shadow needs a run in real time: in lock-step all wait for the slowest".to_owned(),
            ),
            Request::Shadow(request) => match request.role.parse() {
                Ok(role) if swaps.concerns(role) => {
                    Reply::Refused(format!("{role} is being exchanged: wait for the certificate"))
                }
                _ => shadows.ask(&request, fleet, supervisor),
            },
            Request::ShadowResult { number } => shadows.result(number),
            Request::ShadowEnd { number } => shadows.end_early(number),
            Request::SwapResult { number } => swaps.result(number),
            Request::Restart { role } => match role.parse::<Role>() {
                Ok(role) if swaps.concerns(role) => {
                    Reply::Refused(format!("{role} is not restarted: it is being exchanged"))
                }
                Ok(Role::Robot) => {
                    Reply::Refused("the robot is not restarted: its end would end the run".to_owned())
                }
                Ok(role) => swaps.restart(role, shadows, fleet, supervisor).unwrap_or_else(|| {
                    requests.push(Event::RestartRequested { role });
                    Reply::Done
                }),
                Err(unknown) => Reply::Refused(unknown.to_string()),
            },
            Request::Stop => {
                requests.push(Event::StopRequested);
                Reply::Done
            }
        });
        for request in requests {
            match request {
                Event::StopRequested => self.decide(Outcome::Interrupted, "stopped by command"),
                event => self.handle(event)?,
            }
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
            if self.end == End::NotYet {
                self.judge(&scan.truth);
            }
            self.swap_recorded(&scan)?;
        }
        Ok(())
    }

    /// In lock-step nothing after the scan that decided the outcome belongs to the run.
    fn is_recorded(&self) -> bool {
        !self.lockstep || self.end == End::NotYet
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
        if self.end == End::NotYet {
            let is_explained = !matches!(outcome, Outcome::Stopped | Outcome::Timeout);
            let reason = if is_explained { reason.to_owned() } else { reason.to_owned() + &self.blame() };
            let patience = if self.lockstep { 0 } else { REST_PATIENCE_NS };
            self.end = End::Resting(outcome, reason, monotonic_ns() + patience);
            self.directive.stop = 1;
            self.dirty = true;
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
            && self.end == End::NotYet
            && self.supervisor.phase() == Phase::Driving
            && now.saturating_sub(self.moved_ns) > LOCKSTEP_PATIENCE_NS
        {
            let scan = self.samples.newest_scan();
            self.decide(
                Outcome::Failed,
                &format!("scan {scan} was not answered within 20 s of the machine's time"),
            );
        }
        match self.end.clone() {
            End::Resting(outcome, reason, until_ns) => {
                if self.rests(outcome, until_ns)
                    || now >= until_ns
                    || self.supervisor.phase() != Phase::Driving
                {
                    self.end = End::Draining(
                        outcome,
                        reason,
                        now + if self.lockstep { 0 } else { DRAIN_PATIENCE_NS },
                    );
                    self.directive.phase = Phase::Stopping.wire();
                    self.dirty = true;
                }
            }
            End::Draining(outcome, reason, until_ns) => {
                let answered = self.samples.answered_scan() >= self.samples.newest_scan();
                // One more look after the robot has heard that it shall stop publishing.
                let heard = now + DRAIN_PATIENCE_NS >= until_ns + self.period_ns.min(DRAIN_PATIENCE_NS);
                if (answered && heard) || now >= until_ns || self.supervisor.phase() != Phase::Driving {
                    self.recorder.run_ended();
                    self.books.run_ended();
                    self.end = End::Ending(outcome, reason);
                    self.handle(Event::StopRequested)?;
                }
            }
            End::NotYet | End::Ending(..) => {}
        }
        Ok(())
    }

    /// Whether the wheels rest since the end was decided. A robot that tells no truth is given the time to.
    fn rests(&self, outcome: Outcome, until_ns: u64) -> bool {
        // The referee has seen it stand.
        let stood =
            matches!(outcome, Outcome::Reached | Outcome::Missed | Outcome::Stopped | Outcome::Collision);
        let decided_ns = until_ns.saturating_sub(REST_PATIENCE_NS);
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
                self.directive.authority[role.index()] = Authority { incarnation, ..Authority::default() };
                self.dirty = true;
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
                self.keep_account();
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
                    self.books.driving();
                    self.directive.granted_scan = GRANT_AHEAD;
                    self.moved_ns = monotonic_ns();
                }
                self.directive.phase = self.directive.phase.max(phase.wire());
                self.dirty = true;
                self.speak()?;
            }
            Action::RunFailed { role, reason } => {
                let reason = format!("{role} ({}): {reason}", self.fleet.label(role));
                if self.supervisor.phase() == Phase::Driving {
                    self.decide(Outcome::Failed, &reason);
                } else if self.end == End::NotYet {
                    self.recorder.run_ended();
                    self.books.run_ended();
                    self.end = End::Ending(Outcome::Failed, reason);
                    self.directive.stop = 1;
                    self.dirty = true;
                }
                self.speak()?;
            }
            Action::AllStopped => {}
            Action::Log(severity, text) => match severity {
                Severity::Info => tracing::debug!("{text}"),
                Severity::Warn if self.end == End::NotYet => self.progress.warn(&text),
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
        if let End::Resting(outcome, reason, _)
        | End::Draining(outcome, reason, _)
        | End::Ending(outcome, reason) = &mut self.end
        {
            (*outcome, *reason) = (Outcome::Failed, text);
        }
        Some(Event::Exited { role, incarnation, exit: supervision::supervisor::Exit::Unknown })
    }

    /// Publishes the directive when it changed, and from time to time for those who missed it.
    fn speak(&mut self) -> anyhow::Result<()> {
        let now = monotonic_ns();
        if self.dirty || now.saturating_sub(self.said_ns) >= REPEAT_NS {
            match self.dirty {
                true => self.keep_account(),
                false => self.fleet.trim_logs(),
            }
            self.directive.issued_ns = now;
            self.voice.say(&mut self.directive, self.dirty)?;
            self.dirty = false;
            self.said_ns = now;
        }
        Ok(())
    }

    fn show(&mut self) {
        let processes: Vec<_> = self.supervisor.processes().collect();
        let words: Vec<_> =
            processes.iter().map(|view| ProcessWord { role: view.role, state: view.state.name() }).collect();
        let view = self.recorder.view();
        self.progress.update(Instant::now(), &view, &words);
        match self.supervisor.phase() {
            Phase::Driving => self.manager.ready(),
            Phase::Stopping => self.manager.stopping(),
            Phase::Starting | Phase::Connecting => {}
        }
        self.manager.turn(|| line(&view, &words, COLUMNS));
    }

    fn status(&mut self) -> Status {
        let views: Vec<_> = self.supervisor.processes().collect();
        let processes = views.into_iter().map(|view| {
            let (rate_hz, last_sample_age_ms) = self.vitals.rate_and_age(view.incarnation);
            let load = self.fleet.load(view.role);
            ProcessStatus {
                role: view.role.name().to_owned(),
                implementation: self.fleet.label(view.role),
                pid: view.pid.map_or(0, u32::cast_signed),
                state: view.state.name().to_owned(),
                restarts: view.restarts,
                rate_hz,
                last_sample_age_ms,
                cpu_percent: load.cpu_percent,
                memory_kib: load.memory_kib,
                obeys_stop: self.vitals.obeys_stop(view.incarnation),
                last_words: self.fleet.last_words(view.role).to_vec(),
            }
        });
        let mut processes: Vec<_> = processes.collect();
        processes.sort_by_key(|process| process.role.parse::<Role>().map_or(usize::MAX, Role::index));
        self.show_swap(&mut processes);
        self.show_shadows(&mut processes);
        Status {
            system_id: self.domain.system_id().to_owned(),
            state: Phase::try_from(self.directive.phase).map_or("starting", Phase::name).to_owned(),
            scenario: self.scenario.name.clone(),
            scan: self.samples.newest_scan(),
            lockstep: self.lockstep,
            processes,
            refused: self.books.refused().to_vec(),
        }
    }

    fn ending(&mut self) -> Ending {
        let (outcome, reason) = match &self.end {
            End::NotYet => (Outcome::Failed, "the processes ended".to_owned()),
            End::Resting(outcome, reason, _)
            | End::Draining(outcome, reason, _)
            | End::Ending(outcome, reason) => (*outcome, reason.clone()),
        };
        let mut processes: Vec<_> = self
            .supervisor
            .processes()
            .map(|view| ProcessReport {
                role: view.role.name().to_owned(),
                implementation: self.fleet.label(view.role),
                pid: self.fleet.last_pid(view.role),
                restarts: view.restarts,
                state: if view.state.name() == "stopped" {
                    "exited".to_owned()
                } else {
                    view.state.name().to_owned()
                },
            })
            .collect();
        processes.sort_by_key(|process| process.role.parse::<Role>().map_or(usize::MAX, Role::index));
        Ending { outcome, reason, processes, swaps: self.swaps.certificates(), ledger: self.books.report() }
    }
}
