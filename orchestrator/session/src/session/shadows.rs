//! The shadows of one run: one per role, never in charge. Pure: the session carries out the [`Order`]s.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use handover::shadow::{ShadowOutcome, ShadowReport, Study};
use handover::swap::{Party, SwapOutput};
use shared_types::Role;
use supervision::entry::ProcessEntry;

use super::candidates::{Live, Order};
use crate::control::{Reply, ShadowRequest};

/// A shadow whose newest output is older than this at the end, or than five periods, has fallen silent [ns].
const SILENT_NS: u64 = 1_000_000_000;

/// The shadows of one run.
#[derive(Default)]
pub(crate) struct Shadows {
    period_ns: u64,
    asked: Vec<Asked>,
    begun: Vec<Shadow>,
    reports: BTreeMap<u64, ShadowReport>,
    accepted: u64,
}

/// A shadow that was accepted and has not begun.
pub(super) struct Asked {
    number: u64,
    pub(super) entry: ProcessEntry,
    live: String,
    duration_ns: u64,
}

/// A shadow that runs, or whose report is being made.
struct Shadow {
    number: u64,
    role: Role,
    incarnation: u32,
    live: String,
    label: String,
    /// When it ends [ns]; 0 at once, on request.
    until_ns: u64,
    work: Work,
}

enum Work {
    Running(Box<Study>),
    /// Intervals take a second for many scans, too long for the loop.
    Reporting(JoinHandle<Option<ShadowReport>>),
    /// Made at once, where the machine gives no thread.
    Reported(Box<ShadowReport>),
}

impl Shadows {
    pub(super) fn new(period_ns: u64) -> Self {
        Self { period_ns, ..Self::default() }
    }

    /// Whether a role has a shadow.
    pub(super) fn concern(&self, role: Role) -> bool {
        self.running().any(|(of, _)| of == role) || self.asked.iter().any(|asked| asked.entry.role() == role)
    }

    /// Incarnations of all shadows that have begun.
    pub(super) fn incarnations(&self) -> impl Iterator<Item = (Role, u32)> {
        self.begun.iter().map(|shadow| (shadow.role, shadow.incarnation))
    }

    /// Roles and incarnations of the shadows that run.
    pub(super) fn running(&self) -> impl Iterator<Item = (Role, u32)> {
        let running = self.begun.iter().filter(|shadow| matches!(shadow.work, Work::Running(_)));
        running.map(|shadow| (shadow.role, shadow.incarnation))
    }

    /// Accepts a shadow and returns its number.
    ///
    /// # Errors
    /// The reason why it is refused.
    pub(super) fn ask(&mut self, request: &ShadowRequest, live: &Live) -> Result<u64, String> {
        let entry = request.successor.entry(live.entry, live.hosts)?;
        if self.concern(entry.role()) {
            return Err(format!("a process runs in the shadow of {} already", entry.role()));
        }
        live.require_ready("for a shadow")?;
        self.accepted += 1;
        let (number, duration_ns) = (self.accepted, request.duration_ms.saturating_mul(1_000_000));
        self.asked.push(Asked { number, entry, live: live.entry.label(), duration_ns });
        Ok(number)
    }

    /// The report of the shadow of that number, if it is there.
    pub(super) fn result(&self, number: u64) -> Reply {
        match self.reports.get(&number) {
            Some(report) => Reply::Shadow(Box::new(report.clone())),
            None if (1..=self.accepted).contains(&number) => Reply::Pending,
            None => Reply::Refused(format!("there is no shadow of number {number}")),
        }
    }

    /// Ends a shadow at the next turn.
    pub(super) fn end_early(&mut self, number: u64) -> Reply {
        if let Some(shadow) = self.begun.iter_mut().find(|shadow| shadow.number == number) {
            shadow.until_ns = 0;
        }
        Reply::Done
    }

    /// The shadows that are to be started now.
    pub(super) fn take_asked(&mut self) -> Vec<Asked> {
        std::mem::take(&mut self.asked)
    }

