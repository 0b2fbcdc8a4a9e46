//! How a run ends: its outcome is known, the wheels come to rest, answers come in, the processes end. Pure.
//!
//! Each stage has a time after which it is not waited for any longer, so that a robot that does not come to rest and an
//! answer that never comes can't keep a run from ending.

use report::Outcome;

/// A robot that does not come to rest within this time after the stop is not waited for [ns].
const REST_LIMIT_NS: u64 = 1_500_000_000;
/// After the robot was ordered to publish no more, scans without an answer are waited for this long [ns].
const DRAIN_LIMIT_NS: u64 = 300_000_000;

/// How far the end of a run has come, and how it ends.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Conclusion {
    stage: Stage,
    lockstep: bool,
    period_ns: u64,
}

#[derive(Debug, Clone, PartialEq)]
enum Stage {
    /// The robot drives.
    NotYet,
    /// The outcome is known; the wheels are being blocked until this time at the latest.
    Resting(Outcome, String, u64),
    /// The robot publishes no more; answers on their way are waited for until this time at the latest.
    Draining(Outcome, String, u64),
    /// Processes are ending.
    Ending(Outcome, String),
}

/// What is to be done next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// The wheels rest: the robot is to publish no more.
    EndScans,
    /// The answers are in: the processes are to end.
    EndProcesses,
}

impl Conclusion {
    pub(crate) fn new(lockstep: bool, period_ns: u64) -> Self {
        Self { stage: Stage::NotYet, lockstep, period_ns }
    }

    /// Whether the outcome is still open.
    pub(crate) fn is_open(&self) -> bool {
        self.stage == Stage::NotYet
    }

    /// Decides how the run ends, unless that is decided; returns whether it was not.
    pub(crate) fn decide(&mut self, now_ns: u64, outcome: Outcome, reason: String) -> bool {
        let is_new = self.is_open();
        if is_new {
            let limit_ns = if self.lockstep { 0 } else { REST_LIMIT_NS };
            self.stage = Stage::Resting(outcome, reason, now_ns + limit_ns);
        }
        is_new
    }

    /// The run failed before it drove, so the processes end at once; returns whether the outcome was open.
    pub(crate) fn fail(&mut self, reason: String) -> bool {
        let is_new = self.is_open();
        if is_new {
            self.stage = Stage::Ending(Outcome::Failed, reason);
        }
        is_new
    }

    /// The run failed while it ended.
    pub(crate) fn correct(&mut self, why: String) {
        if let Stage::Resting(outcome, reason, _)
        | Stage::Draining(outcome, reason, _)
        | Stage::Ending(outcome, reason) = &mut self.stage
        {
            (*outcome, *reason) = (Outcome::Failed, why);
        }
    }

    /// While the wheels come to rest: how the run ends, and when that was decided [ns].
    pub(crate) fn resting(&self) -> Option<(Outcome, u64)> {
        match &self.stage {
            Stage::Resting(outcome, _, until_ns) => Some((*outcome, until_ns.saturating_sub(REST_LIMIT_NS))),
            _ => None,
        }
    }

    /// Goes to the next stage when the wheels rest or all scans are answered, when the limit of the stage is over, or when
    /// the processes do not drive.
    pub(crate) fn advance(
        &mut self,
        now_ns: u64,
        drives: bool,
        rests: bool,
        is_answered: bool,
    ) -> Option<Step> {
        match self.stage.clone() {
            Stage::Resting(outcome, reason, until_ns) if rests || now_ns >= until_ns || !drives => {
                let limit_ns = if self.lockstep { 0 } else { DRAIN_LIMIT_NS };
                self.stage = Stage::Draining(outcome, reason, now_ns + limit_ns);
                Some(Step::EndScans)
            }
            Stage::Draining(outcome, reason, until_ns) => {
                // One more poll after the robot has received the order to stop publishing.
                let was_received = now_ns + DRAIN_LIMIT_NS >= until_ns + self.period_ns.min(DRAIN_LIMIT_NS);
                let is_over = (is_answered && was_received) || now_ns >= until_ns || !drives;
                is_over.then(|| {
                    self.stage = Stage::Ending(outcome, reason);
                    Step::EndProcesses
                })
            }
            _ => None,
        }
    }

    /// How the run ends and why, once it is decided.
    pub(crate) fn decided(&self) -> Option<(Outcome, &str)> {
        match &self.stage {
            Stage::NotYet => None,
            Stage::Resting(outcome, reason, _)
            | Stage::Draining(outcome, reason, _)
            | Stage::Ending(outcome, reason) => Some((*outcome, reason)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;

    fn decided(lockstep: bool) -> Conclusion {
        let mut end = Conclusion::new(lockstep, PERIOD_NS);
        assert!(end.decide(0, Outcome::Reached, "there".to_owned()));
        end
    }

    #[test]
    fn the_first_decision_holds_until_the_end_fails() {
        let mut end = decided(false);
        assert!(!end.decide(1, Outcome::Timeout, "late".to_owned()) && !end.fail("no".to_owned()));
        assert_eq!(end.decided(), Some((Outcome::Reached, "there")));
        end.correct("the robot does not end".to_owned());
        assert_eq!(end.decided(), Some((Outcome::Failed, "the robot does not end")));
    }

    #[test]
    fn scans_end_when_the_wheels_rest_and_processes_when_all_is_answered() {
        let mut end = decided(false);
        assert_eq!(end.advance(10, true, false, true), None);
        assert_eq!(end.advance(20, true, true, false), Some(Step::EndScans));
        assert_eq!(end.advance(30, true, true, true), None, "the robot may not have received it yet");
        assert_eq!(end.advance(20 + PERIOD_NS, true, true, false), None);
        assert_eq!(end.advance(20 + PERIOD_NS, true, true, true), Some(Step::EndProcesses));
        assert_eq!(end.advance(u64::MAX / 2, true, true, true), None, "it is over");
    }

    #[test]
    fn no_stage_lasts_longer_than_its_limit() {
        let mut end = decided(false);
        assert_eq!(end.advance(REST_LIMIT_NS, true, false, false), Some(Step::EndScans));
        let until_ns = REST_LIMIT_NS + DRAIN_LIMIT_NS;
        assert_eq!(end.advance(until_ns - 1, true, false, false), None);
        assert_eq!(end.advance(until_ns, true, false, false), Some(Step::EndProcesses));
    }

    #[test]
    fn without_driving_processes_and_in_lock_step_no_stage_takes_time() {
        let mut end = decided(false);
        assert_eq!(end.advance(1, false, false, false), Some(Step::EndScans));
        assert_eq!(end.advance(1, false, false, false), Some(Step::EndProcesses));
        let mut end = decided(true);
        assert_eq!(end.advance(1, true, false, false), Some(Step::EndScans));
        assert_eq!(end.advance(1, true, false, false), Some(Step::EndProcesses));
    }
}
