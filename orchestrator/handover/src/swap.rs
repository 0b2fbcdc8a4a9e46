//! Replaces one process of a running system by another: a state machine that decides and does nothing.
//!
//! The new process computes from the same samples as the old one, but has no authority. When it has agreed with the
//! old one for a number of scans, authority goes to it from a scan on that is not published yet. The old one still
//! computes, as a standby. When the new one answers well for some scans more, the old one is ended. Otherwise
//! authority goes back from the first scan without an answer on; the output of the old one for it exists already.
//!
//! ```text
//! Starting --output--> Shadowing --agrees--> Standby --agrees--> Settling --recorded--> Over
//!     |                    |                    |                    ^
//!     +------refused-------+                    +----rolled back-----+
//! ```
//!
//! * **Starting** until its first output, for [`FIRST_OUTPUT_NS`] at most.
//! * **Shadowing**: a scan is good when the output of the new one is there, valid, in time, and agrees with that
//!   of the old one ([`agreement`]). After `shadow_scans` good scans in a row it takes over. An invalid output refuses
//!   it at once. After the first [`WARM_UP`] scans (and [`WARM_UP_NS`]) a disagreement refuses it too, and so does the
//!   third late output; one more late output is allowed per ten scans.
//! * **Standby**: the new one is in charge from `from_scan` on. It is rolled back when it ends, when an output is
//!   invalid or disagrees, or when it has none 1.2 periods after its last one and the old one has. That is before the
//!   actuator, which waits for 1.5 periods, blocks the wheels; above 125 Hz [`HANG_NS`] is longer than that.
//! * **Across hosts** a directive may be lost or late. Before the change the new one is announced, with no scan yet. Once all
//!   hosts have acknowledged that, each keeps its samples aside until it learns the scan, so a late directive loses none.
//!   Without an acknowledgement within [`ACKNOWLEDGE_NS`] the new one is refused.
//! * **Settling**: the decision is carried out; the scans that the certificate covers are still being recorded.
//!
//! Assumptions, and where they fail: both processes fill the stamps of their samples (the runtime does). If one
//! forges them, its lateness is found only when it is in charge. The old one is the measure: an error that both make
//! counts as agreement. When neither has an output, the cause lies in an earlier stage and the scan is not judged.
//!
//! In lock-step stamps do not show the time of this machine: lateness is not judged, and a process that does not
//! answer within [`LOCKSTEP_TIMEOUT_NS`] of the machine's clock hangs. The session holds the loop meanwhile.

pub mod agreement;
mod certificate;
mod comparison;
mod meant;
pub mod outputs;
mod scan_record;
#[cfg(test)]
mod tests;

use shared_types::{Authority, Role};

pub use agreement::{Disagreement, OutputSummary};
pub use certificate::{Certificate, RUN_ENDS, SwapOutcome};
use comparison::Comparison;
pub use meant::{KeyChange, Meant};
pub use scan_record::RecordedScan;
use scan_record::ScanRecord;

