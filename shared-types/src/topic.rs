//! The names of the topics.

use crate::named::{UnknownName, by_name, named_enum};

named_enum! {
    /// A named stream of samples of one type, in the order of the data flow.
    pub enum Topic {
        /// Laser ranges, [`crate::Scan`].
        Scan "scan",
        /// Reported pose of the robot, [`crate::Odometry`].
        Odometry "odometry",
        /// Estimated pose, [`crate::Pose`].
        Pose "pose",
        /// Described obstacles, [`crate::Obstacles`].
        Obstacles "obstacles",
        /// Desired velocity and steering, [`crate::Command`].
        Command "command",
        /// What is sent to the robot, [`crate::Actuation`].
        Actuation "actuation",
        /// State of each process, [`crate::Heartbeat`].
        Heartbeat "heartbeat",
        /// What the orchestrator tells all processes, [`crate::Directive`].
        Directive "directive",
        /// State that a restarted process resumes from, [`crate::Checkpoint`].
        Checkpoint "checkpoint",
        /// What the emulated robot really does, [`crate::Truth`]; for the referee and pictures, never for the loop.
        Truth "truth",
        /// What each process knew when it computed its outputs, [`crate::Journal`]; for replays.
        Journal "journal",
        /// Offset between the clock of another host and that of the orchestrator, [`crate::ClockOffset`]; for replays.
        Clock "clock",
    }
}

/// All topics, in the order of the data flow.
pub const TOPICS: [Topic; Topic::ALL.len()] = *Topic::ALL.first_chunk().expect("as long as itself");

impl std::str::FromStr for Topic {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        by_name("topic", text, Self::ALL, Self::name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_topics_are_read_back() {
        for topic in TOPICS {
            assert_eq!(topic.name().parse::<Topic>(), Ok(topic));
        }
        let unknown = "scans".parse::<Topic>().unwrap_err().to_string();
        assert!(unknown.starts_with("unknown topic `scans`: expected scan, odometry, "), "{unknown}");
    }
}
