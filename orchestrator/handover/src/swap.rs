//! Exchanges one process of a running system for another: a state machine that decides and does nothing.
//!
//! Idea: the new process is started beside the old one and computes from the same samples, but nobody listens to
//! it. When it has proved itself for a number of scans, authority goes to it from a scan on that is not published
//! yet, and the old one goes on computing. When that too goes well the old one is ended; when it does not,
//! authority goes back from the first scan that has no answer yet, whose answer of the old one is already there.
//!
//! ```text
//! Starting --output--> Shadowing --agrees--> Standby --agrees--> Settling --recorded--> over
//!     |                    |                    |                    ^
//!     +------refused-------+                    +----rolled back-----+
//! ```
//!
//! * **Starting** until its first output, for [`FIRST_OUTPUT_NS`] at most.
//! * **Shadowing**: a scan is good when the output of the new one is there, valid, in time, and agrees with that
//!   of the old one ([`agreement`]). So many good scans in a row, and it takes over. An invalid output refuses it
//!   at once; after the first [`WARM_UP`] scans (and [`WARM_UP_NS`]) so does a disagreement, and the third output
//!   that is late, or the fourth in twenty and so on.
//! * **Standby**: the new one counts from `from_scan` on. It is rolled back when it ends, gives an invalid output or
//!   one that disagrees, or has none 1.2 periods after its last one when the old one has. That is before the
//!   actuator, which waits for 1.5 periods, blocks the wheels; above 125 Hz [`HANG_NS`] is longer than that.
//! * **Settling**: the decision is carried out; the scans that the certificate tells of are still being recorded.
//!
//! Assumptions, and where they fail: both processes fill the stamps of their samples (the runtime does); one that
//! forges them is late unnoticed until it has to answer. The old one is the measure: a mistake that both make is
//! agreement. When neither has an output the cause lies before both, so nobody is judged.
//!
//! In lock-step stamps say nothing of this machine: lateness is not judged, and who does not answer within
//! [`LOCKSTEP_TIMEOUT_NS`] of its clock hangs. The session lets the loop wait meanwhile.

pub mod agreement;
mod certificate;
mod scan_record;
#[cfg(test)]
mod tests;
mod verdict;
pub mod watch;

use std::collections::BTreeMap;

use shared_types::{Authority, Role};

pub use agreement::{Disagreement, OutputSummary};
pub use certificate::{Certificate, SwapOutcome};
pub use scan_record::Recorded;
use scan_record::ScanRecord;
use verdict::Verdict;

/// A process that has no output by then will not have one [ns].
pub const FIRST_OUTPUT_NS: u64 = 3_000_000_000;
/// Scans from its first output on at which the new one may be late or disagree: it touches its memory for the first
/// time, and its state is some scans old.
pub const WARM_UP: u32 = 5;
/// At high rates these scans are over before the process has run in: so long it is given in any case [ns].
pub const WARM_UP_NS: u64 = 250_000_000;
/// Late outputs after that which are forgiven: the machine was busy; three times is a property.
pub const FORGIVEN_LATE: u32 = 2;
/// Of many scans one in so many more: a busy machine delays whom it likes.
pub const FORGIVEN_SHARE: u32 = 10;
/// With this factor on the bounds agreement is not judged at all: validity and timing only.
pub const MAX_TOLERANCE: f64 = 1000.0;
/// Half a period is late, but nothing below this: a process that waits for a processor waits that long [ns].
pub const LATE_NS: u64 = 3_000_000;
/// A fifth of a period beyond its end is a hang, but nothing below this; with less, at 100 Hz and more, each turn
/// that another process has on the processor would be one. Three scans wait at the readers, so none is lost [ns].
pub const HANG_NS: u64 = 4_000_000;
/// In lock-step, how long an output is waited for [ns].
pub const LOCKSTEP_TIMEOUT_NS: u64 = 500_000_000;
/// Scans between the newest one and the first of the new process: the directive is everywhere by then.
const NOTICE_SCANS: u64 = 2;
/// Recorded scans are waited for this long after the decision [ns].
const SETTLE_NS: u64 = 2_000_000_000;
/// So many outputs for scans that it has answered before are no accident.
const REPEATS: u32 = 3;
/// Scans whose outputs are kept for comparison.
const PAIRS: usize = 32;