/// A process without an output within this time is refused [ns].
pub const FIRST_OUTPUT_NS: u64 = 3_000_000_000;
/// Scans from its first output on at which the new one may be late or disagree: it touches its memory for the first
/// time, and its state is some scans old.
pub const WARM_UP: u32 = 5;
/// Warm-up lasts at least this long: at high rates the scans above take less than the start of a process [ns].
pub const WARM_UP_NS: u64 = 250_000_000;
/// Late outputs after the warm-up that are tolerated: a busy machine causes one or two, three are a property.
pub const FORGIVEN_LATE: u32 = 2;
/// One more late output is tolerated per so many scans, because a busy machine delays any process.
pub const FORGIVEN_SHARE: u32 = 10;
/// With this factor on the bounds, agreement is not judged at all, only validity and timing.
pub const MAX_TOLERANCE: f64 = 1000.0;
/// Outputs are late after half a period, but not before this time: a wait for a processor takes as long [ns].
pub const LATE_NS: u64 = 3_000_000;
/// A process hangs a fifth of a period after the end of a period, but not before this time; with less, at 100 Hz and
/// more, a time slice of another process would count as a hang. Readers keep three scans, so none is lost [ns].
pub const HANG_NS: u64 = 4_000_000;
/// In lock-step, how long an output is waited for [ns].
pub const LOCKSTEP_TIMEOUT_NS: u64 = 500_000_000;
/// Scans between the newest one and the first of the new process: all processes have the directive by then.
const NOTICE_SCANS: u64 = 2;
/// The hosts acknowledge that a process is about to take over within this time, or it is refused [ns].
pub const ACKNOWLEDGE_NS: u64 = 3_000_000_000;
/// Recorded scans are waited for this long after the decision [ns] ...
const SETTLE_NS: u64 = 2_000_000_000;
/// ... or this many periods, where that is longer.
const SETTLE_PERIODS: u64 = 5;

/// Which process is to be replaced, by which, and how it has to prove itself.
#[derive(Debug, Clone, PartialEq)]
pub struct SwapPlan {
    /// The role.
    pub role: Role,
    /// Implementation or command of the old process.
    pub from: String,
    /// Implementation or command of the new process.
    pub to: String,
    /// Incarnation of the old process.
    pub old: u32,
    /// Incarnation of the new process.
    pub new: u32,
    /// Good scans in a row before the change.
    pub shadow_scans: u64,
    /// Good scans after the change.
    pub standby_scans: u64,
    /// Factor on the bounds of agreement.
    pub tolerance: f64,
    /// What other settings of the new process are meant to change.
    pub meant: Meant,
    /// Scan period [ns].
    pub period_ns: u64,
    /// Whether time is simulated.
    pub lockstep: bool,
    /// Whether a change of authority is known everywhere at once; false across hosts, which acknowledge it first.
    pub is_acknowledged: bool,
}

/// One of the two processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Party {
    /// The one that was there before.
    Old,
    /// The one that is to take its place.
    New,
}

/// One output of one of the two.
#[derive(Debug, Clone, PartialEq)]
pub struct SwapOutput {
    /// The scan it answers.
    pub scan: u64,
    /// Number of the output among those of its process.
    pub sequence: u64,
    /// When that scan was published [ns]; 0 when unknown.
    pub scan_published_ns: u64,
    /// When the output was published [ns].
    pub published_ns: u64,
    /// From the last input taken to the result [ns].
    pub compute_ns: u64,
    /// The same of all samples that it consists of; they identify the answers that are based on it [ns].
    pub stamps_ns: [u64; 2],
    /// Its content, or what is wrong with it.
    pub content: Result<OutputSummary, String>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum SwapEvent {
    /// The newest scan published, and the newest answered, as far as known; the first event of a turn.
    Scans {
        /// Newest scan published.
        newest: u64,
        /// Newest scan answered by the actuator.
        answered: u64,
    },
    /// An output was seen.
    Output(Party, SwapOutput),
    /// A process ended, and how.
    Exited(Party, String),
    /// All hosts have the last change of authority; repeated while that holds.
    Acknowledged,
    /// A scan was recorded; they come in order.
    Recorded(RecordedScan),
    /// The last event of a turn; time has passed.
    Tick,
    /// The end of the run was decided.
    RunEnds,
}

/// Something to be done, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum SwapAction {
    /// Publish which samples count for the role.
    Authorise(Authority),
    /// Kill the new process.
    KillNew,
    /// The new process is the process of the role from now on; ask the old one to end.
    Commit,
    /// The swap is over.
    Finish(Box<Certificate>),
}

/// Stages of a swap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SwapStage {
    /// The new process has no output yet.
    Starting,
    /// It computes in the shadow of the old one.
    Shadowing,
    /// It is in charge, or about to be; the old one is standby.
    Standby,
    /// The outcome is decided.
    Settling,
    /// The certificate is complete.
    Over,
}

