//! The table of topics: the sample of each.

use crate::describe::Field;
use crate::{
    Actuation, Checkpoint, ClockOffset, Command, Directive, Heartbeat, Journal, Obstacles, Odometry, Pose,
    Sample, SampleType, Scan, Topic, Truth,
};

impl Topic {
    /// The type of its samples.
    pub const fn sample_type(self) -> &'static SampleType {
        match self {
            Self::Scan => Scan::TYPE,
            Self::Odometry => Odometry::TYPE,
            Self::Pose => Pose::TYPE,
            Self::Obstacles => Obstacles::TYPE,
            Self::Command => Command::TYPE,
            Self::Actuation => Actuation::TYPE,
            Self::Heartbeat => Heartbeat::TYPE,
            Self::Directive => Directive::TYPE,
            Self::Checkpoint => Checkpoint::TYPE,
            Self::Truth => Truth::TYPE,
            Self::Journal => Journal::TYPE,
            Self::Clock => ClockOffset::TYPE,
        }
    }

    /// Name of the sample type on the bus.
    pub const fn type_name(self) -> &'static str {
        self.sample_type().name
    }

    /// Size of a sample [bytes].
    pub const fn size(self) -> usize {
        self.sample_type().size
    }

    /// Fields of a sample, the header first.
    pub const fn fields(self) -> &'static [Field] {
        self.sample_type().fields
    }

    /// Layout version of a sample, [`Sample::LAYOUT`].
    pub const fn layout(self) -> u32 {
        self.sample_type().layout
    }
}

#[cfg(test)]
mod tests {
    use crate::TOPICS;

    #[test]
    fn every_topic_starts_with_the_header() {
        for topic in TOPICS {
            assert_eq!((topic.fields()[0].name, topic.fields()[0].offset), ("header", 0), "{topic}");
        }
    }
}
