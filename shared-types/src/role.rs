//! The five roles of the loop, and the data flow: which role reads and writes which topic, and when.

use crate::Topic;
use crate::named::{UnknownName, by_name, wire_enum};

/// Largest number of topics that a process of the loop reads, and that it writes.
pub const PORTS: usize = 4;

/// Number of roles.
pub const ROLES: usize = 5;

/// Largest number of processes in the loop: each has a slot, from which samples know it. The roles have the first five.
pub const SLOTS: usize = 8;

wire_enum! {
    /// The job of one process of the loop.
    pub enum Role {
        /// Moves and measures: the emulated SUMMIT with its scanner, or a driver of a real robot.
        Robot = 0 "robot",
        /// Corrects measured data and estimates the pose.
        Estimator = 1 "estimator",
        /// Describes obstacles as ellipses.
        Obstacles = 2 "obstacles",
        /// Plans and commands velocity and steering.
        Controller = 3 "controller",
        /// Corrects and limits commands, and blocks the wheels when it must.
        Actuator = 4 "actuator",
    }
}

impl Role {
    /// Slot of the role: its index in [`crate::Header::chain`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The topics the role reads.
    pub const fn reads(self) -> &'static [Topic] {
        match self {
            Self::Robot => &[Topic::Actuation],
            Self::Estimator => &[Topic::Odometry, Topic::Actuation, Topic::Scan],
            Self::Obstacles => &[Topic::Scan, Topic::Pose],
            Self::Controller => &[Topic::Pose, Topic::Obstacles],
            Self::Actuator => &[Topic::Command],
        }
    }

    /// Whether a program may fill the role without reading this topic of it.
    pub const fn may_ignore(self, topic: Topic) -> bool {
        matches!((self, topic), (Self::Estimator, Topic::Actuation | Topic::Scan))
    }

    /// The topic whose samples the role answers one by one: its last input of a scan.
    pub const fn answers(self) -> Option<Topic> {
        match self {
            Self::Robot => None,
            Self::Estimator => Some(Topic::Odometry),
            Self::Obstacles => Some(Topic::Pose),
            Self::Controller => Some(Topic::Obstacles),
            Self::Actuator => Some(Topic::Command),
        }
    }

    /// The topics the role writes.
    pub const fn writes(self) -> &'static [Topic] {
        match self {
            Self::Robot => &[Topic::Scan, Topic::Odometry],
            Self::Estimator => &[Topic::Pose],
            Self::Obstacles => &[Topic::Obstacles],
            Self::Controller => &[Topic::Command],
            Self::Actuator => &[Topic::Actuation],
        }
    }
}

impl Topic {
    /// The role that writes the topic; `None` where several processes or the orchestrator do.
    pub const fn writer(self) -> Option<Role> {
        match self {
            Self::Scan | Self::Odometry | Self::Truth => Some(Role::Robot),
            Self::Pose => Some(Role::Estimator),
            Self::Obstacles => Some(Role::Obstacles),
            Self::Command => Some(Role::Controller),
            Self::Actuation => Some(Role::Actuator),
            Self::Heartbeat | Self::Directive | Self::Checkpoint | Self::Journal | Self::Clock => None,
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
            Self::Journal => "by each process before each of its outputs",
            Self::Clock => "once per scan and other host, by the link of the orchestrator's host",
        }
    }
}

impl std::str::FromStr for Role {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        by_name("role", text, Self::ALL, Self::name)
    }
}

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
}
