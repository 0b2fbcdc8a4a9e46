//! The part of a session that carries out exchanges: one at a time, decided by [`Swap`].
//!
//! In lock-step the loop waits where it would otherwise run away from the new process: until it is connected, and
//! from then on for its output for each scan, half a second at most. It begins with the state after the last scan
//! before it, so nothing of the run depends on how long it took to start.

use audit::samples::ScanRecord;
use handover::swap::watch::Watch;
use handover::swap::{
    Action, Certificate, Event, LOCKSTEP_TIMEOUT_NS, MAX_TOLERANCE, Party, Plan, Recorded, Stage, Swap,
};
use runtime::monotonic_ns;
use shared_types::{Phase, ProcessState, Role, Topic};
use supervision::entry::ProcessEntry;
use supervision::fleet::Fleet;
use supervision::supervisor::{self, Exit, Supervisor, VisibleState};

use super::{Session, Shadows};
use crate::control::{ProcessStatus, Reply, Successor, SwapRequest};

/// Most scans that can be asked for before or after the change: 17 minutes at 10 Hz.
const MAX_SCANS: u64 = 10_000;
/// Good scans in a row before a restarted process takes over: the first outputs after a start are the slowest.
const RESTART_SHADOW_SCANS: u64 = 3;
/// Good scans in charge after which the process before it ends. The same program drove before, so one is enough to show
/// that its samples reach all readers.
const RESTART_STANDBY_SCANS: u64 = 1;
/// How many of the last lines of a process that ended go into the reason.
const WORDS: usize = 3;

/// Exchanges of one run.
#[derive(Default)]
pub(crate) struct Swaps {
    asked: Option<Asked>,
    current: Option<Exchange>,
    ended: Vec<Ended>,
    recorded_scan: u64,
    recorded_ns: u64,
}

/// An exchange that was accepted and has not begun.
struct Asked {
    role: Role,
    entry: ProcessEntry,
    request: SwapRequest,
    since_ns: u64,
    purpose: Purpose,
}

/// What a swap is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Purpose {
    /// Another process is to fill the role; the report tells of it.
    Swap,
    /// The same program starts again; the count of restarts tells of it.
    Restart,
}

/// A swap that is over.
struct Ended {
    certificate: Certificate,
    purpose: Purpose,
}

/// The exchange that goes on.
struct Exchange {
    swap: Swap,
    purpose: Purpose,
    watch: Watch,
    /// In lock-step: the scan after which the new process was connected.
    connected_at: Option<u64>,
}

impl Swaps {
    /// All certificates, in the order in which the swaps ended; restarts have none.
    pub(crate) fn certificates(&self) -> Vec<Certificate> {
        let swaps = self.ended.iter().filter(|ended| ended.purpose == Purpose::Swap);
        swaps.map(|ended| ended.certificate.clone()).collect()
    }

    /// Whether an exchange is asked for or goes on.
    pub(super) fn is_busy(&self) -> bool {
        self.asked.is_some() || self.current.is_some()
    }

    /// Whether a role takes part in it.
    pub(super) fn concerns(&self, role: Role) -> bool {
        self.asked.as_ref().is_some_and(|asked| asked.role == role)
            || self.current.as_ref().is_some_and(|exchange| exchange.swap.plan().role == role)
    }

    /// The incarnation whose state is not to be gone on from.
    pub(super) fn candidate(&self) -> Option<u32> {
        self.current.as_ref().map(|exchange| exchange.swap.candidate())
    }

    /// The answer to someone who asks what became of the exchange of that number.
    pub(super) fn result(&self, number: u64) -> Reply {
        let index = usize::try_from(number).unwrap_or(usize::MAX);
        match self.ended.get(index.wrapping_sub(1)) {
            Some(ended) => Reply::Certificate(Box::new(ended.certificate.clone())),
            None if self.is_busy() && index == self.ended.len() + 1 => Reply::Pending,
            None => Reply::Refused(format!("there is no exchange of number {number}")),
        }
    }

    /// Accepts a swap, or tells why not.
    pub(super) fn ask(&mut self, request: SwapRequest, fleet: &Fleet, supervisor: &Supervisor) -> Reply {
        self.accept(request, Purpose::Swap, fleet, supervisor)
    }

