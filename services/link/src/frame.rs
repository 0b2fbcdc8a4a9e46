//! A sample on its way between hosts: its bytes with all times on the common clock, behind the bound of that clock.
//!
//! The common clock is that of the orchestrator's host. Every other host maps at its own end, both ways with one
//! offset, so that the stamps of a scan that was there and back still add up.

use shared_types::{Checkpoint, Directive, Header, Heartbeat, Role, SampleType, Topic, shift_times};

use crate::clock::Offset;

/// Bytes in front of a sample: what its times may be wrong by [ns], little-endian.
const BOUND_BYTES: usize = 8;

/// Writes the frame of a sample into `frame`, with its times moved to the common clock.
///
/// # Panics
/// When the sample has not the size of its type.
pub(crate) fn pack(of: &SampleType, sample: &[u8], clock: Offset, frame: &mut Vec<u8>) {
    frame.clear();
    frame.extend_from_slice(&clock.bound_ns.to_le_bytes());
    frame.extend_from_slice(sample);
    shift_times(of, &mut frame[BOUND_BYTES..], clock.offset_ns);
}

/// The bound and the bytes of a sample, into `sample`; `None` when the frame is no sample of this type.
pub(crate) fn unpack(of: &SampleType, frame: &[u8], sample: &mut Aligned) -> Option<u64> {
    let (bound, bytes) = frame.split_first_chunk::<BOUND_BYTES>()?;
    if bytes.len() != of.size {
        return None;
    }
    sample.fill(bytes);
    ((of.check)(sample.bytes()).is_ok()).then_some(u64::from_le_bytes(*bound))
}

/// Moves the times of a sample from the common clock to the one of this host.
pub(crate) fn to_local(of: &SampleType, sample: &mut [u8], clock: Offset) {
    shift_times(of, sample, -clock.offset_ns);
}

/// When a sample was published, by its own stamps [ns].
pub(crate) fn published_ns(topic: Topic, header: &Header, sample: &[u8]) -> u64 {
    match (topic, topic.writer()) {
        (Topic::Directive, _) => bytemuck::from_bytes::<Directive>(sample).issued_ns,
        (Topic::Heartbeat, _) => bytemuck::from_bytes::<Heartbeat>(sample).issued_ns,
        (Topic::Checkpoint, _) => bytemuck::from_bytes::<Checkpoint>(sample).issued_ns,
        (_, writer) => header.stage(writer.unwrap_or(Role::Robot)).published_ns,
    }
}

/// Bytes that are aligned as samples are.
#[derive(Debug, Default)]
pub(crate) struct Aligned {
    words: Vec<u64>,
    length: usize,
}

impl Aligned {
    /// Copies bytes; it allocates only when they are more than ever before.
    pub(crate) fn fill(&mut self, bytes: &[u8]) {
        self.words.resize(bytes.len().div_ceil(8).max(self.words.len()), 0);
        self.length = bytes.len();
        self.bytes_mut().copy_from_slice(bytes);
    }

    /// The bytes.
    pub(crate) fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.length]
    }

    /// The bytes, to change them.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.words)[..self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::{Pose, Sample};

    #[test]
    fn a_sample_that_goes_there_and_back_has_the_same_stamps() {
        let mut pose = Pose { predicted_ns: 9_000, ..Pose::default() };
        pose.header.layout = Pose::LAYOUT;
        pose.header.acquired_ns = 4_000;
        pose.header.stage_mut(Role::Estimator).published_ns = 8_000;
        let here = Offset { offset_ns: -3_000, bound_ns: 17 };
        let (mut frame, mut sample) = (Vec::new(), Aligned::default());
        pack(Pose::TYPE, bytemuck::bytes_of(&pose), here, &mut frame);
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), Some(17));
        let common: &Pose = bytemuck::from_bytes(sample.bytes());
        assert_eq!((common.header.acquired_ns, common.predicted_ns), (1_000, 6_000));
        assert_eq!(published_ns(Topic::Pose, &common.header, sample.bytes()), 5_000);
        to_local(Pose::TYPE, sample.bytes_mut(), here);
        assert_eq!(sample.bytes(), bytemuck::bytes_of(&pose));
    }

    #[test]
    fn what_is_no_valid_sample_is_dropped() {
        let mut sample = Aligned::default();
        let mut frame = vec![0; BOUND_BYTES + size_of::<Pose>()];
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), None, "another layout");
        frame.pop();
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), None, "too short");
        assert_eq!(unpack(Pose::TYPE, &frame[..5], &mut sample), None);
    }
}
