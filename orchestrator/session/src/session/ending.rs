//! How a run ends: what decides it, and the order in which scans and processes end.

use audit::samples::{MAX_DEVIATING, ScanRecord};
use report::Outcome;
use runtime::{Wheels, monotonic_ns};
use shared_types::{DrivenBy, Phase, Role, StopReason};
use supervision::supervisor::{Event, ProcessExit};

use super::Session;
use super::conclusion::Step;

/// The newest directive may be so old when this process stops [s].
const DIRECTIVE_AGE_S: f64 = 0.2;

impl Session {
    /// Ends a run in real time by the clock of this computer, where no stamps of scans do.
    pub(super) fn end_by_clock(&mut self) {
        if self.run.lockstep || !self.drives() || self.driven_by() != DrivenBy::Controller {
            self.limits.hold(monotonic_ns());
        } else if let Some((outcome, reason)) = self.limits.count(monotonic_ns()) {
            self.decide(outcome, &reason);
        }
    }

    /// Ends the run when processes have ended themselves because this one stood still for so long.
    pub(super) fn notice_stall(&mut self) {
        let limit_s = self.run.orphan_timeout_s;
        let pause_s = self.limits.stood_still_s(monotonic_ns());
        if let Some(pause_s) = pause_s.filter(|pause_s| pause_s + DIRECTIVE_AGE_S >= limit_s) {
            self.decide(
                Outcome::Failed,
                &format!(
                    "the orchestrator stood still for {pause_s:.1} s: processes end after `orphan_timeout_s`, {limit_s} s, \
                     without it"
                ),
            );
        }
    }

    /// Blocks the wheels by the stop word and ends the run when the actuator turns them against a command to block them,
    /// or several times otherwise than commanded: it would not obey a directive either.
    pub(super) fn require_obedience(&mut self, scan: &ScanRecord) {
        self.deviating = if scan.deviates() { self.deviating + 1 } else { 0 };
        if self.conclusion.is_open() && (scan.is_disobeyed() || self.deviating > MAX_DEVIATING) {
            let (label, scan_id) = (self.fleet.label(Role::Actuator), scan.header.scan_id);
            let what = match scan.is_disobeyed() {
                true => "it drives although the command blocks the wheels",
                false => "it drives otherwise than commanded",
            };
            self.decide(Outcome::Failed, &format!("actuator ({label}): {what}, scan {scan_id}"));
            self.run.stop_word.latch();
        }
    }

    /// Decides how the run ends, if that is open.
    pub(super) fn decide(&mut self, outcome: Outcome, reason: &str) {
        if self.conclusion.is_open() {
            let is_explained = !matches!(outcome, Outcome::Stopped | Outcome::Timeout);
            let reason = match is_explained {
                true => reason.to_owned(),
                false => reason.to_owned() + &self.named_cause(reason) + &self.blame(),
            };
            let text = format!("{}: {reason}", outcome.name());
            self.keep(outcome != Outcome::Reached, &text);
            self.conclusion.decide(monotonic_ns(), outcome, reason);
            self.directives.stop();
            if outcome != Outcome::Reached {
                self.incident();
            }
        }
    }

    /// The pause of this process, the obstacle or the scanner that the wheels are blocked for, as a continuation of the
    /// reason for the end.
    pub(super) fn named_cause(&self, reason: &str) -> String {
        if !self.run.lockstep
            && let Some(pause_s) = self.limits.stood_still_s(monotonic_ns())
        {
            return format!("; the orchestrator stood still for {pause_s:.1} s");
        }
        if let Some(scanner) = self.recording.recorder.stopped_for_scanner() {
            let start = if reason.ends_with(StopReason::Scanner.name()) { "" } else { "; scanner" };
            return format!("{start} {scanner}");
        }
        let start = if reason.ends_with(StopReason::Blocked.name()) { " by" } else { "; blocked by" };
        let blocking = self.recording.recorder.stopped_for();
        blocking.map_or_else(String::new, |blocking| format!("{start} {blocking}"))
    }

    /// Ends the run when it was stopped from outside, or this process was asked to end.
    pub(super) fn heed_stop(&mut self) {
        if self.shutdown.requested() {
            self.decide(Outcome::Interrupted, "interrupted by a signal");
        }
        if !self.run.stop_word.is_armed() {
            self.decide(Outcome::Interrupted, "stopped by command");
        }
    }

    /// Moves the end of the run on: wheels at rest, scans answered, processes ended.
    pub(super) fn advance_end(&mut self) -> anyhow::Result<()> {
        self.heed_stop();
        let drives = self.supervisor.phase() == Phase::Driving;
        let is_answered = self.samples.answered_scan() >= self.samples.newest_scan();
        match self.conclusion.advance(monotonic_ns(), drives, self.rests(), is_answered) {
            Some(Step::EndScans) => self.directives.enter(Phase::Stopping),
            Some(Step::EndProcesses) => {
                self.end_counting();
                self.handle(Event::StopRequested)?;
            }
            None => {}
        }
        Ok(())
    }

    /// From now on a process that ends has not died, and a scan without an answer is not lost.
    pub(super) fn end_counting(&mut self) {
        self.recording.recorder.run_ended();
        self.audit.samples.run_ended();
    }

    /// Whether the robot is known to rest: by its own report, or by the truth of an emulated one that does not report.
    pub(super) fn robot_rests(&self) -> bool {
        let (wheels, _) = self.run.stop_word.wheels(Role::Robot);
        let newest = self.samples.newest_truth().or(self.recording.recorder.last_truth());
        match wheels {
            Wheels::Resting => true,
            // Without a report and without a truth only a robot without any actuation is known to rest.
            Wheels::Unknown => newest.map_or_else(
                || self.samples.recent_actuations().next().is_none(),
                |truth| truth.speed_mps == 0.0,
            ),
            Wheels::Turning | Wheels::Blocked => false,
        }
    }

    /// A robot that does not end and is not known to rest is left: no other process could stop it.
    pub(super) fn leave_robot(&mut self) -> Option<Event> {
        let role = Role::Robot;
        let incarnation = self.fleet.incarnation(role);
        let pid = self.fleet.leave(role)?;
        let text = format!("robot {pid} does not end, and is not known to rest: it is left");
        self.warn(&text);
        self.conclusion.correct(text);
        Some(Event::Exited { role, incarnation, exit: ProcessExit::Unknown })
    }
}