    /// A shadow was started under that incarnation, or could not be.
    pub(super) fn begin(
        &mut self,
        now_ns: u64,
        asked: Asked,
        incarnation: u32,
        started: Result<(), String>,
    ) -> Option<Order> {
        let Asked { number, entry, live, duration_ns } = asked;
        let (role, label) = (entry.role(), entry.label());
        if let Err(error) = started {
            let (outcome, reason) = (ShadowOutcome::Died, format!("could not be started: {error}"));
            let of_role = ShadowReport { role: role.name().to_owned(), ..ShadowReport::default() };
            self.reports.insert(number, ShadowReport { live, shadow: label, outcome, reason, ..of_role });
            return None;
        }
        let note = format!("{role}: {label} starts in the shadow of {live}");
        let study = Study::new(role, self.period_ns, duration_ns / self.period_ns.max(1));
        let (until_ns, work) = (now_ns.saturating_add(duration_ns), Work::Running(Box::new(study)));
        self.begun.push(Shadow { number, role, incarnation, live, label, until_ns, work });
        Some(Order::Note(note))
    }

    /// An output of a shadow, or of the live process for comparison.
    pub(super) fn output(&mut self, now_ns: u64, incarnation: u32, party: Party, output: SwapOutput) {
        let shadow = self.begun.iter_mut().find(|shadow| shadow.incarnation == incarnation);
        if let Some(Work::Running(study)) = shadow.map(|shadow| &mut shadow.work) {
            study.output(now_ns, party, output);
        }
    }

    /// A process ended; whether it was a shadow.
    pub(super) fn ended(&mut self, incarnation: u32, reason: impl FnOnce() -> String) -> bool {
        let shadow = self.begun.iter_mut().find(|shadow| shadow.incarnation == incarnation);
        let is_shadow = shadow.is_some();
        if let Some(shadow) = shadow {
            shadow.finish(ShadowOutcome::Died, format!("the process ended: {}", reason()));
        }
        is_shadow
    }

    /// Ends the shadows that are over, and collects the reports that are done.
    pub(super) fn advance(&mut self, now_ns: u64, run_ends: bool) -> Vec<Order> {
        let mut orders = Vec::new();
        for shadow in &mut self.begun {
            if let Some((outcome, reason)) = shadow.verdict(now_ns, self.period_ns, run_ends) {
                orders.push(Order::Dismiss(shadow.incarnation));
                shadow.finish(outcome, reason);
            }
        }
        for shadow in self.begun.extract_if(.., |shadow| shadow.is_done()) {
            let report = match shadow.work {
                Work::Running(_) => continue,
                Work::Reporting(worker) => worker.join().ok().flatten(),
                Work::Reported(report) => Some(*report),
            };
            let Some(report) = report else { continue };
            let ShadowReport { role, shadow: label, outcome, .. } = &report;
            orders.push(Order::Note(format!("{role}: {label} in the shadow: {}", outcome.name())));
            self.reports.insert(shadow.number, report);
        }
        orders
    }
}

impl Shadow {
    /// How it ends and why, if it ends now.
    fn verdict(&self, now_ns: u64, period_ns: u64, run_ends: bool) -> Option<(ShadowOutcome, String)> {
        let Work::Running(study) = &self.work else { return None };
        let last_output_ns = study.last_output_ns();
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

    /// Makes the report in a thread of its own.
    fn finish(&mut self, outcome: ShadowOutcome, reason: String) {
        let Work::Running(study) = &mut self.work else { return };
        let study = std::mem::replace(&mut **study, Study::new(self.role, 0, 0));
        let (live, shadow) = (self.live.clone(), self.label.clone());
        let make = move |study: Study| ShadowReport { live, shadow, outcome, reason, ..study.report() };
        // A thread that can't be started leaves it here.
        let place = Arc::new(Mutex::new(Some((study, make))));
        let taken = |place: &Mutex<Option<_>>| place.lock().ok().and_then(|mut place| place.take());
        let work = {
            let place = Arc::clone(&place);
            move || taken(&place).map(|(study, make)| make(study))
        };
        self.work = match std::thread::Builder::new().name("shadow".to_owned()).spawn(work) {
            Ok(worker) => Work::Reporting(worker),
            Err(_) => match taken(&place) {
                Some((study, make)) => Work::Reported(Box::new(make(study))),
                None => return,
            },
        };
    }

    fn is_done(&self) -> bool {
        match &self.work {
            Work::Running(_) => false,
            Work::Reporting(worker) => worker.is_finished(),
            Work::Reported(_) => true,
        }
    }
}

#[cfg(test)]
mod tests;