/// What is to be exchanged.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
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
    /// Scan period [ns].
    pub period_ns: u64,
    /// Whether time is simulated.
    pub lockstep: bool,
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
pub struct Output {
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
    /// The same of all samples that it is made of, by which answers that rest on it are known [ns].
    pub stamps_ns: [u64; 2],
    /// What it says, or what is wrong with it.
    pub content: Result<OutputSummary, String>,
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The newest scan published, and the newest answered, as far as known; before all other news of a turn.
    Scans {
        /// Newest scan published.
        newest: u64,
        /// Newest scan answered by the actuator.
        answered: u64,
    },
    /// An output was seen.
    Output(Party, Output),
    /// A process ended, in words.
    Exited(Party, String),
    /// A scan was recorded; they come in order.
    Recorded(Recorded),
    /// All news of this turn were told; time has passed.
    Tick,
    /// The end of the run was decided.
    RunEnds,
}

/// Something to be done, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Tell everyone whose samples count.
    Authorise(Authority),
    /// Kill the new process.
    KillNew,
    /// The new process is the process of the role from now on; ask the old one to end.
    Commit,
    /// The exchange is over.
    Finish(Box<Certificate>),
}

/// Where an exchange stands, in the words of `scanloop status`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The new process has no output yet.
    Starting,
    /// It computes beside the old one.
    Shadowing,
    /// It is in charge, or about to be; the old one stands by.
    Standby,
    /// All is decided.
    Settling,
    /// The certificate was given.
    Over,
}

/// One exchange from the start of the new process to its certificate.
#[derive(Debug, Clone)]
pub struct Swap {
    plan: Plan,
    stage: Stage,
    since_ns: u64,
    newest: u64,
    answered: u64,
    from_scan: u64,
    until_scan: u64,
    settled_at: u64,
    pairs: BTreeMap<u64, Pair>,
    broken: Option<String>,
    first_new: Option<u64>,
    judged: u32,
    late: u32,
    streak: u64,
    repeats: u32,
    last_good: u64,
    first_output_ns: u64,
    last_output_ns: u64,
    last_fault: String,
    standby_good: u64,
    scan_record: ScanRecord,
    certificate: Certificate,
}

/// The outputs of both for one scan.
#[derive(Debug, Clone, Default)]
struct Pair {
    old: Option<Output>,
    new: Option<Output>,
    seen_ns: u64,
    judged: bool,
}

impl Swap {
    /// An exchange whose new process was just started.
    pub fn new(now_ns: u64, plan: Plan) -> Self {
        let certificate = Certificate {
            role: plan.role.name().to_owned(),
            from: plan.from.clone(),
            to: plan.to.clone(),
            ..Certificate::default()
        };
        Self {
            plan,
            stage: Stage::Starting,
            since_ns: now_ns,
            newest: 0,
            answered: 0,
            from_scan: u64::MAX,
            until_scan: u64::MAX,
            settled_at: 0,
            pairs: BTreeMap::new(),
            broken: None,
            first_new: None,
            judged: 0,
            late: 0,
            streak: 0,
            repeats: 0,
            last_good: 0,
            first_output_ns: 0,
            last_output_ns: 0,
            last_fault: String::new(),
            standby_good: 0,
            scan_record: ScanRecord::default(),
            certificate,
        }
    }

