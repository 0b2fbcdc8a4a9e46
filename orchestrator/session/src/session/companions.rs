//! Companions in the loop of the session: what they are told, what has happened to them, and how they end.

use report::Outcome;
use runtime::{Silence, monotonic_ns, wait_for};
use shared_types::{Phase, ProcessState};
use supervision::fleet::companions::CompanionEvent;

use super::Session;

/// The start waits this long for companions in lock-step and for those that are needed [ns].
const START_LIMIT_NS: u64 = 15_000_000_000;
/// Time between two polls while it waits [ns].
const POLL_NS: u64 = 1_000_000;
/// After the last process of the loop, companions end within this time: they are killed after `grace_ms` [ns].
const END_LIMIT_NS: u64 = 5_000_000_000;
/// At the end of lock-step, samples of the last scan may still be on their way for so long [ns].
const LAST_SAMPLES_NS: u64 = 1_000_000_000;

impl Session {
    /// Tells companions the phase and whose samples count.
    pub(super) fn announce_to_companions(&self) {
        let directive = &self.directives.current;
        self.companions.announce(directive.phase, &directive.authority);
    }

    /// Starts and judges companions.
    pub(super) fn advance_companions(&mut self) -> anyhow::Result<()> {
        self.announce_to_companions();
        let recorded_scan = self.swaps.recorded_scan();
        self.judge_companions(recorded_scan, self.samples.newest_scan())?;
        self.companions.digest(recorded_scan, &mut self.recording.digests)?;
        Ok(())
    }

    fn judge_companions(&mut self, recorded_scan: u64, newest_scan: u64) -> anyhow::Result<()> {
        let (events, certificates) = self.companions.advance(recorded_scan, newest_scan)?;
        events.into_iter().for_each(|event| self.note_companion(event));
        certificates.iter().for_each(|certificate| self.progress.note(&certificate.to_string()));
        Ok(())
    }

    /// Takes what companions and readers of their topics have counted, and names new drops.
    pub(super) fn reconcile_companions(&mut self, drives: bool) {
        for drop in self.companions.reconcile(drives) {
            self.warn(&drop);
        }
    }

    fn note_companion(&mut self, event: CompanionEvent) {
        if !self.conclusion.is_open() {
            return;
        }
        match event {
            CompanionEvent::Ended(name, how, lines) => {
                self.bus.clean_up_dead_processes();
                self.progress.warn(&format!("companion {name} ended: {how}"));
                lines.iter().for_each(|line| self.progress.note(&format!("  {name}: {line}")));
            }
            CompanionEvent::Hung(name) => {
                self.progress.warn(&format!("companion {name} makes no progress: killed"));
            }
            CompanionEvent::LeftLockstep(name, scan) => {
                let text =
                    format!("companion {name} left scan {scan} unanswered: lock-step continues without it");
                self.progress.warn(&text);
            }
            CompanionEvent::SuccessorEnded(name, how, lines) => {
                self.bus.clean_up_dead_processes();
                self.progress.warn(&format!("companion {name}: its successor ended: {how}"));
                lines.iter().for_each(|line| self.progress.note(&format!("  {name}: {line}")));
            }
            // Their certificate names it.
            CompanionEvent::TakesOver(..) | CompanionEvent::Replaced(..) => {}
            CompanionEvent::Failed(name, true) => {
                self.decide(Outcome::Failed, &format!("companion {name}, which the run needs, has failed"));
            }
            CompanionEvent::Failed(name, false) => {
                self.progress.warn(&format!("companion {name} has failed: the robot drives on without it"));
            }
        }
    }

    /// Waits for companions before the processes of the loop connect, and before the first scan: ports that do not exist
    /// yet would lose samples.
    pub(super) fn await_companions(&mut self, state: ProcessState) -> anyhow::Result<()> {
        let (began_ns, mut silence) = (monotonic_ns(), Silence::default());
        while !self.companions.have_reached(state) && silence.since(began_ns, monotonic_ns()) < START_LIMIT_NS
        {
            if self.shutdown.requested() || !self.run.stop_word.is_armed() {
                return Ok(());
            }
            self.announce_to_companions();
            self.judge_companions(0, 0)?;
            wait_for(&[self.shutdown.descriptor()], POLL_NS);
        }
        Ok(())
    }

    /// Ends companions after the last process of the loop, and takes the last samples of lock-step.
    pub(super) fn end_companions(&mut self) -> anyhow::Result<()> {
        let recorded_scan = self.swaps.recorded_scan();
        let end_ns = monotonic_ns() + LAST_SAMPLES_NS;
        while self.run.lockstep && self.companions.delays(recorded_scan) && monotonic_ns() < end_ns {
            wait_for(&[], POLL_NS);
        }
        self.companions.digest(recorded_scan, &mut self.recording.digests)?;
        self.companion_reports = self.companions.reports();
        self.reconcile_companions(false);
        self.companions.announce(Phase::Stopping.wire(), &self.directives.current.authority);
        self.companions.end();
        let end_ns = monotonic_ns() + END_LIMIT_NS;
        while !self.companions.have_ended() && monotonic_ns() < end_ns {
            wait_for(&[], POLL_NS);
        }
        Ok(())
    }
}
