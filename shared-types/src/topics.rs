//! The table of topics: who writes what, and when.

use crate::describe::Field;
use crate::{
    Actuation, Checkpoint, Command, Directive, Heartbeat, Obstacles, Odometry, Pose, Role, Sample, Scan,
    Truth,
};

/// A named stream of samples of one type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Topic {
    /// Laser ranges, [`Scan`].
    Scan,
    /// Reported pose of the robot, [`Odometry`].
    Odometry,
    /// Estimated pose, [`Pose`].
    Pose,
    /// Described obstacles, [`Obstacles`].
    Obstacles,
    /// Desired velocity and steering, [`Command`].
    Command,
    /// What is sent to the robot, [`Actuation`].
    Actuation,
    /// State of each process, [`Heartbeat`].
    Heartbeat,
    /// Word of the orchestrator to all processes, [`Directive`].
    Directive,
    /// State that a restarted process resumes from, [`Checkpoint`].
    Checkpoint,
    /// What the emulated robot really does, [`Truth`]; for the referee and pictures, never for the loop.
    Truth,
}

/// All topics, in the order of the data flow.
pub const TOPICS: [Topic; 10] = [
    Topic::Scan,
    Topic::Odometry,
    Topic::Pose,
    Topic::Obstacles,
    Topic::Command,
    Topic::Actuation,
    Topic::Heartbeat,
    Topic::Directive,
    Topic::Checkpoint,
    Topic::Truth,
];

impl Topic {
    /// Name of the topic on the bus and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Odometry => "odometry",
            Self::Pose => "pose",
            Self::Obstacles => "obstacles",
            Self::Command => "command",
            Self::Actuation => "actuation",
            Self::Heartbeat => "heartbeat",
            Self::Directive => "directive",
            Self::Checkpoint => "checkpoint",
            Self::Truth => "truth",
        }
    }

    /// The role that writes the topic; `None` where several processes or the orchestrator do.
    pub const fn writer(self) -> Option<Role> {
        match self {
            Self::Scan | Self::Odometry | Self::Truth => Some(Role::Robot),
            Self::Pose => Some(Role::Estimator),
            Self::Obstacles => Some(Role::Obstacles),
            Self::Command => Some(Role::Controller),
            Self::Actuation => Some(Role::Actuator),
            Self::Heartbeat | Self::Directive | Self::Checkpoint => None,
        }
    }

    /// When a sample is published, in words.
    pub const fn published(self) -> &'static str {
        match self {
            Self::Scan | Self::Odometry => "once per scan, at the end of the sweep",
            Self::Pose => "once per odometry sample",
            Self::Obstacles => "once per scan, when scan and pose are there",
            Self::Command => "once per scan, when pose and obstacles are there",
            Self::Actuation => "once per command, and when the actuator blocks the wheels by itself",
            Self::Heartbeat => "ten times a second by each process, and at each change of its state",
            Self::Directive => "ten times a second by the orchestrator, and at each change",
            Self::Checkpoint => "once per scan by each stateful process",
            Self::Truth => "once per scan by the emulated robot",
        }
    }

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

impl std::fmt::Display for Topic {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

impl std::str::FromStr for Topic {
    type Err = UnknownTopic;

    fn from_str(text: &str) -> Result<Self, UnknownTopic> {
        TOPICS.into_iter().find(|topic| topic.name() == text).ok_or_else(|| UnknownTopic(text.to_owned()))
    }
}

/// A text that names no topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownTopic(pub String);

impl std::fmt::Display for UnknownTopic {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "unknown topic `{}`: expected one of", self.0)?;
        for topic in TOPICS {
            write!(formatter, " {topic}")?;
        }
        Ok(())
    }
}

impl std::error::Error for UnknownTopic {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_topic_of_a_role_names_that_role_as_its_writer() {
        for role in Role::ALL {
            for topic in role.writes() {
                assert_eq!(topic.writer(), Some(*role), "{topic}");
            }
        }
    }

    #[test]
    fn every_topic_starts_with_the_header() {
        for topic in TOPICS {
            assert_eq!((topic.fields()[0].name, topic.fields()[0].offset), ("header", 0), "{topic}");
        }
    }

    #[test]
    fn names_of_topics_are_read_back() {
        for topic in TOPICS {
            assert_eq!(topic.name().parse::<Topic>(), Ok(topic));
        }
        assert!("scans".parse::<Topic>().is_err());
    }
}