    /// Accepts the restart of a process that works, as a swap to the same program, so that the process before it ends
    /// last. Nothing where there is no such process, or one in its shadow is compared with it.
    pub(super) fn restart(
        &mut self,
        role: Role,
        shadows: &Shadows,
        fleet: &Fleet,
        supervisor: &Supervisor,
    ) -> Option<Reply> {
        let is_ready = supervisor.process(role).is_some_and(|view| view.state == VisibleState::Ready);
        if supervisor.phase() != Phase::Driving || !is_ready || shadows.concern(role) {
            return None;
        }
        let entry = fleet.entry(role)?;
        let request = SwapRequest {
            successor: Successor {
                role,
                implementation: entry.implementation.clone(),
                command: entry.command.clone(),
            },
            shadow_scans: RESTART_SHADOW_SCANS,
            standby_scans: RESTART_STANDBY_SCANS,
            tolerance: MAX_TOLERANCE,
        };
        Some(self.accept(request, Purpose::Restart, fleet, supervisor))
    }

    fn accept(
        &mut self,
        request: SwapRequest,
        purpose: Purpose,
        fleet: &Fleet,
        supervisor: &Supervisor,
    ) -> Reply {
        match self.check(&request, fleet, supervisor) {
            Ok(entry) => {
                let role = request.successor.role;
                self.asked = Some(Asked { role, entry, request, since_ns: monotonic_ns(), purpose });
                Reply::Accepted(self.ended.len() as u64 + 1)
            }
            Err(reason) => Reply::Refused(reason),
        }
    }

    fn check(
        &self,
        request: &SwapRequest,
        fleet: &Fleet,
        supervisor: &Supervisor,
    ) -> Result<ProcessEntry, String> {
        let entry = request.successor.entry(fleet)?;
        for (key, scans) in [("shadow-scans", request.shadow_scans), ("standby-scans", request.standby_scans)]
        {
            if !(1..=MAX_SCANS).contains(&scans) {
                return Err(format!("--{key} {scans} is not allowed: 1 to {MAX_SCANS}"));
            }
        }
        if !(0.0..=MAX_TOLERANCE).contains(&request.tolerance) {
            return Err(format!("--tolerance {} is not allowed: 0 to {MAX_TOLERANCE}", request.tolerance));
        }
        if self.is_busy() {
            return Err("another exchange is going on".to_owned());
        }
        request.successor.require_ready(supervisor, "to be exchanged")?;
        Ok(entry)
    }

    /// In lock-step, whether the loop has to wait at the last recorded scan.
    fn holds(&self, now_ns: u64) -> bool {
        let Some(Exchange { swap, connected_at, .. }) = &self.current else { return self.asked.is_some() };
        let waits = match (swap.stage(), connected_at) {
            (Stage::Settling | Stage::Over, _) => false,
            (_, None) => return true,
            (_, Some(scan)) => self.recorded_scan > *scan && !swap.both_answered(self.recorded_scan),
        };
        waits && now_ns.saturating_sub(self.recorded_ns) < LOCKSTEP_TIMEOUT_NS
    }
}

impl Session {
    /// Tells the exchange what was published since the last look.
    pub(super) fn observe_swap(&mut self) -> anyhow::Result<()> {
        let Some(Exchange { swap, watch, .. }) = &mut self.swaps.current else { return Ok(()) };
        let mut outputs = Vec::new();
        watch.poll(swap.plan().old, swap.plan().new, |party, output| outputs.push((party, output)))?;
        let (newest, answered) = (self.samples.newest_scan(), self.samples.answered_scan());
        self.swap_event(Event::Scans { newest, answered })?;
        outputs.into_iter().try_for_each(|(party, output)| self.swap_event(Event::Output(party, output)))
    }

    /// A process said what it is doing.
    pub(super) fn swap_received(&mut self, incarnation: u32, state: ProcessState) {
        let recorded_scan = self.swaps.recorded_scan;
        let Some(exchange) = &mut self.swaps.current else { return };
        if exchange.swap.plan().new == incarnation {
            // It waits for a word, which would be repeated only after a while.
            self.directives.changed |= state == ProcessState::Attached;
            if state >= ProcessState::Connected {
                exchange.connected_at.get_or_insert(recorded_scan);
            }
        }
    }