    /// What is exchanged.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Where it stands.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The incarnation that is not to be listened to.
    pub fn candidate(&self) -> u32 {
        let new_is_in_charge = match self.stage {
            Stage::Standby => self.newest >= self.from_scan,
            Stage::Settling | Stage::Over => self.certificate.outcome == SwapOutcome::Swapped,
            Stage::Starting | Stage::Shadowing => false,
        };
        if new_is_in_charge { self.plan.old } else { self.plan.new }
    }

    /// Whether both have answered a scan; in lock-step the loop waits for that.
    pub fn both_answered(&self, scan: u64) -> bool {
        self.pairs.get(&scan).is_some_and(|pair| pair.old.is_some() && pair.new.is_some())
    }

    /// What is to be done, in this order, now that `event` has happened at `now_ns`.
    pub fn handle(&mut self, now_ns: u64, event: Event) -> Vec<Action> {
        let mut actions = Vec::new();
        if self.stage == Stage::Over {
            return actions;
        }
        match event {
            Event::Scans { newest, answered } => {
                self.newest = self.newest.max(newest);
                self.answered = self.answered.max(answered);
            }
            Event::Output(party, output) => self.keep(now_ns, party, output),
            Event::Exited(Party::New, how) => match self.stage {
                Stage::Settling | Stage::Over => {}
                _ => self.give_up(now_ns, format!("the new process ended: {how}"), &mut actions),
            },
            Event::Exited(Party::Old, how) => match self.stage {
                Stage::Starting | Stage::Shadowing => {
                    self.refuse(format!("the old process ended: {how}"), &mut actions);
                }
                // The one that stood by is gone, so there is nothing to go back to.
                Stage::Standby => {
                    let from_scan = self.from_scan.min(self.answered + 1);
                    self.commit(now_ns, from_scan, format!("the old process ended: {how}"), &mut actions);
                }
                Stage::Settling | Stage::Over => {}
            },
            Event::Recorded(recorded) => self.recorded(&recorded),
            Event::Tick => self.tick(now_ns, &mut actions),
            Event::RunEnds => self.run_ends(now_ns, &mut actions),
        }
        actions
    }

    fn keep(&mut self, now_ns: u64, party: Party, output: Output) {
        let scan = output.scan;
        if party == Party::New {
            let fault = match &output.content {
                Err(fault) => Some(fault.clone()),
                Ok(_) if scan > self.newest + PAIRS as u64 => Some("there is no such scan".to_owned()),
                Ok(_) => None,
            };
            if let Some(fault) = fault {
                self.broken.get_or_insert(format!("invalid output for scan {scan}: {fault}"));
                return;
            }
            self.last_output_ns = self.last_output_ns.max(output.published_ns.min(now_ns));
        } else if output.content.is_ok() {
            self.newest = self.newest.max(scan);
        }
        if party == Party::New && self.first_new.is_none() {
            self.first_new = Some(scan);
            self.first_output_ns = now_ns;
            if self.stage == Stage::Starting {
                self.stage = Stage::Shadowing;
            }
        }
        let pair = self.pairs.entry(scan).or_insert(Pair { seen_ns: now_ns, ..Pair::default() });
        let place = if party == Party::Old { &mut pair.old } else { &mut pair.new };
        if place.is_some() && party == Party::New {
            self.repeats += 1;
            if self.repeats >= REPEATS {
                self.broken
                    .get_or_insert(format!("invalid output for scan {scan}: not the first for that scan"));
            }
        }
        place.get_or_insert(output);
        while self.pairs.len() > PAIRS {
            self.pairs.pop_first();
        }
    }

    fn tick(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        if self.stage != Stage::Settling
            && let Some(reason) = self.broken.take()
        {
            return self.give_up(now_ns, reason, actions);
        }
        match self.stage {
            Stage::Starting => {
                if now_ns.saturating_sub(self.since_ns) >= FIRST_OUTPUT_NS {
                    let limit_s = FIRST_OUTPUT_NS / 1_000_000_000;
                    self.refuse(format!("no output within {limit_s} s"), actions);
                }
            }
            Stage::Shadowing | Stage::Standby => self.judge(now_ns, actions),
            Stage::Settling => {
                if self.settled_at == 0 || now_ns.saturating_sub(self.since_ns) >= SETTLE_NS {
                    self.finish(actions);
                }
            }
            Stage::Over => {}
        }
    }

