//! A sample of any topic of the loop.

use bytemuck::{cast_slice, cast_slice_mut, from_bytes, from_bytes_mut};
use shared_types::{
    Actuation, Command, CommandKind, Fault, Header, Obstacles, Odometry, Pose, Sample, SampleType, Scan,
    Topic, shift_times,
};

use super::trouble::{Tried, failed};

/// A sample of one of the topics of the loop.
#[derive(Debug, Clone)]
pub(crate) struct Message {
    of: &'static SampleType,
    /// Its bytes, aligned as those of all samples.
    words: Vec<u64>,
    /// When the test bench received it [ns]; 0 for its own ones.
    pub(crate) received_ns: u64,
}

impl Message {
    pub(crate) fn new<S: Sample>(sample: &S) -> Self {
        Self::from_bytes(S::TOPIC, bytemuck::bytes_of(sample), 0)
    }

    /// The sample of a topic with these bytes, received at a time [ns].
    pub(crate) fn from_bytes(topic: Topic, bytes: &[u8], received_ns: u64) -> Self {
        let words = vec![0; topic.size() / size_of::<u64>()];
        let mut message = Self { of: topic.sample_type(), words, received_ns };
        message.bytes_mut().copy_from_slice(bytes);
        message
    }

    fn bytes(&self) -> &[u8] {
        cast_slice(&self.words)
    }

    /// Its bytes, to be published.
    pub(crate) fn bytes_mut(&mut self) -> &mut [u8] {
        cast_slice_mut(&mut self.words)
    }

    /// The sample if it is of this type.
    pub(crate) fn get<S: Sample>(&self) -> Option<&S> {
        (S::TOPIC == self.topic()).then(|| from_bytes(self.bytes()))
    }

    /// The sample, which must be of this type.
    pub(crate) fn sample<S: Sample>(&self) -> Tried<&S> {
        self.get().map_or_else(|| failed(format!("{} where {} was expected", self.topic(), S::TOPIC)), Ok)
    }

    /// The sample if it is of this type, to change it.
    pub(crate) fn sample_mut<S: Sample>(&mut self) -> Option<&mut S> {
        (S::TOPIC == self.topic()).then(|| from_bytes_mut(self.bytes_mut()))
    }

    /// Changes the sample if it is of this type.
    pub(crate) fn change<S: Sample>(&mut self, change: impl FnOnce(&mut S)) {
        if let Some(sample) = self.sample_mut() {
            change(sample);
        }
    }

    pub(crate) fn topic(&self) -> Topic {
        self.of.topic
    }

    pub(crate) fn header(&self) -> &Header {
        (self.of.header)(self.bytes())
    }

    pub(crate) fn header_mut(&mut self) -> &mut Header {
        (self.of.header_mut)(self.bytes_mut())
    }

    pub(crate) fn scan_id(&self) -> u64 {
        self.header().scan_id
    }

    /// What every subscriber checks.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        (self.of.check)(self.bytes())
    }

    /// The bytes without incarnation and sequence: two runs with the same input have them in common.
    pub(crate) fn content(&self) -> Vec<u64> {
        let mut same = self.clone();
        let header = same.header_mut();
        (header.incarnation, header.sequence) = (0, 0);
        same.words
    }

    /// Whether it answers a scan; an actuator also publishes without a command.
    pub(crate) fn is_answer(&self) -> bool {
        (self.of.is_answer)(self.bytes())
    }

    /// Whether it moves nothing: a stop, a block.
    pub(crate) fn is_harmless(&self) -> bool {
        let stops = |command: &Command| command.kind != CommandKind::Drive.wire();
        self.get().is_some_and(stops) || self.get().is_some_and(|actuation: &Actuation| !actuation.drives())
    }

    /// Moves all stamps of the machine's clock by `offset_ns`.
    pub(crate) fn shift(&mut self, offset_ns: u64) {
        shift_times(self.of, self.bytes_mut(), offset_ns.cast_signed());
    }

    /// An input spoilt in several ways; a subscriber must drop each.
    pub(crate) fn spoilt(&self) -> Vec<Self> {
        let mut all = vec![self.clone(); 5];
        all[0].header_mut().layout ^= 1;
        for (message, bad) in all[1..4].iter_mut().zip([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]) {
            message.change(|scan: &mut Scan| (scan.sweep_ns, scan.period_ns) = (u64::MAX, 1));
            message.change(|odometry: &mut Odometry| odometry.x_m = bad);
            message.change(|pose: &mut Pose| pose.predicted_yaw_rad = bad);
            message.change(|obstacles: &mut Obstacles| {
                obstacles.count = obstacles.count.max(1);
                obstacles.items[0].x_m = bad;
            });
            message.change(|command: &mut Command| command.steering_rad = bad);
        }
        all[4].change(|scan: &mut Scan| scan.sweep_ns = 0);
        all[4].change(|odometry: &mut Odometry| odometry.yaw_rad = f64::NAN);
        all[4].change(|pose: &mut Pose| pose.y_m = f64::NAN);
        all[4].change(|obstacles: &mut Obstacles| obstacles.count = 1000);
        all[4].change(|command: &mut Command| command.kind = 77);
        all
    }
}
