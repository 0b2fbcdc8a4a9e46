//! One run from the first process to the last: a loop over parts.
//!
//! The loop does one thing after the other, each in a method of its own: take samples, take heartbeats, reap processes,
//! answer commands, let the parts decide, publish the directive. The parts decide without processes and bus, each
//! testable alone: the [`Supervisor`], the swap in progress, the shadows, the sample audit, the recording, the end.
//! The drive does not depend on the loop: the processes talk to each other, and drive on when it hangs or dies.

mod actions;
mod candidates;
mod companions;
mod conclusion;
mod ending;
mod events;
mod goals;
mod incidents;
mod injection;
mod judge;
mod memory;
mod moved;
mod person;
mod reconciliation;
mod recording;
mod registry_file;
mod requests;
mod run_limits;
mod shadows;
mod status;
pub(crate) mod swaps;

use std::collections::VecDeque;
use std::path::Path;

use agent::link::HubLink;
use audit::digest::Digests;
use audit::ledger::{LedgerReport, PROCESS_RESTARTED, SampleAudit};
use audit::samples::Samples;
use console::progress::Progress;
use emulator::JudgedBy;
use plan::Plan;
use report::recorder::{Recorder, RunResult};
use report::{Outcome, ProcessReport};
use runtime::{Bus, Domain, Shutdown, StopWord, monotonic_ns, wait_for};
use shared_types::{Phase, ProcessState, Role};
use supervision::directives::Directives;
use supervision::fleet::{Fleet, Reaped};
use supervision::supervisor::{Event, Supervisor, VisibleState};

use crate::control::ControlSocket;
use crate::own_processes::OwnProcesses;
use crate::process_registry::note_progress;
use crate::run_recorder::RunRecorder;
use crate::service_manager::ServiceManager;
use crate::startup::{RunOptions, Startup};
use crate::vitals::Vitals;

use candidates::Watches;
use conclusion::Conclusion;
use events::Events;
use incidents::Noticed;
use memory::MemoryWatch;
use moved::MovedWatch;
use person::Person;
use reconciliation::Reconciliation;
use recording::{Recording, ScanObserver};
use registry_file::RegistryFile;
use run_limits::RunLimits;
use shadows::Shadows;
use swaps::Swaps;

/// In lock-step the robot may be this many scans ahead of what was recorded: half of what topics can hold.
const GRANT_AHEAD: u64 = 8;

/// A process on another host is not hung before its heartbeats have not come for this long [ns]: longer than it takes to
/// notice that nothing comes from the host.
const MAX_SILENT_NS: u64 = 1_500_000_000;

/// A run with all its processes.
pub struct Session {
    run: Run,
    supervisor: Supervisor,
    swaps: Swaps,
    shadows: Shadows,
    companions: OwnProcesses,
    /// Their rows in the report, once the loop has ended.
    companion_reports: Vec<report::CompanionReport>,
    conclusion: Conclusion,
    limits: RunLimits,
    audit: Reconciliation,
    recording: Recording,
    /// The person who drives by hand.
    person: Person,
    moved: MovedWatch,
    vitals: Vitals,
    samples: Samples,
    watches: Watches,
    /// Candidates whose swap is over, the oldest first.
    settled: VecDeque<u32>,
    directives: Directives,
    registry_file: RegistryFile,
    /// What decides the outcome; `None` until the robot is connected.
    judged_by: Option<JudgedBy>,
    /// Scans in a row in which the actuator turned the wheels otherwise than commanded.
    deviating: u32,
    control: ControlSocket,
    shutdown: Shutdown,
    progress: Progress,
    events: Events,
    manager: ServiceManager,
    /// Records the run, if that was asked for.
    recorder: Option<RunRecorder>,
    noticed: Noticed,
    /// The bridge to the other hosts, if there are any.
    link: Option<HubLink>,
    /// Number of the directive with the last change of authority by a swap.
    authorised: u64,
    memory: MemoryWatch,
    /// The first events for the supervisor: to start all processes, or those that were adopted.
    startup: Vec<Event>,
    // Dropped last, in this order: the ports above, the bus, then the processes and all files of the system.
    bus: Bus,
    fleet: Fleet,
}

/// What stays the same during a run.
struct Run {
    domain: Domain,
    stop_word: StopWord,
    scenario: String,
    lockstep: bool,
    period_ns: u64,
    /// Processes without a directive for so long end [s].
    orphan_timeout_s: f64,
    /// Names of the other hosts of the system file.
    hosts: Vec<String>,
}