    /// Looks at all scans that can be judged by now, the oldest first.
    fn judge(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let first_new = self.first_new.unwrap_or(u64::MAX);
        let open: Vec<u64> =
            self.pairs.iter().filter(|(_, pair)| !pair.judged).map(|(scan, _)| *scan).collect();
        for scan in open {
            let in_charge = self.stage == Stage::Standby && scan >= self.from_scan;
            if scan < first_new {
                continue;
            }
            let verdict = self.verdict(now_ns, scan, in_charge);
            let Some(pair) = self.pairs.get_mut(&scan) else { continue };
            pair.judged = verdict != Verdict::Open;
            self.judged += u32::from(pair.judged);
            let is_warm = in_charge
                || self.judged > WARM_UP
                    && (self.plan.lockstep || now_ns.saturating_sub(self.first_output_ns) > WARM_UP_NS);
            match verdict {
                Verdict::Open | Verdict::Nothing => {}
                Verdict::Good if in_charge => self.standby_good += 1,
                Verdict::Good => {
                    self.streak = if self.last_good + 1 == scan { self.streak + 1 } else { 1 };
                    self.last_good = scan;
                }
                Verdict::Late(reason) | Verdict::Apart(reason) if !is_warm => {
                    self.streak = 0;
                    self.last_fault = reason;
                }
                Verdict::Late(reason) => {
                    self.late += 1;
                    self.streak = 0;
                    if self.late > FORGIVEN_LATE + self.judged / FORGIVEN_SHARE {
                        return self.give_up(now_ns, reason, actions);
                    }
                    self.last_fault = reason;
                }
                Verdict::Apart(reason) | Verdict::Bad(reason) => {
                    return self.give_up(now_ns, reason, actions);
                }
            }
        }
        if self.stage == Stage::Shadowing && self.streak >= self.plan.shadow_scans {
            self.take_over(actions);
        }
        let timeout_ns =
            FIRST_OUTPUT_NS.saturating_add(self.plan.shadow_scans.saturating_mul(10 * self.plan.period_ns));
        if self.stage == Stage::Shadowing
            && !self.plan.lockstep
            && now_ns.saturating_sub(self.first_output_ns) > timeout_ns
        {
            let (scans, last) = (self.plan.shadow_scans, &self.last_fault);
            let reason =
                format!("not {scans} good scans in a row in {} s; {last}", timeout_ns / 1_000_000_000);
            return self.refuse(reason, actions);
        }
        if self.stage == Stage::Standby && self.standby_good >= self.plan.standby_scans {
            self.commit(now_ns, 0, String::new(), actions);
        }
    }

    /// Authority goes to the new one, from a scan on that nobody works on yet.
    fn take_over(&mut self, actions: &mut Vec<Action>) {
        self.stage = Stage::Standby;
        self.from_scan = self.newest + NOTICE_SCANS;
        self.certificate.shadow_scans = self.streak;
        let (incarnation, previous) = (self.plan.new, self.plan.old);
        actions.push(Action::Authorise(Authority { incarnation, previous, from_scan: self.from_scan }));
    }

    /// The new one has not stood the test: it is refused, or rolled back when it was in charge of a scan.
    fn give_up(&mut self, now_ns: u64, reason: String, actions: &mut Vec<Action>) {
        if self.stage != Stage::Standby || self.newest < self.from_scan {
            return self.refuse(reason, actions);
        }
        let from_scan = (self.answered + 1).max(self.from_scan);
        let (incarnation, previous) = (self.plan.old, self.plan.new);
        actions.push(Action::Authorise(Authority { incarnation, previous, from_scan }));
        actions.push(Action::KillNew);
        self.until_scan = from_scan;
        self.settle(now_ns, from_scan, SwapOutcome::RolledBack, reason);
    }