    /// A process ended; whether that is no concern of the supervisor.
    pub(super) fn swap_ended(&mut self, role: Role, incarnation: u32, exit: Exit) -> anyhow::Result<bool> {
        let Some(Exchange { swap, .. }) = &self.swaps.current else { return Ok(false) };
        let party = match swap.stage() {
            Stage::Settling | Stage::Over => return Ok(false),
            _ if swap.plan().new == incarnation => Party::New,
            _ if swap.plan().old == incarnation => Party::Old,
            _ => return Ok(false),
        };
        let mut how = exit.to_string();
        if party == Party::New {
            let words = self.fleet.newest_log_lines(role);
            let last = &words[words.len().saturating_sub(WORDS)..];
            if !last.is_empty() {
                how = format!("{how}: {}", last.join(" | "));
            }
        }
        self.swap_event(Event::Exited(party, how))?;
        let known = self.supervisor.process(role).is_some_and(|view| view.incarnation == incarnation);
        Ok(!known)
    }

    /// A scan was recorded, with all that belongs to it.
    pub(super) fn swap_recorded(&mut self, scan: &ScanRecord) -> anyhow::Result<()> {
        self.swaps.recorded_scan = scan.truth.header.scan_id;
        self.swaps.recorded_ns = monotonic_ns();
        let Some(Exchange { swap, .. }) = &self.swaps.current else { return Ok(()) };
        let answers = scan.actuations.iter().filter(|actuation| actuation.answers == 1);
        let last = answers.clone().next_back();
        let recorded = Recorded {
            scan: scan.truth.header.scan_id,
            answers: answers.count() as u64,
            desired: last.map_or([0.0; 2], |last| [last.desired_steering_rad, last.desired_velocity_mps]),
            stamp_ns: last.map_or(0, |last| last.header.stage(swap.plan().role).published_ns),
        };
        self.swap_event(Event::Recorded(recorded))
    }

    /// Begins what was asked for, moves on what has begun, and lets the loop go on in lock-step.
    pub(super) fn advance_swap(&mut self) -> anyhow::Result<()> {
        if !self.conclusion.is_open() || self.supervisor.phase() != Phase::Driving {
            if let Some(Asked { role, entry, purpose, .. }) = self.swaps.asked.take() {
                let certificate = self.refusal(role, &entry, "the run ended");
                self.swap_over(certificate, purpose);
            }
            self.swap_event(Event::RunEnds)?;
        }
        if self.swaps.current.is_none() && self.is_at_rest_for_swap() {
            self.begin_swap()?;
        }
        self.swap_event(Event::Tick)?;
        if self.fleet.have_left() {
            self.bus.clean_up_dead_processes();
        }
        if self.lockstep && self.is_recorded() && !self.swaps.holds(monotonic_ns()) {
            let ahead = if self.swaps.is_busy() { 1 } else { super::GRANT_AHEAD };
            let granted = self.swaps.recorded_scan + ahead;
            self.directives.grant(granted);
        }
        Ok(())
    }

    /// Rows of `status` with the process that is being exchanged.
    pub(super) fn show_swap(&mut self, processes: &mut Vec<ProcessStatus>) {
        let Some(Exchange { swap, .. }) = &self.swaps.current else { return };
        let (plan, stage) = (swap.plan(), swap.stage());
        let Some((pid, implementation, load)) = self.fleet.candidate(plan.new) else { return };
        let Some(index) = processes.iter().position(|process| process.role == plan.role.name()) else {
            return;
        };
        let (rate_hz, last_sample_age_ms) = self.vitals.rate_and_age(plan.new);
        let state = match stage {
            Stage::Starting => VisibleState::Starting,
            Stage::Shadowing => VisibleState::Shadow,
            _ => VisibleState::Ready,
        };
        let row = ProcessStatus {
            role: plan.role.name().to_owned(),
            implementation,
            pid: pid.cast_signed(),
            state: state.name().to_owned(),
            restarts: 0,
            rate_hz,
            last_sample_age_ms,
            cpu_percent: load.cpu_percent,
            memory_kib: load.memory_kib,
            obeys_stop: self.vitals.obeys_stop(plan.new),
            last_words: Vec::new(),
        };
        // Who is in charge comes first.
        if state == VisibleState::Ready {
            VisibleState::Standby.name().clone_into(&mut processes[index].state);
            processes.insert(index, row);
        } else {
            processes.insert(index + 1, row);
        }
    }

