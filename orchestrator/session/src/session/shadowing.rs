//! The part of a session that lets processes run in the shadow: one per role, never in charge.

use std::collections::BTreeMap;
use std::thread::JoinHandle;

use handover::shadow::{ShadowOutcome, ShadowReport, Study};
use handover::swap::watch::Watch;
use runtime::monotonic_ns;
use shared_types::{Phase, ProcessState, Role};
use supervision::entry::ProcessEntry;
use supervision::fleet::Fleet;
use supervision::supervisor::{Exit, Supervisor, VisibleState};

use super::Session;
use crate::control::{ProcessStatus, Reply, ShadowRequest};

/// A shadow whose newest output is older than this at the end, or than five periods, has fallen silent [ns].
const SILENT_NS: u64 = 1_000_000_000;
/// How many of the last lines of a process that ended go into the reason.
const WORDS: usize = 3;

/// Shadows of one run.
#[derive(Default)]
pub(crate) struct Shadows {
    asked: Vec<Asked>,
    lanes: Vec<Lane>,
    reports: BTreeMap<u64, ShadowReport>,
    accepted: u64,
}

/// A shadow that was accepted and has not begun.
struct Asked {
    number: u64,
    role: Role,
    entry: ProcessEntry,
    duration_ns: u64,
}

/// A shadow that runs, or whose report is being made.
struct Lane {
    number: u64,
    role: Role,
    incarnation: u32,
    live: String,
    shadow: String,
    watch: Watch,
    /// When it ends [ns]; 0 at once, because the one who asked for it wants that.
    until_ns: u64,
    work: Work,
}

enum Work {
    Running(Box<Study>),
    /// Intervals take a moment that the loop has not got.
    Reporting(JoinHandle<ShadowReport>),
}

impl Shadows {
    /// Whether a role has a shadow.
    pub(super) fn concern(&self, role: Role) -> bool {
        self.lanes.iter().any(|lane| lane.role == role && lane.study().is_some())
            || self.asked.iter().any(|asked| asked.role == role)
    }

    /// Incarnations of all shadows.
    pub(super) fn incarnations(&self) -> impl Iterator<Item = u32> {
        self.lanes.iter().map(|lane| lane.incarnation)
    }

    /// Accepts a shadow, or says why not.
    pub(super) fn ask(&mut self, request: &ShadowRequest, fleet: &Fleet, supervisor: &Supervisor) -> Reply {
        match self.check(request, fleet, supervisor) {
            Ok(entry) => {
                let role = request.successor.role;
                self.accepted += 1;
                let duration_ns = request.duration_ms.saturating_mul(1_000_000);
                self.asked.push(Asked { number: self.accepted, role, entry, duration_ns });
                Reply::Accepted(self.accepted)
            }
            Err(reason) => Reply::Refused(reason),
        }
    }

    fn check(
        &self,
        request: &ShadowRequest,
        fleet: &Fleet,
        supervisor: &Supervisor,
    ) -> Result<ProcessEntry, String> {
        let (role, entry) = (request.successor.role, request.successor.entry(fleet)?);
        if self.concern(role) {
            return Err(format!("a process runs in the shadow of {role} already"));
        }
        request.successor.require_ready(supervisor, "for a shadow")?;
        Ok(entry)
    }

    /// The answer to someone who asks what became of the shadow of that number.
    pub(super) fn result(&self, number: u64) -> Reply {
        match self.reports.get(&number) {
            Some(report) => Reply::Shadow(Box::new(report.clone())),
            None if (1..=self.accepted).contains(&number) => Reply::Pending,
            None => Reply::Refused(format!("there is no shadow of number {number}")),
        }
    }

    /// Ends a shadow at the next turn.
    pub(super) fn end_early(&mut self, number: u64) -> Reply {
        if let Some(lane) = self.lanes.iter_mut().find(|lane| lane.number == number) {
            lane.until_ns = 0;
        }
        Reply::Done
    }
}

impl Session {
    /// Tells the shadows what was published since the last look.
    pub(super) fn observe_shadows(&mut self) -> anyhow::Result<()> {
        let now_ns = monotonic_ns();
        for Lane { role, incarnation, watch, work, .. } in &mut self.shadows.lanes {
            let live = self.directives.current.authority[role.index()].incarnation;
            if let Work::Running(study) = work {
                watch.poll(live, *incarnation, |party, output| study.output(now_ns, party, output))?;
            }
        }
        Ok(())
    }

    /// A process said what it is doing.
    pub(super) fn shadow_received(&mut self, incarnation: u32, state: ProcessState) {
        // One that has just attached waits for a word, which would be repeated only after a while.
        self.directives.changed |= state == ProcessState::Attached
            && self.shadows.incarnations().any(|shadow| shadow == incarnation);
    }

    /// A process ended; whether it was a shadow.
    pub(super) fn shadow_ended(&mut self, role: Role, incarnation: u32, exit: Exit) -> bool {
        let Self { shadows, fleet, .. } = self;
        let Some(lane) = shadows.lanes.iter_mut().find(|lane| lane.incarnation == incarnation) else {
            return false;
        };
        let words = fleet.newest_log_lines(role);
        let last = words[words.len().saturating_sub(WORDS)..].join(" | ");
        let separator = if last.is_empty() { "" } else { ": " };
        lane.finish(ShadowOutcome::Died, format!("the process ended: {exit}{separator}{last}"));
        true
    }

