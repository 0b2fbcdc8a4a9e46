//! One hash over all samples of a topic: equal runs have equal hashes.
//!
//! The process that published a sample is not part of the hash. So a run with a swap between processes that publish
//! the same values has the same digests.

use std::collections::BTreeMap;

use shared_types::{Header, Sample};

/// Running 64-bit FNV-1a hashes, one per topic, over the bytes of all samples in their order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Digests(BTreeMap<String, u64>);

impl Digests {
    /// Adds a sample.
    pub fn add<S: Sample>(&mut self, sample: &S) {
        self.add_bytes(S::TOPIC.name(), bytemuck::bytes_of_mut(&mut { *sample }));
    }

    /// Adds a sample of any topic; its incarnation and sequence number are cleared.
    pub fn add_bytes(&mut self, topic: &str, sample: &mut [u8]) {
        let place = &mut sample[..size_of::<Header>()];
        let header = Header { incarnation: 0, sequence: 0, ..bytemuck::pod_read_unaligned(place) };
        place.copy_from_slice(bytemuck::bytes_of(&header));
        let hash = self.0.entry(topic.to_owned()).or_insert(0xcbf2_9ce4_8422_2325);
        for byte in sample {
            *hash = (*hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// The hashes as texts of 16 digits, by topic.
    pub fn texts(&self) -> BTreeMap<String, String> {
        self.0.iter().map(|(topic, hash)| (topic.clone(), format!("{hash:016x}"))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::Pose;

    #[test]
    fn a_single_bit_changes_the_digest_of_its_topic() {
        let (mut one, mut other) = (Digests::default(), Digests::default());
        one.add(&Pose::default());
        other.add(&Pose { x_m: f64::from_bits(1), ..Pose::default() });
        assert_ne!(one.texts()["pose"], other.texts()["pose"]);
    }

    #[test]
    fn the_process_that_published_a_sample_is_not_part_of_the_digest() {
        let (mut one, mut other) = (Digests::default(), Digests::default());
        let mut pose = Pose::default();
        one.add(&pose);
        (pose.header.incarnation, pose.header.sequence) = (9, 4);
        other.add(&pose);
        assert_eq!(one, other);
    }
}