impl Session {
    /// A session that is about to drive.
    ///
    /// # Errors
    /// Errors of the bus, and a control socket that can't be made.
    pub(crate) fn new(
        domain: &Domain,
        plan: &Plan,
        options: &RunOptions,
        startup: Startup,
    ) -> anyhow::Result<Self> {
        let Startup {
            bus,
            stop_word,
            fleet,
            companions,
            shutdown,
            events,
            directive,
            first_scan,
            judged_by,
            link,
        } = startup;
        shutdown.latch_also(&stop_word)?;
        let (lockstep, period_ns) = (options.lockstep, plan.system.period_ns());
        let entries = Role::ALL.iter().filter_map(|role| fleet.entry(*role));
        let supervisor = Supervisor::new(entries.map(|entry| entry.policy(period_ns)).collect());
        let mut audit = match first_scan {
            0 => SampleAudit::midway(),
            _ => SampleAudit::new(lockstep),
        };
        link.iter().for_each(|_| audit.linked());
        let scenario = plan.scenario.name.clone();
        let mut session = Self {
            control: ControlSocket::open(domain)?,
            supervisor: if lockstep { supervisor.in_lockstep() } else { supervisor },
            swaps: Swaps::new(period_ns, lockstep),
            shadows: Shadows::new(period_ns),
            companions,
            companion_reports: Vec::new(),
            conclusion: Conclusion::new(lockstep, period_ns),
            limits: RunLimits::new(&plan.scenario, options.duration_s, period_ns),
            audit: Reconciliation::new(audit, lockstep),
            recording: Recording::new(domain.run_id(), &plan.scenario, options, first_scan, period_ns),
            person: Person::default(),
            moved: MovedWatch::default(),
            vitals: Vitals::new(&bus)?,
            samples: Samples::new(&bus, period_ns)?,
            watches: Watches::default(),
            settled: VecDeque::new(),
            directives: Directives::new(&bus, directive)?,
            registry_file: RegistryFile::default(),
            judged_by: None,
            deviating: 0,
            progress: Progress::new(options.quiet),
            events: Events::default(),
            manager: ServiceManager::new(),
            recorder: None,
            noticed: Noticed::default(),
            link,
            run: Run {
                domain: domain.clone(),
                stop_word,
                scenario,
                lockstep,
                period_ns,
                orphan_timeout_s: plan.system.orphan_timeout_s,
                hosts: plan.system.hosts.iter().map(|host| host.name.clone()).collect(),
            },
            authorised: 0,
            memory: MemoryWatch::default(),
            startup: events,
            shutdown,
            bus,
            fleet,
        };
        judged_by.into_iter().for_each(|by| session.judge_by(by));
        Ok(session)
    }

    /// Calls `observer` with each scan that is recorded: for a bench.
    pub fn observe_scans(&mut self, observer: ScanObserver) {
        self.recording.observer = Some(observer);
    }

    /// Starts a recorder of this run, which replaces a file of that name if it may; call it before [`Session::drive`]. Its
    /// messages go to `recorder.log` in `logs`.
    ///
    /// # Errors
    /// A recorder that does not start; exit code 4.
    pub fn record_to(&mut self, file: &Path, logs: &Path, replaces: bool) -> anyhow::Result<()> {
        let log = logs.join("recorder.log");
        self.recorder = Some(RunRecorder::start(&self.run.domain, file, &log, replaces)?);
        Ok(())
    }

    /// Keeps the last seconds in memory for files in `out`, when something happens; a drive without that is told so.
    pub(crate) fn keep_ring(&mut self, out: &Path, ring_s: f64) {
        let log = out.join("logs/recorder.log");
        match RunRecorder::start_ring(&self.run.domain, out, &log, ring_s) {
            Ok(recorder) => self.recorder = Some(recorder),
            Err(error) => self.warn(&format!("the last seconds of this drive are not kept: {error:#}")),
        }
    }

