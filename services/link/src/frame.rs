//! A sample on its way between hosts: its bytes with all times on the common clock and without zeros, behind the bound of
//! that clock and the offset by which they were mapped.
//!
//! The common clock is that of the orchestrator's host. Every other host maps at its own end, all samples of a scan and both
//! ways with one offset, so that the stamps of a scan that was there and back add up.

use shared_types::{Checkpoint, Directive, Fault, Header, Heartbeat, Role, SampleType, Topic, shift_times};

use crate::clock::Offset;
use crate::zeros;

/// What a frame contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Content {
    /// A sample, and how its times were mapped. Whether its values may be used is for its readers to decide.
    Sample(Offset),
    /// A sample that says to be of another layout.
    OtherLayout,
    /// Not a sample of this size.
    Damaged,
}

/// Appends the frame of a sample to `frame`. The times of the sample are moved to the common clock.
pub(crate) fn pack(of: &SampleType, sample: &mut [u8], clock: Offset, frame: &mut Vec<u8>) {
    shift_times(of, sample, clock.offset_ns);
    frame.extend_from_slice(&clock.bound_ns.to_le_bytes());
    frame.extend_from_slice(&clock.offset_ns.to_le_bytes());
    zeros::pack(sample, frame);
}

/// Takes the sample out of a frame, into `sample`.
pub(crate) fn unpack(of: &SampleType, frame: &[u8], sample: &mut Aligned) -> Content {
    let Some((bound_ns, rest)) = frame.split_first_chunk() else { return Content::Damaged };
    let Some((offset_ns, packed)) = rest.split_first_chunk() else { return Content::Damaged };
    sample.resize(of.size);
    if !zeros::unpack(packed, sample.bytes_mut()) {
        return Content::Damaged;
    }
    match (of.check)(sample.bytes()) {
        Err(Fault::Layout { .. }) => Content::OtherLayout,
        _ => Content::Sample(Offset {
            offset_ns: i64::from_le_bytes(*offset_ns),
            bound_ns: u64::from_le_bytes(*bound_ns),
        }),
    }
}

/// Moves the times of a sample from the common clock to the one of this host.
pub(crate) fn to_local(of: &SampleType, sample: &mut [u8], clock: Offset) {
    shift_times(of, sample, clock.offset_ns.wrapping_neg());
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
    /// Copies bytes.
    pub(crate) fn fill(&mut self, bytes: &[u8]) {
        self.resize(bytes.len());
        self.bytes_mut().copy_from_slice(bytes);
    }

    /// Makes room for so many bytes; it allocates only when they are more than ever before.
    fn resize(&mut self, length: usize) {
        self.words.resize(length.div_ceil(8).max(self.words.len()), 0);
        self.length = length;
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
        let mut sent = pose;
        pack(Pose::TYPE, bytemuck::bytes_of_mut(&mut sent), here, &mut frame);
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), Content::Sample(here));
        let common: &Pose = bytemuck::from_bytes(sample.bytes());
        assert_eq!((common.header.acquired_ns, common.predicted_ns), (1_000, 6_000));
        assert_eq!(published_ns(Topic::Pose, &common.header, sample.bytes()), 5_000);
        to_local(Pose::TYPE, sample.bytes_mut(), here);
        assert_eq!(sample.bytes(), bytemuck::bytes_of(&pose));
    }

    #[test]
    fn a_sample_with_a_value_that_is_not_allowed_is_left_to_its_readers() {
        let mut pose = Pose { x_m: f64::NAN, ..Pose::default() };
        pose.header.layout = Pose::LAYOUT;
        let (mut frame, mut sample) = (Vec::new(), Aligned::default());
        let clock = Offset { offset_ns: 0, bound_ns: 3 };
        pack(Pose::TYPE, bytemuck::bytes_of_mut(&mut pose), clock, &mut frame);
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), Content::Sample(clock));
    }

    #[test]
    fn what_is_no_valid_sample_is_dropped() {
        let (mut frame, mut sample) = (Vec::new(), Aligned::default());
        let clock = Offset { offset_ns: 0, bound_ns: 3 };
        pack(Pose::TYPE, bytemuck::bytes_of_mut(&mut Pose::default()), clock, &mut frame);
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), Content::OtherLayout);
        frame.pop();
        assert_eq!(unpack(Pose::TYPE, &frame, &mut sample), Content::Damaged, "too short");
        assert_eq!(unpack(Pose::TYPE, &frame[..15], &mut sample), Content::Damaged);
    }
}
