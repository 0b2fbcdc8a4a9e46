//! Counts samples that the recorder missed.

use std::collections::BTreeMap;

use shared_types::{Header, TOPICS, Topic};

/// A jump of the numbers beyond this is none that samples could have been published in.
const MAX_GAP: u64 = u32::MAX as u64;
/// So many publishers are known at most; the one that was silent for longest is forgotten.
const MAX_PUBLISHERS: usize = 1024;

/// The newest sequence number of each publisher, and how many are missing.
#[derive(Debug, Default)]
pub(super) struct Losses {
    /// By channel and incarnation; with the place of the sample among all.
    newest: BTreeMap<(usize, u32), (u64, u64)>,
    samples: u64,
    lost: u64,
}

impl Losses {
    /// Counts the gap in front of a sample. Checkpoints are not counted: few of them are recorded.
    pub(super) fn note(&mut self, topic: Topic, bytes: &[u8]) {
        if topic == Topic::Checkpoint {
            return;
        }
        let header = (topic.sample_type().header)(bytes);
        // All directives are of one publisher.
        let incarnation = if topic == Topic::Directive { 0 } else { header.incarnation };
        self.note_number(topic as usize, incarnation, header.sequence);
    }

    /// The same of a topic of the system, by its place among them.
    pub(super) fn note_own(&mut self, index: usize, header: &Header) {
        self.note_number(TOPICS.len() + index, header.incarnation, header.sequence);
    }

    fn note_number(&mut self, channel: usize, incarnation: u32, sequence: u64) {
        let publisher = (channel, incarnation);
        if self.newest.len() >= MAX_PUBLISHERS
            && !self.newest.contains_key(&publisher)
            && let Some((silent, _)) = self.newest.iter().min_by_key(|(_, (_, place))| *place)
        {
            let silent = *silent;
            self.newest.remove(&silent);
        }
        self.samples += 1;
        let (newest, place) = self.newest.entry(publisher).or_insert((sequence, 0));
        *place = self.samples;
        let gap = sequence.saturating_sub(newest.saturating_add(1));
        self.lost += if gap > MAX_GAP { 0 } else { gap };
        *newest = sequence.max(*newest);
    }

    /// Whether the heartbeat is the first of its process.
    pub(super) fn is_first(&self, topic: Topic, incarnation: u32) -> bool {
        topic == Topic::Heartbeat && !self.newest.contains_key(&(topic as usize, incarnation))
    }

    /// Samples missed until now.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use shared_types::Pose;

    use super::*;

    #[test]
    fn a_gap_in_the_numbers_of_a_publisher_is_lost() {
        let mut losses = Losses::default();
        for (incarnation, sequence) in [(1, 4), (1, 5), (2, 1), (1, 8), (2, 2)] {
            let header = Header { incarnation, sequence, ..Header::default() };
            losses.note(Topic::Pose, bytemuck::bytes_of(&Pose { header, ..Pose::default() }));
        }
        assert_eq!(losses.lost(), 2);
        for (index, sequence) in [(0, 1), (1, 1), (0, 3), (1, 1 << 63), (1, u64::MAX)] {
            losses.note_own(index, &Header { incarnation: 1, sequence, ..Header::default() });
        }
        assert_eq!(losses.lost(), 3, "numbers that no publisher can have reached are not missing samples");
    }

    #[test]
    fn of_many_publishers_those_that_publish_are_known() {
        let mut losses = Losses::default();
        for incarnation in 2..=10_000 {
            losses.note_own(0, &Header { incarnation: 1, sequence: incarnation.into(), ..Header::default() });
            losses.note_own(0, &Header { incarnation, sequence: 1, ..Header::default() });
        }
        assert_eq!((losses.newest.len(), losses.lost()), (MAX_PUBLISHERS, 0));
        losses.note_own(0, &Header { incarnation: 1, sequence: 10_002, ..Header::default() });
        assert_eq!(losses.lost(), 1);
    }
}