    /// Drives until all processes have ended.
    ///
    /// # Errors
    /// Errors of the bus. The processes are then killed when the session is dropped.
    pub fn drive(&mut self) -> anyhow::Result<RunResult> {
        self.audit.moved(monotonic_ns());
        for event in std::mem::take(&mut self.startup) {
            self.handle(event)?;
        }
        while !self.supervisor.is_finished() {
            self.sleep();
            self.heed_stop();
            self.samples.poll(&self.directives.current, &mut self.audit.samples)?;
            self.observe_candidates()?;
            self.take_heartbeats()?;
            self.reap()?;
            self.serve()?;
            self.record(false)?;
            self.end_by_clock();
            self.notice_moved()?;
            self.require_truth(false);
            self.advance_audit();
            self.advance_end()?;
            self.advance_candidates()?;
            self.advance_companions()?;
            // Starts and clean-ups take long on a busy machine: no process is judged before its waiting heartbeats.
            self.take_heartbeats()?;
            self.excuse_starved()?;
            self.handle(Event::Tick)?;
            self.update_registry();
            self.keep_room();
            self.publish_directive()?;
            self.check_recorder();
            self.keep_link();
            self.show();
        }
        self.take_heartbeats()?;
        self.samples.poll(&self.directives.current, &mut self.audit.samples)?;
        self.record(true)?;
        self.end_companions()?;
        self.keep_link();
        self.reconcile(true);
        self.progress.finish();
        let mut result = self.result();
        if let Some(mut recorder) = self.recorder.take() {
            result.swaps.iter().for_each(|certificate| recorder.note(&certificate.to_string()));
            (result.recording, result.incidents) = recorder.finish();
        }
        Ok(result)
    }

    /// The random id of the run.
    pub(crate) fn run_id(&self) -> &str {
        self.run.domain.run_id()
    }

    /// What was recorded; everything else of the system is gone when this returns.
    pub fn finish(self) -> (Recorder, Digests) {
        let Recording { recorder, digests, .. } = self.recording;
        (recorder, digests)
    }

    /// Whether the system drives and its end is still open.
    fn drives(&self) -> bool {
        self.conclusion.is_open() && self.supervisor.phase() == Phase::Driving
    }

    fn sleep(&self) {
        let limit_ns = match (self.run.lockstep, self.swaps.is_busy()) {
            (true, _) => 500_000,
            // A new process that hangs is rolled back at 1.2 periods, not a turn of the loop later.
            (false, true) => (self.run.period_ns / 20).clamp(500_000, 5_000_000),
            (false, false) => (4 * self.run.period_ns).clamp(1_000_000, 20_000_000),
        };
        let mut descriptors = vec![self.control.descriptor()];
        // After a signal it stays readable.
        if !self.shutdown.requested() {
            descriptors.push(self.shutdown.descriptor());
        }
        descriptors.extend(self.fleet.descriptors());
        descriptors.extend(self.companions.descriptors());
        wait_for(&descriptors, limit_ns);
    }

    fn take_heartbeats(&mut self) -> anyhow::Result<()> {
        let mut events = Vec::new();
        let shadows = self.shadows.incarnations().map(|(_, incarnation)| incarnation);
        let not_in_charge: Vec<u32> = self.swaps.candidate().into_iter().chain(shadows).collect();
        self.vitals.poll(&not_in_charge, &mut self.audit.samples, |event| events.push(event))?;
        for event in events {
            if let Event::StateReported { incarnation, state, .. } = event {
                self.candidate_reported(incarnation, state);
                if state >= ProcessState::Connected {
                    self.fleet.connected(incarnation);
                }
            }
            self.handle(event)?;
        }
        self.blame_writers()
    }

    /// On a busy machine a process may wait longer for a processor than the time after which it counts as hung.
    fn excuse_starved(&mut self) -> anyhow::Result<()> {
        let suspects: Vec<_> = self.supervisor.suspects(monotonic_ns()).collect();
        self.fleet.forget_suspects(|role| suspects.iter().any(|(suspect, ..)| *suspect == role));
        for (role, incarnation, is_over) in suspects {
            if self.may_be_on_its_way(role, incarnation) {
                // Its time begins anew once its heartbeats can come again.
                self.handle(Event::Progress { role, incarnation })?;
                continue;
            }
            // In lock-step it may wait for a companion, which is judged by itself.
            let waits = self.companions.delays(self.samples.newest_scan());
            if (self.fleet.is_starved(role, incarnation) || waits) && is_over {
                self.handle(Event::Starved { role, incarnation })?;
            }
        }
        Ok(())
    }

    /// Whether the process of a role runs on another host, and may work although its heartbeats do not come: because
    /// nothing comes from there, or because some of them were lost.
    fn may_be_on_its_way(&self, role: Role, incarnation: u32) -> bool {
        let host = self.fleet.entry(role).and_then(|entry| entry.host.as_deref());
        let (Some(host), Some(link)) = (host, &self.link) else { return false };
        let silent_ns = monotonic_ns().saturating_sub(self.vitals.last_beat_ns(incarnation));
        link.is_cut(host) || silent_ns < MAX_SILENT_NS
    }

    /// Keeps the link to other hosts running, and tells when one comes or goes.
    fn keep_link(&mut self) {
        let Some(link) = &mut self.link else { return };
        let messages = link.keep();
        self.audit.samples.lost_between_hosts(link.losses());
        if !messages.is_empty() {
            // One that ended has left its ports.
            self.bus.clean_up_dead_processes();
        }
        messages.iter().for_each(|text| self.warn(text));
    }