/// One swap from the start of the new process to its certificate.
#[derive(Debug, Clone)]
pub struct Swap {
    plan: SwapPlan,
    stage: SwapStage,
    since_ns: u64,
    newest: u64,
    answered: u64,
    from_scan: u64,
    until_scan: u64,
    settled_at: u64,
    /// When the hosts were told who is about to take over.
    announced_ns: Option<u64>,
    comparison: Comparison,
    scan_record: ScanRecord,
    certificate: Certificate,
}

impl Swap {
    /// A swap whose new process was just started.
    pub fn new(now_ns: u64, plan: SwapPlan) -> Self {
        let certificate = Certificate {
            role: plan.role.name().to_owned(),
            from: plan.from.clone(),
            to: plan.to.clone(),
            ..Certificate::default()
        };
        Self {
            plan,
            stage: SwapStage::Starting,
            since_ns: now_ns,
            newest: 0,
            answered: 0,
            from_scan: u64::MAX,
            until_scan: u64::MAX,
            settled_at: 0,
            announced_ns: None,
            comparison: Comparison::default(),
            scan_record: ScanRecord::default(),
            certificate,
        }
    }

    /// The plan that it carries out.
    pub fn plan(&self) -> &SwapPlan {
        &self.plan
    }

    /// The stage that it has reached.
    pub fn stage(&self) -> SwapStage {
        self.stage
    }

    /// The incarnation that is not in charge.
    pub fn candidate(&self) -> u32 {
        let new_is_in_charge = match self.stage {
            SwapStage::Standby => self.newest >= self.from_scan,
            SwapStage::Settling | SwapStage::Over => self.certificate.outcome == SwapOutcome::Swapped,
            SwapStage::Starting | SwapStage::Shadowing => false,
        };
        if new_is_in_charge { self.plan.old } else { self.plan.new }
    }

    /// Whether both have answered a scan; in lock-step the loop waits for that.
    pub fn both_answered(&self, scan: u64) -> bool {
        self.comparison.has_both(scan)
    }

    /// What is to be done, in this order, now that `event` has happened at `now_ns`.
    pub fn handle(&mut self, now_ns: u64, event: SwapEvent) -> Vec<SwapAction> {
        let mut actions = Vec::new();
        if self.stage == SwapStage::Over {
            return actions;
        }
        match event {
            SwapEvent::Scans { newest, answered } => {
                self.newest = self.newest.max(newest);
                self.answered = self.answered.max(answered);
            }
            SwapEvent::Output(party, output) => {
                if party == Party::Old && output.content.is_ok() {
                    self.newest = self.newest.max(output.scan);
                }
                self.comparison.keep(now_ns, self.newest, party, output);
                if self.stage == SwapStage::Starting && self.comparison.first_new.is_some() {
                    self.stage = SwapStage::Shadowing;
                }
            }
            SwapEvent::Exited(Party::New, how) => match self.stage {
                SwapStage::Settling | SwapStage::Over => {}
                _ => self.give_up(now_ns, format!("the new process ended: {how}"), &mut actions),
            },
            SwapEvent::Exited(Party::Old, how) => match self.stage {
                SwapStage::Starting | SwapStage::Shadowing => {
                    self.refuse(format!("the old process ended: {how}"), &mut actions);
                }
                // The standby is gone, so there is no process to roll back to.
                SwapStage::Standby => {
                    let from_scan = self.from_scan.min(self.answered + 1);
                    self.commit(now_ns, from_scan, format!("the old process ended: {how}"), &mut actions);
                }
                SwapStage::Settling | SwapStage::Over => {}
            },
            SwapEvent::Acknowledged => self.plan.is_acknowledged |= self.announced_ns.is_some(),
            SwapEvent::Recorded(recorded) => self.recorded(&recorded),
            SwapEvent::Tick => self.tick(now_ns, &mut actions),
            SwapEvent::RunEnds => self.run_ends(now_ns, &mut actions),
        }
        actions
    }

