//! The swaps of one run, one at a time, each decided by [`Swap`]. Pure: the session carries out the [`Order`]s.
//!
//! In lock-step the loop is held where it would otherwise run ahead of the new process: until that is connected, and
//! from then on for its output for each scan, half a second at most. The new process starts with the state after the
//! last scan before it, so the result of the run does not depend on how long it took to start.

use audit::samples::ScanRecord;
use handover::swap::{
    Certificate, LOCKSTEP_TIMEOUT_NS, MAX_TOLERANCE, Meant, Party, RUN_ENDS, RecordedScan, Swap, SwapAction,
    SwapEvent, SwapOutcome, SwapPlan, SwapStage,
};
use shared_types::{Checkpoint, ProcessState, Role, Topic};
use supervision::supervisor::VisibleState;

use super::GRANT_AHEAD;
use super::candidates::{Candidate, Live, Order};
use crate::control::{Reply, SwapRequest};

/// Most scans that can be asked for before or after the change: 17 minutes at 10 Hz.
const MAX_SCANS: u64 = 10_000;

/// Passes when a number of scans of a swap is allowed.
pub(crate) fn require_scans(key: &str, scans: u64) -> Result<(), String> {
    match (1..=MAX_SCANS).contains(&scans) {
        true => Ok(()),
        false => Err(format!("--{key} {scans} is not allowed: 1 to {MAX_SCANS}")),
    }
}
/// Good scans in a row before a restarted process takes over: the first outputs after a start are the slowest.
const RESTART_SHADOW_SCANS: u64 = 3;
/// Good scans in charge after which the process before it ends. The same program drove before, so one is enough to show
/// that its samples reach all readers.
const RESTART_STANDBY_SCANS: u64 = 1;

/// The swaps of one run.
#[derive(Default)]
pub(crate) struct Swaps {
    period_ns: u64,
    lockstep: bool,
    asked: Option<Asked>,
    current: Option<Current>,
    ended: Vec<Ended>,
    recorded_scan: u64,
    recorded_ns: u64,
}

/// A swap that was accepted and has not begun; incarnations are not known yet.
struct Asked {
    plan: SwapPlan,
    candidate: Candidate,
    since_ns: u64,
    purpose: Purpose,
}

/// What a swap is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Purpose {
    /// Another process is to fill the role; the report contains its certificate.
    Swap,
    /// The same program starts again; it counts as a restart.
    Restart,
}

/// The swap in progress.
struct Current {
    swap: Swap,
    purpose: Purpose,
    /// In lock-step: the scan after which the new process was connected.
    connected_at: Option<u64>,
}

/// A swap that is over.
struct Ended {
    certificate: Certificate,
    purpose: Purpose,
}

/// Other settings for a candidate.
#[derive(Debug, Clone)]
pub(super) struct Changed {
    /// Its settings file.
    pub(super) settings: String,
    /// What they are meant to change.
    pub(super) meant: Meant,
}

/// What a candidate has to keep to take over.
struct Gate {
    /// Scans in shadow, and as standby.
    scans: [u64; 2],
    tolerance: f64,
    meant: Meant,
}

impl Swaps {
    pub(super) fn new(period_ns: u64, lockstep: bool) -> Self {
        Self { period_ns, lockstep, ..Self::default() }
    }

    /// All certificates, in the order in which the swaps ended; restarts have none.
    pub(super) fn certificates(&self) -> Vec<Certificate> {
        let swaps = self.ended.iter().filter(|ended| ended.purpose == Purpose::Swap);
        swaps.map(|ended| ended.certificate.clone()).collect()
    }

    /// Number of swaps and restarts that were rolled back.
    pub(super) fn rolled_back(&self) -> usize {
        let is_rolled_back = |ended: &&Ended| ended.certificate.outcome == SwapOutcome::RolledBack;
        self.ended.iter().filter(is_rolled_back).count()
    }

    /// Whether a swap was accepted or is in progress.
    pub(super) fn is_busy(&self) -> bool {
        self.asked.is_some() || self.current.is_some()
    }

    /// Whether a role is being swapped.
    pub(super) fn concern(&self, role: Role) -> bool {
        let asked = self.asked.as_ref().map(|asked| &asked.plan);
        asked.or(self.plan()).is_some_and(|plan| plan.role == role)
    }

    /// The plan of the swap in progress.
    pub(super) fn plan(&self) -> Option<&SwapPlan> {
        self.current.as_ref().map(|current| current.swap.plan())
    }

    /// The incarnation that is not in charge, whose state no successor resumes from.
    pub(super) fn candidate(&self) -> Option<u32> {
        self.current.as_ref().map(|current| current.swap.candidate())
    }

    /// The new process for `status`: its role, incarnation and state.
    pub(super) fn shown(&self) -> Option<(Role, u32, VisibleState)> {
        let swap = &self.current.as_ref()?.swap;
        let state = match swap.stage() {
            SwapStage::Starting => VisibleState::Starting,
            SwapStage::Shadowing => VisibleState::Shadow,
            _ => VisibleState::Ready,
        };
        Some((swap.plan().role, swap.plan().new, state))
    }

