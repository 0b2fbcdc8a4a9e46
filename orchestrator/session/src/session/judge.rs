//! What a run is judged by: the truth, if the robot publishes it, else the estimate.

use emulator::JudgedBy;
use report::Outcome;
use runtime::Wheels;
use shared_types::{Role, Topic};

use super::Session;

/// The implementation of a robot whose true state is known.
const EMULATOR: &str = "emulator";

impl Session {
    /// A robot that has opened the topic `truth` promises to publish on it: without a truth no scan is judged.
    /// Where the loop stands still, one scan without it is enough.
    pub(super) fn require_truth(&mut self, is_stalled: bool) {
        if let Some(scan) = self.samples.truth_missing(is_stalled) {
            let robot = self.fleet.label(Role::Robot);
            let reason = format!(
                "robot ({robot}) has opened the topic truth, and published none since scan {scan}; one that does not know \
                 its true state must not open it"
            );
            self.decide(Outcome::Failed, &reason);
        }
    }

    /// Finds out what decides the outcome: the truth, if the robot has opened its topic by now.
    pub(super) fn find_judge(&mut self) -> anyhow::Result<()> {
        if self.judged_by.is_some() {
            return Ok(());
        }
        // The link has opened all topics that come from another host, where built-in implementations run only.
        let elsewhere = self.fleet.entry(Role::Robot).filter(|entry| entry.host.is_some());
        let knows_truth = elsewhere.map(|entry| entry.implementation.as_deref() == Some(EMULATOR));
        if knows_truth.map_or_else(|| self.bus.has_publisher(Topic::Truth), Ok)? {
            self.judge_by(JudgedBy::Truth);
        } else {
            let robot = self.fleet.label(Role::Robot);
            self.note(&format!(
                "robot ({robot}) publishes no truth: the run is judged by the estimate, and collisions are not seen"
            ));
            self.judge_by(JudgedBy::Estimate);
        }
        Ok(())
    }

    pub(super) fn judge_by(&mut self, judged_by: JudgedBy) {
        self.judged_by = Some(judged_by);
        if judged_by == JudgedBy::Estimate {
            self.samples.expect_no_truth();
            self.recording.recorder.expect_no_truth();
        }
    }

    /// Whether the wheels rest since the end was decided. Without a truth the robot reports it; for one that does not,
    /// the limit of the conclusion counts.
    pub(super) fn rests(&self) -> bool {
        let Some((outcome, decided_ns)) = self.conclusion.resting() else { return false };
        // The referee has seen it stand.
        let stood =
            matches!(outcome, Outcome::Reached | Outcome::Missed | Outcome::Stopped | Outcome::Collision);
        if self.judged_by == Some(JudgedBy::Estimate) {
            let (wheels, reported_ns) = self.run.stop_word.wheels(Role::Robot);
            return stood || wheels == Wheels::Resting && reported_ns > decided_ns;
        }
        let newest = self.samples.newest_truth().or(self.recording.recorder.last_truth());
        newest.is_some_and(|truth| {
            truth.speed_mps == 0.0 && (stood || truth.blocked == 1 && truth.header.acquired_ns > decided_ns)
        })
    }
}
