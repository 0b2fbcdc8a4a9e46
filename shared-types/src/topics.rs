//! The table of topics: the sample of each.

use crate::describe::Field;
use crate::{
    Actuation, Checkpoint, Command, Directive, Heartbeat, Obstacles, Odometry, Pose, Sample, Scan, Topic,
    Truth,
};

impl Topic {
    /// Name of the sample type on the bus.
    pub const fn type_name(self) -> &'static str {
        self.description().0
    }

    /// Size of a sample [bytes].
    pub const fn size(self) -> usize {
        self.description().1
    }

    /// Fields of a sample, the header first.
    pub const fn fields(self) -> &'static [Field] {
        self.description().2
    }

    /// Layout version of a sample, [`Sample::LAYOUT`].
    pub const fn layout(self) -> u32 {
        self.description().3
    }

    const fn description(self) -> (&'static str, usize, &'static [Field], u32) {
        const fn of<S: Sample>() -> (&'static str, usize, &'static [Field], u32) {
            (S::TYPE_NAME, size_of::<S>(), S::FIELDS, S::LAYOUT)
        }
        match self {
            Self::Scan => of::<Scan>(),
            Self::Odometry => of::<Odometry>(),
            Self::Pose => of::<Pose>(),
            Self::Obstacles => of::<Obstacles>(),
            Self::Command => of::<Command>(),
            Self::Actuation => of::<Actuation>(),
            Self::Heartbeat => of::<Heartbeat>(),
            Self::Directive => of::<Directive>(),
            Self::Checkpoint => of::<Checkpoint>(),
            Self::Truth => of::<Truth>(),
        }
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
