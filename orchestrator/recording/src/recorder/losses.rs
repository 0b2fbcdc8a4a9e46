//! Counts samples that the recorder missed.

use std::collections::BTreeMap;

use shared_types::Topic;

/// The newest sequence number of each publisher, and how many are missing.
#[derive(Debug, Default)]
pub(super) struct Losses {
    newest: BTreeMap<(Topic, u32), u64>,
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
        let newest = self.newest.entry((topic, incarnation)).or_insert(header.sequence);
        self.lost += header.sequence.saturating_sub(*newest + 1);
        *newest = header.sequence.max(*newest);
    }

    /// Whether the heartbeat is the first of its process.
    pub(super) fn is_first(&self, topic: Topic, incarnation: u32) -> bool {
        topic == Topic::Heartbeat && !self.newest.contains_key(&(topic, incarnation))
    }

    /// Samples missed until now.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use shared_types::{Header, Pose};

    use super::*;

    #[test]
    fn a_gap_in_the_numbers_of_a_publisher_is_lost() {
        let mut losses = Losses::default();
        for (incarnation, sequence) in [(1, 4), (1, 5), (2, 1), (1, 8), (2, 2)] {
            let header = Header { incarnation, sequence, ..Header::default() };
            losses.note(Topic::Pose, bytemuck::bytes_of(&Pose { header, ..Pose::default() }));
        }
        assert_eq!(losses.lost(), 2);
    }
}