    /// The certificate of the swap of that number, if it is over.
    pub(super) fn result(&self, number: u64) -> Reply {
        let index = usize::try_from(number).unwrap_or(usize::MAX);
        match self.ended.get(index.wrapping_sub(1)) {
            Some(ended) => Reply::Certificate(Box::new(ended.certificate.clone())),
            None if self.is_busy() && index == self.ended.len() + 1 => Reply::Pending,
            None => Reply::Refused(format!("there is no swap of number {number}")),
        }
    }

    /// Accepts a swap and returns its number.
    ///
    /// # Errors
    /// The reason why it is refused.
    pub(super) fn ask(
        &mut self,
        now_ns: u64,
        request: &SwapRequest,
        changed: Option<Changed>,
        live: &Live,
    ) -> Result<u64, String> {
        let SwapRequest { successor, set, shadow_scans, standby_scans, tolerance } = request;
        let entry = match &changed {
            Some(_) => live.entry.clone(),
            None => successor.entry(live.entry, live.hosts)?,
        };
        let to =
            if set.is_empty() { entry.label() } else { format!("{} with {}", entry.label(), set.join(", ")) };
        let meant = changed.as_ref().map_or_else(Meant::default, |changed| changed.meant);
        let candidate = Candidate { entry, settings: changed.map(|changed| changed.settings) };
        require_scans("shadow-scans", *shadow_scans)?;
        require_scans("standby-scans", *standby_scans)?;
        if !(0.0..=MAX_TOLERANCE).contains(tolerance) {
            return Err(format!("--tolerance {tolerance} is not allowed: 0 to {MAX_TOLERANCE}"));
        }
        let gate = Gate { scans: [*shadow_scans, *standby_scans], tolerance: *tolerance, meant };
        self.accept(now_ns, Purpose::Swap, (candidate, to), live, gate)
    }

    /// Accepts the restart of a process that works, as a swap to the same program, so that the process before it ends
    /// last.
    ///
    /// # Errors
    /// As [`Swaps::ask`].
    pub(super) fn restart(&mut self, now_ns: u64, live: &Live) -> Result<u64, String> {
        let scans = [RESTART_SHADOW_SCANS, RESTART_STANDBY_SCANS];
        let gate = Gate { scans, tolerance: MAX_TOLERANCE, meant: Meant::default() };
        let candidate = Candidate { entry: live.entry.clone(), settings: None };
        self.accept(now_ns, Purpose::Restart, (candidate, live.entry.label()), live, gate)
    }

    fn accept(
        &mut self,
        now_ns: u64,
        purpose: Purpose,
        (candidate, to): (Candidate, String),
        live: &Live,
        gate: Gate,
    ) -> Result<u64, String> {
        let Gate { scans: [shadow_scans, standby_scans], tolerance, meant } = gate;
        if self.is_busy() {
            return Err("another swap is in progress".to_owned());
        }
        live.require_ready("to be swapped")?;
        let plan = SwapPlan {
            role: candidate.entry.role(),
            from: live.entry.label(),
            to,
            old: 0,
            new: 0,
            shadow_scans,
            standby_scans,
            tolerance,
            meant,
            period_ns: self.period_ns,
            lockstep: self.lockstep,
            is_acknowledged: live.is_on_one_host && candidate.entry.host.is_none(),
        };
        self.asked = Some(Asked { plan, candidate, since_ns: now_ns, purpose });
        Ok(self.ended.len() as u64 + 1)
    }

