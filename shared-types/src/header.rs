//! The header of all samples, with the stamps of a scan on its way through the stages.

use crate::describe::layout;
use crate::{Role, SLOTS};

/// Data younger than this is never too old, whatever the scan rate: the fastest such scanners take as long per scan
/// [ns].
pub const YOUNG_NS: u64 = 25_000_000;

layout! {
    /// When one stage worked on a scan. Zero means that the stage has not been reached.
    pub struct StageStamps(32) {
        /// When the stage was woken for the scan [ns]
        pub woken_ns: u64,
        /// When all of its inputs were taken [ns]
        pub taken_ns: u64,
        /// When its computation was done [ns]
        pub computed_ns: u64,
        /// When its output was published [ns]
        pub published_ns: u64,
    }
}

layout! {
    /// First field of every sample: identity, and stamps from the scan on.
    ///
    /// All stamps are nanoseconds of CLOCK_MONOTONIC, or of the simulated clock in lock-step.
    pub struct Header(288) {
        /// Layout version of the sample, `Sample::LAYOUT`
        pub layout: u32,
        /// Incarnation of the producer: one number per started process, given by the orchestrator
        pub incarnation: u32,
        /// The scan that this sample belongs to; the first scan of a run is 1
        pub scan_id: u64,
        /// Number of the sample among those of its producer on its topic, from 1 without gaps
        pub sequence: u64,
        /// When the front beam of the scan was taken [ns]
        pub acquired_ns: u64,
        /// Stamps of all stages on the way to this sample, by slot: the five roles come first
        pub chain: [StageStamps; SLOTS],
    }
}

impl Header {
    /// The header of an answer to `self`: same scan, with the chain of `self`.
    ///
    /// Layout, incarnation, sequence and stamps of the answering stage are filled when it publishes.
    #[must_use]
    pub fn answer(&self) -> Self {
        Self { layout: 0, incarnation: 0, sequence: 0, ..*self }
    }

    /// The header of an answer to two inputs of one scan, with the stamps of both.
    #[must_use]
    pub fn answer_both(&self, other: &Self) -> Self {
        let mut header = self.answer();
        for (mine, theirs) in header.chain.iter_mut().zip(&other.chain) {
            if mine.published_ns == 0 {
                *mine = *theirs;
            }
        }
        header
    }

    /// The header that the next sample of this publisher will have, except for its stamps.
    #[must_use]
    pub fn next(&self, period_ns: u64) -> Self {
        Self {
            scan_id: self.scan_id.saturating_add(1),
            sequence: self.sequence.saturating_add(1),
            acquired_ns: self.acquired_ns.saturating_add(period_ns),
            ..*self
        }
    }

    /// Stamps of one stage.
    pub fn stage(&self, role: Role) -> &StageStamps {
        &self.chain[role.index()]
    }

    /// Stamps of one stage, to fill them.
    pub fn stage_mut(&mut self, role: Role) -> &mut StageStamps {
        &mut self.chain[role.index()]
    }

    /// When the scan was published [ns], zero when this sample has no scan behind it.
    pub fn scan_published_ns(&self) -> u64 {
        self.stage(Role::Robot).published_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_to_two_inputs_carries_the_stamps_of_both() {
        let (mut pose, mut obstacles) = (Header::default(), Header::default());
        pose.scan_id = 7;
        pose.stage_mut(Role::Estimator).published_ns = 11;
        obstacles.stage_mut(Role::Obstacles).published_ns = 13;
        let answer = obstacles.answer_both(&pose);
        assert_eq!(answer.stage(Role::Estimator).published_ns, 11);
        assert_eq!(answer.stage(Role::Obstacles).published_ns, 13);
    }
}
