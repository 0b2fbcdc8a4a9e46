//! Samples of a recording in the order of their time.

use bytemuck::from_bytes;
use recording::RecordedSample;
use shared_types::{Actuation, Command, Directive, Header, Obstacles, Pose, Sample, Scan, Topic, Truth};

use crate::follower::News;

/// The topics that a frame shows, in the order of the loop.
pub(super) const SHOWN: [Topic; 6] =
    [Topic::Scan, Topic::Pose, Topic::Obstacles, Topic::Command, Topic::Truth, Topic::Actuation];

/// Orders samples: when they were published [ns] and, in simulated time, the order of the loop.
pub(super) type Key = (u64, usize);

/// A sample that outlives its chunk.
pub(super) struct OwnedSample {
    pub(super) key: Key,
    pub(super) topic: Topic,
    /// The number of its chunk.
    pub(super) chunk: u32,
    /// Samples begin at multiples of eight bytes.
    words: Vec<u64>,
}

impl OwnedSample {
    /// A copy; `None` for a topic that is not shown.
    pub(super) fn new(recorded: &RecordedSample<'_>, chunk: u32) -> Option<Self> {
        let place = SHOWN.iter().position(|topic| *topic == recorded.topic);
        let place = place.map(|place| place + 1).or((recorded.topic == Topic::Directive).then_some(0))?;
        let mut words = vec![0; recorded.bytes.len().div_ceil(8)];
        bytemuck::cast_slice_mut::<u64, u8>(&mut words)[..recorded.bytes.len()]
            .copy_from_slice(recorded.bytes);
        Some(Self { key: (recorded.log_ns, place), topic: recorded.topic, chunk, words })
    }

    fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.topic.size()]
    }

    pub(super) fn header(&self) -> &Header {
        (self.topic.sample_type().header)(self.bytes())
    }

    /// The sample as news; `None` when it is invalid or of a process that is not in charge.
    pub(super) fn news(&self, directive: &Directive) -> Option<News<'_>> {
        let is_valid = (self.topic.sample_type().check)(self.bytes()).is_ok();
        if !is_valid || !directive.counts(self.topic, self.header()) {
            return None;
        }
        Some(match self.topic {
            Topic::Directive => News::Directive(self.of::<Directive>()),
            Topic::Scan => News::Scan(self.of::<Scan>()),
            Topic::Pose => News::Pose(self.of::<Pose>()),
            Topic::Obstacles => News::Obstacles(self.of::<Obstacles>()),
            Topic::Command => News::Command(self.of::<Command>()),
            Topic::Truth => News::Truth(self.of::<Truth>()),
            Topic::Actuation => News::Actuation(self.of::<Actuation>()),
            _ => return None,
        })
    }

    fn of<S: Sample>(&self) -> &S {
        from_bytes(self.bytes())
    }
}

/// The directives that changed something.
#[derive(Default)]
pub(super) struct Directives(Vec<(Key, Directive)>);

impl Directives {
    /// Adds a newer one, if it differs in phase, authority or goal.
    pub(super) fn add(&mut self, key: Key, new: &Directive) {
        let of = |directive: &Directive| (directive.phase, directive.authority, directive.goal);
        let is_same = |(_, old): &(Key, Directive)| of(old) == of(new);
        if !self.0.last().is_some_and(is_same) {
            self.0.push((key, *new));
        }
    }

    /// Those up to a sample, the newest last.
    pub(super) fn until(&self, key: Key) -> &[(Key, Directive)] {
        &self.0[..self.0.partition_point(|(known, _)| *known <= key)]
    }

    /// The one in force at a sample.
    pub(super) fn at(&self, key: Key) -> Directive {
        self.until(key).last().map(|(_, directive)| *directive).unwrap_or_default()
    }
}