    /// The process that is to be started now. In lock-step it starts between two scans, when the state
    /// after the last one is there.
    pub(super) fn due<'a>(
        &self,
        now_ns: u64,
        granted_scan: u64,
        checkpoint_of: impl Fn(Role) -> Option<&'a Checkpoint>,
    ) -> Option<Candidate> {
        let asked = self.asked.as_ref().filter(|_| self.current.is_none())?;
        let role = asked.plan.role;
        let has_state = || {
            checkpoint_of(role).is_some_and(|state| {
                // A process that reads actuations publishes its state once more with the answer to the scan in it.
                let reads_answers = role.reads().contains(&Topic::Actuation);
                let is_whole = !reads_answers || state.header.stage(Role::Actuator).published_ns > 0;
                state.header.scan_id >= self.recorded_scan && is_whole
            })
        };
        let is_due = !self.lockstep
            || now_ns.saturating_sub(asked.since_ns) >= LOCKSTEP_TIMEOUT_NS
            || self.recorded_scan >= granted_scan && has_state();
        is_due.then(|| asked.candidate.clone())
    }

    /// The candidate was started, or could not be; incarnations of both processes.
    pub(super) fn begin(
        &mut self,
        now_ns: u64,
        [old, new]: [u32; 2],
        started: Result<(), String>,
    ) -> Option<Order> {
        let Asked { plan, purpose, .. } = self.asked.take()?;
        if let Err(error) = started {
            return Some(self.finish(refusal(&plan, format!("could not be started: {error}")), purpose));
        }
        let note = format!("{}: {} starts beside {}", plan.role, plan.to, plan.from);
        let swap = Swap::new(now_ns, SwapPlan { old, new, ..plan });
        self.current = Some(Current { swap, purpose, connected_at: None });
        Some(Order::Note(note))
    }

    /// A process reported its state.
    pub(super) fn received(&mut self, incarnation: u32, state: ProcessState) {
        if let Some(current) = &mut self.current
            && current.swap.plan().new == incarnation
            && state >= ProcessState::Connected
        {
            current.connected_at.get_or_insert(self.recorded_scan);
        }
    }

    /// Which of the two processes an incarnation is, until the outcome is decided.
    pub(super) fn party_of(&self, incarnation: u32) -> Option<Party> {
        let swap = &self.current.as_ref()?.swap;
        match swap.stage() {
            SwapStage::Settling | SwapStage::Over => None,
            _ if swap.plan().new == incarnation => Some(Party::New),
            _ => (swap.plan().old == incarnation).then_some(Party::Old),
        }
    }

    /// A scan was recorded, with all samples that belong to it.
    pub(super) fn recorded(&mut self, now_ns: u64, scan: &ScanRecord) -> Vec<Order> {
        (self.recorded_scan, self.recorded_ns) = (scan.header.scan_id, now_ns);
        let Some(plan) = self.plan() else { return Vec::new() };
        let answers = scan.actuations.iter().filter(|actuation| actuation.answers == 1);
        let last = answers.clone().next_back();
        let recorded = RecordedScan {
            scan: self.recorded_scan,
            answers: answers.count() as u64,
            desired: last.map_or([0.0; 2], |last| [last.desired_steering_rad, last.desired_velocity_mps]),
            stamp_ns: last.map_or(0, |last| last.header.stage(plan.role).published_ns),
        };
        self.handle(now_ns, SwapEvent::Recorded(recorded))
    }

    /// The run ends: a swap that was accepted does not begin, and one in progress is decided.
    pub(super) fn run_ends(&mut self, now_ns: u64) -> Vec<Order> {
        if let Some(Asked { plan, purpose, .. }) = self.asked.take() {
            return vec![self.finish(refusal(&plan, RUN_ENDS.to_owned()), purpose)];
        }
        self.handle(now_ns, SwapEvent::RunEnds)
    }

    /// What is to be done, in this order, now that `event` has happened.
    pub(super) fn handle(&mut self, now_ns: u64, event: SwapEvent) -> Vec<Order> {
        let Some(Current { swap, purpose, .. }) = &mut self.current else { return Vec::new() };
        let (purpose, actions) = (*purpose, swap.handle(now_ns, event));
        let SwapPlan { role, old, new, .. } = *swap.plan();
        let orders = actions.into_iter().map(|action| match action {
            SwapAction::Authorise(authority) => Order::Authorise { role, parties: [old, new], authority },
            SwapAction::KillNew => Order::Reject(new),
            SwapAction::Commit => {
                Order::Promote { role, incarnation: new, is_restart: purpose == Purpose::Restart }
            }
            SwapAction::Finish(certificate) => self.finish(*certificate, purpose),
        });
        orders.collect()
    }

    /// The newest recorded scan.
    pub(super) fn recorded_scan(&self) -> u64 {
        self.recorded_scan
    }

    /// In lock-step: the scan up to which the robot may publish, unless the loop is held.
    pub(super) fn granted_scan(&self, now_ns: u64) -> Option<u64> {
        let ahead = if self.is_busy() { 1 } else { GRANT_AHEAD };
        (!self.holds(now_ns)).then_some(self.recorded_scan + ahead)
    }

    /// In lock-step, whether the loop has to wait at the last recorded scan.
    fn holds(&self, now_ns: u64) -> bool {
        let Some(Current { swap, connected_at, .. }) = &self.current else { return self.asked.is_some() };
        let waits = match (swap.stage(), connected_at) {
            (SwapStage::Settling | SwapStage::Over, _) => false,
            (_, None) => return true,
            (_, Some(scan)) => self.recorded_scan > *scan && !swap.both_answered(self.recorded_scan),
        };
        waits && now_ns.saturating_sub(self.recorded_ns) < LOCKSTEP_TIMEOUT_NS
    }

    fn finish(&mut self, certificate: Certificate, purpose: Purpose) -> Order {
        self.current = None;
        let note = match purpose {
            Purpose::Swap => certificate.to_string(),
            Purpose::Restart => certificate.of_restart(),
        };
        self.ended.push(Ended { certificate, purpose });
        Order::Note(note)
    }
}

/// The certificate of a swap that did not begin.
fn refusal(plan: &SwapPlan, reason: String) -> Certificate {
    let (role, from, to) = (plan.role.name().to_owned(), plan.from.clone(), plan.to.clone());
    Certificate { role, from, to, reason, ..Certificate::default() }
}

#[cfg(test)]
mod tests;