    fn reap(&mut self) -> anyhow::Result<()> {
        let Reaped { ended, departed, left_ports } = self.fleet.reap();
        for incarnation in departed {
            self.audit.samples.ended(incarnation, monotonic_ns());
        }
        if !ended.is_empty() {
            self.heed_stop();
        }
        if ended.iter().any(|(.., exit)| exit.is_success()) {
            self.notice_stall();
        }
        for (role, incarnation, exit) in ended {
            self.audit.samples.ended(incarnation, monotonic_ns());
            if self.candidate_ended(role, incarnation, exit)? {
                continue;
            }
            if self.conclusion.is_open() {
                self.incident();
                self.recording.recorder.outage_began(role, PROCESS_RESTARTED);
                let cause = self.memory.cause_of(exit);
                self.warn(&format!("{role} ({}) ended: {exit}{cause}", self.fleet.label(role)));
                for line in self.fleet.last_log_lines(role).to_vec() {
                    self.note(&format!("  {role}: {line}"));
                }
            }
            self.handle(Event::Exited { role, incarnation, exit })?;
        }
        if left_ports {
            self.bus.clean_up_dead_processes();
        }
        Ok(())
    }

    /// Records complete scans, in order.
    fn record(&mut self, flush: bool) -> anyhow::Result<()> {
        while self.is_recorded()
            && let Some(scan) = self.samples.next(flush)
        {
            self.audit.moved(monotonic_ns());
            self.recording.add(&scan);
            self.notice_stop(&scan);
            self.require_obedience(&scan);
            if let Some(recorder) = &mut self.recorder {
                recorder.belongs(scan.header.scan_id);
            }
            if self.conclusion.is_open() {
                let decided = self.recording.judge(&scan);
                self.limits.judged(self.recording.wheels_are_blocked());
                decided.into_iter().for_each(|(outcome, reason)| self.decide(outcome, &reason));
                let progress = self.recording.newly_driven();
                progress.into_iter().for_each(|progress| note_progress(&self.run.domain, progress));
            }
            let orders = self.swaps.recorded(monotonic_ns(), &scan);
            self.follow(orders)?;
        }
        Ok(())
    }

    /// In lock-step no scan after the one that decided the outcome belongs to the run.
    fn is_recorded(&self) -> bool {
        !self.run.lockstep || self.conclusion.is_open()
    }

    /// Prints a line for the user, and keeps it as an event.
    fn note(&mut self, text: &str) {
        self.progress.note(text);
        self.keep(false, text);
    }

    /// [`Session::note`] for a warning.
    fn warn(&mut self, text: &str) {
        self.progress.warn(text);
        self.keep(true, text);
    }

    /// Keeps an event for the status and for the recording.
    fn keep(&mut self, is_warning: bool, text: &str) {
        if let Some(recorder) = &mut self.recorder {
            recorder.event(is_warning, text);
        }
        self.events.push(self.recording.recorder.view().time_s, is_warning, text.to_owned());
    }

    /// Publishes the directive when it has changed, and from time to time for processes that missed it.
    fn publish_directive(&mut self) -> anyhow::Result<()> {
        let now = monotonic_ns();
        if self.directives.is_due(now) {
            if self.directives.changed {
                self.update_registry();
            }
            self.directives.publish(now)?;
            self.announce_to_companions();
        }
        Ok(())
    }

    fn result(&self) -> RunResult {
        let undecided = (Outcome::Failed, "the processes ended");
        let (outcome, reason) = self.conclusion.decided().unwrap_or(undecided);
        let mut views: Vec<_> = self.supervisor.processes().collect();
        views.sort_by_key(|view| view.role.index());
        let processes = views.into_iter().map(|view| ProcessReport {
            role: view.role.name().to_owned(),
            implementation: self.fleet.label(view.role),
            pid: self.fleet.last_pid(view.role),
            restarts: view.restarts,
            state: if view.state == VisibleState::Stopped { "exited" } else { view.state.name() }.to_owned(),
        });
        let (beside, companion_delays) = self.companions.ledger();
        RunResult {
            outcome,
            reason: reason.to_owned(),
            goals: self.recording.landings(),
            processes: processes.collect(),
            companions: self.companion_reports.clone(),
            swaps: [&self.swaps.certificates(), self.companions.swaps().certificates()].concat(),
            ledger: LedgerReport { companions: beside, ..self.audit.samples.report() },
            companion_delays,
            recording: None,
            incidents: Vec::new(),
        }
    }
}
