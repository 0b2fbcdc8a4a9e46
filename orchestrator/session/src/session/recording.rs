//! What becomes of the recorded scans of a run: its report, its digests, its outcome.

use audit::digest::Digests;
use audit::samples::ScanRecord;
use emulator::{Referee, Scenario};
use report::Outcome;
use report::recorder::{Recorder, RunInfo};
use shared_types::Truth;

use crate::startup::RunOptions;

/// Receives every scan that was recorded.
pub(crate) type ScanObserver = Box<dyn FnMut(&ScanRecord)>;

/// Report, digests and referee of a run.
pub(crate) struct Recording {
    pub(crate) recorder: Recorder,
    pub(crate) digests: Digests,
    referee: Referee,
    lockstep: bool,
    duration_s: Option<f64>,
    /// Receives every recorded scan: for benches.
    pub(crate) observer: Option<ScanObserver>,
}

impl Recording {
    pub(super) fn new(
        run_id: &str,
        scenario: &Scenario,
        options: &RunOptions,
        first_scan: u64,
        period_ns: u64,
    ) -> Self {
        let info = RunInfo {
            run_id: run_id.to_owned(),
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            surroundings: scenario.track.surroundings,
            lockstep: options.lockstep,
            first_scan,
            period_ns,
            goal_m: [scenario.goal.x_m, scenario.goal.y_m],
        };
        Self {
            recorder: Recorder::new(info),
            digests: Digests::default(),
            referee: Referee::new(scenario),
            lockstep: options.lockstep,
            duration_s: options.duration_s,
            observer: None,
        }
    }

    /// Adds a complete scan; scans come in order.
    pub(super) fn add(&mut self, scan: &ScanRecord) {
        if self.lockstep {
            self.digest(scan);
        }
        if let Some(observer) = &mut self.observer {
            observer(scan);
        }
        scan.poses.iter().for_each(|pose| self.recorder.pose(pose));
        scan.obstacles.iter().for_each(|obstacles| self.recorder.obstacles(obstacles));
        scan.commands.iter().for_each(|command| self.recorder.command(command));
        self.recorder.truth(&scan.truth);
        if scan.missing {
            self.recorder.scan_missing();
        }
        scan.actuations.iter().for_each(|actuation| self.recorder.actuation(actuation));
    }

    /// In lock-step equal runs have equal samples; in real time stamps differ.
    fn digest(&mut self, scan: &ScanRecord) {
        self.digests.add(&scan.truth);
        scan.poses.iter().for_each(|sample| self.digests.add(sample));
        scan.obstacles.iter().for_each(|sample| self.digests.add(sample));
        scan.commands.iter().for_each(|sample| self.digests.add(sample));
        scan.actuations.iter().for_each(|sample| self.digests.add(sample));
    }

    /// How the run ends and why, if this scan decides it.
    pub(super) fn judge(&mut self, truth: &Truth) -> Option<(Outcome, String)> {
        if let Some(outcome) = self.referee.observe(truth, self.recorder.last_actuation()) {
            return Some((outcome, self.referee.reason().to_owned()));
        }
        let is_over = self.duration_s.is_some_and(|duration_s| truth.time_s >= duration_s);
        is_over.then(|| (Outcome::Timeout, "the duration asked for is over".to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    #[test]
    fn a_run_of_limited_duration_ends_with_the_first_scan_after_it() {
        let scenario: Scenario = toml::from_str("").unwrap();
        let options =
            RunOptions { lockstep: true, duration_s: Some(2.0), quiet: true, out: PathBuf::from("/") };
        let mut recording = Recording::new("run", &scenario, &options, 1, 100_000_000);
        let truth = |time_s| Truth { time_s, ..Truth::default() };
        assert_eq!(recording.judge(&truth(1.9)), None);
        let (outcome, reason) = recording.judge(&truth(2.0)).unwrap();
        assert_eq!((outcome, reason.as_str()), (Outcome::Timeout, "the duration asked for is over"));
    }
}