    /// In lock-step a new process begins between two scans, with the state after the last one.
    fn is_at_rest_for_swap(&self) -> bool {
        let Some(asked) = &self.swaps.asked else { return false };
        let waited_ns = monotonic_ns().saturating_sub(asked.since_ns);
        if !self.lockstep || waited_ns >= LOCKSTEP_TIMEOUT_NS {
            return true;
        }
        let recorded = self.swaps.recorded_scan;
        let has_state = self.vitals.checkpoint(asked.role).is_some_and(|state| {
            // Who reads actuations publishes its state once more when the answer to the scan is in it.
            let receives_answers = asked.role.reads().contains(&Topic::Actuation);
            let is_whole = !receives_answers || state.header.stage(Role::Actuator).published_ns > 0;
            state.header.scan_id >= recorded && is_whole
        });
        recorded >= self.directives.current.granted_scan && has_state
    }

    fn begin_swap(&mut self) -> anyhow::Result<()> {
        let Some(Asked { role, entry, request, purpose, .. }) = self.swaps.asked.take() else {
            return Ok(());
        };
        let Some(old) = self.supervisor.process(role).map(|view| view.incarnation) else { return Ok(()) };
        let new = self.supervisor.next_incarnation();
        let plan = Plan {
            role,
            from: self.fleet.label(role),
            to: entry.label(),
            old,
            new,
            shadow_scans: request.shadow_scans,
            standby_scans: request.standby_scans,
            tolerance: request.tolerance,
            period_ns: self.period_ns,
            lockstep: self.lockstep,
        };
        let watch = match self.start_candidate(role, entry.clone(), new) {
            Ok(watch) => watch,
            Err(error) => {
                let certificate = self.refusal(role, &entry, &format!("could not be started: {error:#}"));
                self.swap_over(certificate, purpose);
                return Ok(());
            }
        };
        self.progress.note(&format!("{role}: {} starts beside {}", plan.to, plan.from));
        self.swaps.current =
            Some(Exchange { swap: Swap::new(monotonic_ns(), plan), purpose, watch, connected_at: None });
        Ok(())
    }

    fn swap_event(&mut self, event: Event) -> anyhow::Result<()> {
        let Some(exchange) = &mut self.swaps.current else { return Ok(()) };
        for action in exchange.swap.handle(monotonic_ns(), event) {
            self.carry_out_swap(action)?;
        }
        Ok(())
    }

    fn carry_out_swap(&mut self, action: Action) -> anyhow::Result<()> {
        let Some(Exchange { swap, purpose, .. }) = &self.swaps.current else { return Ok(()) };
        let (plan, purpose) = (swap.plan(), *purpose);
        let (role, old, new) = (plan.role, plan.old, plan.new);
        match action {
            Action::Authorise(authority) => {
                let current = &mut self.directives.current.authority[role.index()];
                // The supervisor may have started another one since.
                if [old, new].contains(&current.incarnation) && *current != authority {
                    *current = authority;
                    self.directives.changed = true;
                    self.speak()?;
                }
            }
            Action::KillNew => {
                self.sample_audit.ended(new, monotonic_ns());
                self.fleet.dismiss(new);
            }
            Action::Commit => {
                if let Some(pid) = self.fleet.promote(new) {
                    let is_restart = purpose == Purpose::Restart;
                    self.handle(supervisor::Event::Replaced { role, pid, incarnation: new, is_restart })?;
                }
            }
            Action::Finish(certificate) => {
                self.swaps.current = None;
                self.swap_over(*certificate, purpose);
            }
        }
        Ok(())
    }

    fn refusal(&self, role: Role, entry: &ProcessEntry, reason: &str) -> Certificate {
        Certificate {
            role: role.name().to_owned(),
            from: self.fleet.label(role),
            to: entry.label(),
            reason: reason.to_owned(),
            ..Certificate::default()
        }
    }

    fn swap_over(&mut self, certificate: Certificate, purpose: Purpose) {
        self.progress.note(&match purpose {
            Purpose::Swap => certificate.to_string(),
            Purpose::Restart => certificate.of_restart(),
        });
        self.swaps.ended.push(Ended { certificate, purpose });
    }
}