    fn tick(&mut self, now_ns: u64, actions: &mut Vec<SwapAction>) {
        if self.stage != SwapStage::Settling
            && let Some(reason) = self.comparison.invalid.take()
        {
            return self.give_up(now_ns, reason, actions);
        }
        match self.stage {
            SwapStage::Starting => {
                if now_ns.saturating_sub(self.since_ns) >= FIRST_OUTPUT_NS {
                    let limit_s = FIRST_OUTPUT_NS / 1_000_000_000;
                    let cause = match self.comparison.has_old() {
                        true => "",
                        false => "; the old process had none either: valid inputs do not come",
                    };
                    self.refuse(format!("no output within {limit_s} s{cause}"), actions);
                }
            }
            SwapStage::Shadowing | SwapStage::Standby => self.judge(now_ns, actions),
            SwapStage::Settling => {
                let limit_ns = SETTLE_NS.max(SETTLE_PERIODS * self.plan.period_ns);
                if self.settled_at == 0 || now_ns.saturating_sub(self.since_ns) >= limit_ns {
                    self.finish(actions);
                }
            }
            SwapStage::Over => {}
        }
    }

    /// Judges the scans that can be judged by now, and moves on when enough of them are good.
    fn judge(&mut self, now_ns: u64, actions: &mut Vec<SwapAction>) {
        if let Err(reason) = self.comparison.judge(now_ns, &self.plan, self.from_scan) {
            return self.give_up(now_ns, reason, actions);
        }
        if self.stage == SwapStage::Shadowing && self.comparison.good_in_a_row >= self.plan.shadow_scans {
            match self.plan.is_acknowledged {
                true => self.take_over(actions),
                false => self.announce(now_ns, actions),
            }
        }
        if self.stage == SwapStage::Shadowing
            && self.announced_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) >= ACKNOWLEDGE_NS)
        {
            let limit_s = ACKNOWLEDGE_NS / 1_000_000_000;
            return self
                .refuse(format!("a host has not acknowledged the handover within {limit_s} s"), actions);
        }
        if self.stage == SwapStage::Shadowing
            && let Some(reason) = self.comparison.timed_out(now_ns, &self.plan)
        {
            return self.refuse(reason, actions);
        }
        if self.stage == SwapStage::Standby && self.comparison.good_in_charge >= self.plan.standby_scans {
            self.commit(now_ns, 0, String::new(), actions);
        }
    }

    /// Tells all hosts who is about to take over, from no scan on yet.
    fn announce(&mut self, now_ns: u64, actions: &mut Vec<SwapAction>) {
        if self.announced_ns.is_none() {
            self.announced_ns = Some(now_ns);
            let (incarnation, previous) = (self.plan.new, self.plan.old);
            actions.push(SwapAction::Authorise(Authority { incarnation, previous, from_scan: u64::MAX }));
        }
    }

    /// Authority goes to the new one, from a scan on that is not published yet.
    fn take_over(&mut self, actions: &mut Vec<SwapAction>) {
        self.stage = SwapStage::Standby;
        self.from_scan = self.newest + NOTICE_SCANS;
        self.certificate.shadow_scans = self.comparison.good_in_a_row;
        let (incarnation, previous) = (self.plan.new, self.plan.old);
        actions.push(SwapAction::Authorise(Authority { incarnation, previous, from_scan: self.from_scan }));
    }

    /// The new one has failed: it is refused, or rolled back when it was in charge of a scan.
    fn give_up(&mut self, now_ns: u64, reason: String, actions: &mut Vec<SwapAction>) {
        if self.stage != SwapStage::Standby || self.newest < self.from_scan {
            return self.refuse(reason, actions);
        }
        let from_scan = (self.answered + 1).max(self.from_scan);
        let (incarnation, previous) = (self.plan.old, self.plan.new);
        actions.push(SwapAction::Authorise(Authority { incarnation, previous, from_scan }));
        actions.push(SwapAction::KillNew);
        self.until_scan = from_scan;
        self.settle(now_ns, from_scan, SwapOutcome::RolledBack, reason);
    }

    fn refuse(&mut self, reason: String, actions: &mut Vec<SwapAction>) {
        if self.stage == SwapStage::Standby || self.announced_ns.is_some() {
            actions.push(SwapAction::Authorise(alone(self.plan.old)));
        }
        actions.push(SwapAction::KillNew);
        self.certificate.shadow_scans = self.comparison.good_in_a_row;
        self.certificate.outcome = SwapOutcome::Refused;
        self.certificate.reason = reason;
        self.over(actions);
    }

    /// The new one stays. `from_scan` is 0, or the first scan that it has to answer instead of one that ended early.
    fn commit(&mut self, now_ns: u64, from_scan: u64, reason: String, actions: &mut Vec<SwapAction>) {
        let authority = if from_scan == 0 {
            alone(self.plan.new)
        } else {
            Authority { incarnation: self.plan.new, previous: self.plan.old, from_scan }
        };
        if from_scan != 0 {
            self.from_scan = self.from_scan.min(from_scan);
        }
        actions.push(SwapAction::Authorise(authority));
        actions.push(SwapAction::Commit);
        self.settle(now_ns, self.from_scan, SwapOutcome::Swapped, reason);
    }

    fn settle(&mut self, now_ns: u64, from_scan: u64, outcome: SwapOutcome, reason: String) {
        self.stage = SwapStage::Settling;
        self.since_ns = now_ns;
        self.settled_at = ScanRecord::settled_at(from_scan);
        if self.scan_record.reaches(self.settled_at) {
            self.settled_at = 0;
        }
        self.certificate.outcome = outcome;
        self.certificate.reason = reason;
    }

    fn finish(&mut self, actions: &mut Vec<SwapAction>) {
        let swapped = self.certificate.outcome == SwapOutcome::Swapped;
        actions.push(SwapAction::Authorise(alone(if swapped { self.plan.new } else { self.plan.old })));
        self.over(actions);
    }

    fn over(&mut self, actions: &mut Vec<SwapAction>) {
        self.stage = SwapStage::Over;
        self.scan_record.fill(&mut self.certificate);
        actions.push(SwapAction::Finish(Box::new(self.certificate.clone())));
    }

    fn run_ends(&mut self, now_ns: u64, actions: &mut Vec<SwapAction>) {
        let reason = || RUN_ENDS.to_owned();
        match self.stage {
            // The process in charge keeps its authority until the run is over.
            SwapStage::Standby if self.newest >= self.from_scan => {
                self.commit(now_ns, 0, reason(), actions);
                self.over(actions);
            }
            SwapStage::Starting | SwapStage::Shadowing | SwapStage::Standby => self.refuse(reason(), actions),
            SwapStage::Settling => self.finish(actions),
            SwapStage::Over => {}
        }
    }

    fn recorded(&mut self, recorded: &RecordedScan) {
        let party = self.answered_by(recorded);
        self.scan_record.record(recorded, party);
        if self.stage == SwapStage::Settling && recorded.scan >= self.settled_at {
            self.settled_at = 0;
        }
    }

    /// The process whose sample a recorded answer is based on.
    fn answered_by(&self, recorded: &RecordedScan) -> Party {
        let planned = (self.from_scan..self.until_scan).contains(&recorded.scan);
        let planned = if planned { Party::New } else { Party::Old };
        self.comparison.source_of(recorded).unwrap_or(planned)
    }
}

/// One process is in charge of all scans.
fn alone(incarnation: u32) -> Authority {
    Authority { incarnation, ..Authority::default() }
}