    /// Starts what was asked for, ends what is over, and collects the reports that are done.
    pub(super) fn advance_shadows(&mut self) {
        for asked in std::mem::take(&mut self.shadows.asked) {
            self.begin_shadow(asked);
        }
        let run_ends = !self.conclusion.is_open() || self.supervisor.phase() != Phase::Driving;
        let now_ns = monotonic_ns();
        let Self { shadows, fleet, period_ns, .. } = self;
        for lane in &mut shadows.lanes {
            if let Some((outcome, reason)) = lane.verdict(now_ns, *period_ns, run_ends) {
                fleet.dismiss(lane.incarnation);
                lane.finish(outcome, reason);
            }
        }
        let (done, lanes): (Vec<_>, _) =
            std::mem::take(&mut shadows.lanes).into_iter().partition(Lane::is_done);
        shadows.lanes = lanes;
        for lane in done {
            let number = lane.number;
            if let Some(report) = lane.report() {
                let ShadowReport { role, shadow, outcome, .. } = &report;
                self.progress.note(&format!("{role}: {shadow} in the shadow: {}", outcome.name()));
                shadows.reports.insert(number, report);
            }
        }
    }

    /// Rows of `status` with the shadows.
    pub(super) fn show_shadows(&mut self, processes: &mut Vec<ProcessStatus>) {
        for lane in &self.shadows.lanes {
            let Some((pid, implementation, load)) = self.fleet.candidate(lane.incarnation) else { continue };
            let role = lane.role.name();
            let Some(index) = processes.iter().rposition(|process| process.role == role) else { continue };
            let (rate_hz, last_sample_age_ms) = self.vitals.rate_and_age(lane.incarnation);
            let row = ProcessStatus {
                role: role.to_owned(),
                implementation,
                pid: pid.cast_signed(),
                state: VisibleState::Shadow.name().to_owned(),
                restarts: 0,
                rate_hz,
                last_sample_age_ms,
                cpu_percent: load.cpu_percent,
                memory_kib: load.memory_kib,
                obeys_stop: self.vitals.obeys_stop(lane.incarnation),
                last_words: Vec::new(),
            };
            processes.insert(index + 1, row);
        }
    }

    fn begin_shadow(&mut self, Asked { number, role, entry, duration_ns }: Asked) {
        let (live, shadow) = (self.fleet.label(role), entry.label());
        let incarnation = self.supervisor.next_incarnation();
        match self.start_candidate(role, entry, incarnation) {
            Ok(watch) => {
                self.progress.note(&format!("{role}: {shadow} starts in the shadow of {live}"));
                let study = Study::new(role, self.period_ns, duration_ns / self.period_ns.max(1));
                let until_ns = monotonic_ns().saturating_add(duration_ns);
                let work = Work::Running(Box::new(study));
                let lane = Lane { number, role, incarnation, live, shadow, watch, until_ns, work };
                self.shadows.lanes.push(lane);
            }
            Err(error) => {
                let report = ShadowReport {
                    role: role.name().to_owned(),
                    live,
                    shadow,
                    outcome: ShadowOutcome::Died,
                    reason: format!("could not be started: {error:#}"),
                    ..ShadowReport::default()
                };
                self.shadows.reports.insert(number, report);
            }
        }
    }
}

impl Lane {
    /// The study, while the process runs.
    fn study(&self) -> Option<&Study> {
        match &self.work {
            Work::Running(study) => Some(study),
            Work::Reporting(_) => None,
        }
    }

    /// How it ends and why, if it ends now.
    fn verdict(&self, now_ns: u64, period_ns: u64, run_ends: bool) -> Option<(ShadowOutcome, String)> {
        let last_output_ns = self.study()?.last_output_ns();
        let silent_ns = now_ns.saturating_sub(last_output_ns);
        match self.until_ns {
            0 => Some((ShadowOutcome::Interrupted, String::new())),
            _ if run_ends => Some((ShadowOutcome::RunEnded, String::new())),
            until_ns if now_ns < until_ns => None,
            _ if last_output_ns == 0 => Some((ShadowOutcome::Silent, "it gave no output".to_owned())),
            _ if silent_ns > SILENT_NS.max(5 * period_ns) => {
                let reason = format!("no output in the last {:.1} s", silent_ns as f64 * 1e-9);
                Some((ShadowOutcome::Silent, reason))
            }
            _ => Some((ShadowOutcome::Completed, String::new())),
        }
    }

    /// Makes the report, beside the loop.
    fn finish(&mut self, outcome: ShadowOutcome, reason: String) {
        let Work::Running(study) = &mut self.work else { return };
        let study = std::mem::replace(&mut **study, Study::new(self.role, 0, 0));
        let (live, shadow) = (self.live.clone(), self.shadow.clone());
        let work = move || ShadowReport { live, shadow, outcome, reason, ..study.report() };
        self.work = Work::Reporting(std::thread::spawn(work));
    }

    fn is_done(&self) -> bool {
        matches!(&self.work, Work::Reporting(worker) if worker.is_finished())
    }

    fn report(self) -> Option<ShadowReport> {
        match self.work {
            Work::Reporting(worker) => worker.join().ok(),
            Work::Running(_) => None,
        }
    }
}
