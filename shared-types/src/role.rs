//! The five roles of the loop.

use crate::Topic;
use crate::sample::wire_enum;

/// Most topics that a role reads, and most that it writes.
pub const PORTS: usize = 2;

/// Number of roles.
pub const ROLES: usize = 5;

wire_enum! {
    /// What one process of the loop is there for.
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
    /// Index of the role in [`crate::Header::chain`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The topics the role reads.
    pub const fn reads(self) -> &'static [Topic] {
        match self {
            Self::Robot => &[Topic::Actuation],
            Self::Estimator => &[Topic::Odometry, Topic::Actuation],
            Self::Obstacles => &[Topic::Scan, Topic::Pose],
            Self::Controller => &[Topic::Pose, Topic::Obstacles],
            Self::Actuator => &[Topic::Command],
        }
    }

    /// The topic whose samples the role answers one by one: the input that comes last for a scan.
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

impl std::str::FromStr for Role {
    type Err = UnknownRole;

    fn from_str(text: &str) -> Result<Self, UnknownRole> {
        Self::ALL.iter().copied().find(|role| role.name() == text).ok_or_else(|| UnknownRole(text.to_owned()))
    }
}

/// A text that names no role.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownRole(pub String);

impl std::fmt::Display for UnknownRole {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "unknown role `{}`: expected robot, estimator, obstacles, controller or actuator",
            self.0
        )
    }
}

impl std::error::Error for UnknownRole {}