    fn refuse(&mut self, reason: String, actions: &mut Vec<Action>) {
        if self.stage == Stage::Standby {
            actions.push(Action::Authorise(alone(self.plan.old)));
        }
        actions.push(Action::KillNew);
        self.certificate.shadow_scans = self.streak;
        self.certificate.outcome = SwapOutcome::Refused;
        self.certificate.reason = reason;
        self.over(actions);
    }

    /// The new one stays. `from_scan` is 0, or the first scan that it has to answer instead of one that ended early.
    fn commit(&mut self, now_ns: u64, from_scan: u64, reason: String, actions: &mut Vec<Action>) {
        let authority = if from_scan == 0 {
            alone(self.plan.new)
        } else {
            Authority { incarnation: self.plan.new, previous: self.plan.old, from_scan }
        };
        if from_scan != 0 {
            self.from_scan = self.from_scan.min(from_scan);
        }
        actions.push(Action::Authorise(authority));
        actions.push(Action::Commit);
        self.settle(now_ns, self.from_scan, SwapOutcome::Swapped, reason);
    }

    fn settle(&mut self, now_ns: u64, from_scan: u64, outcome: SwapOutcome, reason: String) {
        self.stage = Stage::Settling;
        self.since_ns = now_ns;
        self.settled_at = ScanRecord::settled_at(from_scan);
        if self.scan_record.reaches(self.settled_at) {
            self.settled_at = 0;
        }
        self.certificate.outcome = outcome;
        self.certificate.reason = reason;
    }

    fn finish(&mut self, actions: &mut Vec<Action>) {
        let swapped = self.certificate.outcome == SwapOutcome::Swapped;
        actions.push(Action::Authorise(alone(if swapped { self.plan.new } else { self.plan.old })));
        self.over(actions);
    }

    fn over(&mut self, actions: &mut Vec<Action>) {
        self.stage = Stage::Over;
        self.scan_record.fill(&mut self.certificate);
        actions.push(Action::Finish(Box::new(self.certificate.clone())));
    }

    fn run_ends(&mut self, now_ns: u64, actions: &mut Vec<Action>) {
        let reason = || "the run ended".to_owned();
        match self.stage {
            // Whoever is in charge has the last word of the run.
            Stage::Standby if self.newest >= self.from_scan => {
                self.commit(now_ns, 0, reason(), actions);
                self.over(actions);
            }
            Stage::Starting | Stage::Shadowing | Stage::Standby => self.refuse(reason(), actions),
            Stage::Settling => self.finish(actions),
            Stage::Over => {}
        }
    }

    fn recorded(&mut self, recorded: &Recorded) {
        let party = self.answered_by(recorded);
        self.scan_record.record(recorded, party);
        if self.stage == Stage::Settling && recorded.scan >= self.settled_at {
            self.settled_at = 0;
        }
    }

    /// Whose sample a recorded answer rests on.
    fn answered_by(&self, recorded: &Recorded) -> Party {
        let has_stamp = |output: &Option<Output>| {
            output.as_ref().is_some_and(|output| output.stamps_ns.contains(&recorded.stamp_ns))
        };
        let pair = self.pairs.get(&recorded.scan).filter(|_| recorded.stamp_ns > 0);
        match pair.map(|pair| (has_stamp(&pair.old), has_stamp(&pair.new))) {
            Some((true, false)) => Party::Old,
            Some((false, true)) => Party::New,
            _ if recorded.scan >= self.from_scan && recorded.scan < self.until_scan => Party::New,
            _ => Party::Old,
        }
    }
}

/// One process counts for all scans.
fn alone(incarnation: u32) -> Authority {
    Authority { incarnation, ..Authority::default() }
}
