//! What the actuator sends to the robot.

use crate::fault::finite;
use crate::named::wire_enum;
use crate::sample::sample;
use crate::{DrivenBy, Fault, Header};

wire_enum! {
    /// What the robot is told.
    pub enum ActuationKind {
        /// Block the wheels.
        Block = 0 "block",
        /// Turn the wheels with the velocity and angle sent.
        Drive = 1 "drive",
    }
}

wire_enum! {
    /// Why the actuator blocks the wheels.
    pub enum BlockReason {
        /// It does not.
        None = 0 "none",
        /// The goal is reached.
        Landed = 1 "landed",
        /// The controller asked for a stop.
        Commanded = 2 "commanded",
        /// No valid command came within 1.5 scan periods.
        NoCommand = 3 "no_command",
        /// The command was not finite, not verified, or outside its hard limits.
        InvalidCommand = 4 "invalid_command",
        /// The scan behind the command is too old.
        StaleCommand = 5 "stale_command",
        /// The user or the orchestrator asked for a stop.
        StopRequested = 6 "stop_requested",
        /// Nothing has been commanded yet.
        Start = 7 "start",
        /// A person has paused the drive.
        Paused = 8 "paused",
        /// The person who drives is silent.
        Released = 9 "released",
        /// An emergency stop from outside is pressed, or silent.
        EmergencyStop = 10 "emergency_stop",
    }
}

sample! {
    /// One answer per command, or a block that the actuator decides by itself.
    pub struct Actuation(360, Actuation, 0xcabc_5b8a, "scanloop.Actuation.v4", check, is_answer) {
        /// Identity and stamps of the command answered
        pub header: Header,
        /// What the robot is asked to do, `ActuationKind`
        pub kind: u32,
        /// Why the wheels are blocked, `BlockReason`
        pub reason: u32,
        /// `StopReason` of the command that this answers
        pub stop_reason: u32,
        /// 1 when this answers a command of the scan in the header, 0 when the actuator acts by itself
        pub answers: u32,
        /// Desired velocity after limits (7.41), negative backwards [m/s]
        pub desired_velocity_mps: f64,
        /// Desired steering angle after limits (7.41) [rad]
        pub desired_steering_rad: f64,
        /// Velocity sent to the robot, after the correction, negative backwards [m/s]
        pub sent_velocity_mps: f64,
        /// Steering angle sent to the robot, after the correction [rad]
        pub sent_steering_rad: f64,
        /// Commands refused since the start: not finite, not verified, stale, out of limits
        pub refused: u64,
        /// Gaps between scans since the start: the wheels were blocked, and the next valid command ended the block
        pub gaps: u64,
        /// Who drives, `DrivenBy`
        pub driven_by: u32,
        /// Unused, zero
        pub reserved: u32,
    }
}

impl Actuation {
    /// Whether it lets the wheels turn.
    pub fn drives(&self) -> bool {
        self.kind != ActuationKind::Block.wire()
    }

    /// Makes it a block that keeps its steering angle, because wheels must not turn.
    pub fn hold_back(&mut self) {
        self.kind = ActuationKind::Block.wire();
        self.reason = BlockReason::StopRequested.wire();
        (self.desired_velocity_mps, self.sent_velocity_mps) = (0.0, 0.0);
    }
}

fn is_answer(actuation: &Actuation) -> bool {
    actuation.answers == 1
}

fn check(actuation: &Actuation) -> Result<(), Fault> {
    actuation.header.check::<Actuation>()?;
    ActuationKind::try_from(actuation.kind)?;
    BlockReason::try_from(actuation.reason)?;
    DrivenBy::try_from(actuation.driven_by)?;
    let Actuation {
        desired_velocity_mps, desired_steering_rad, sent_velocity_mps, sent_steering_rad, ..
    } = *actuation;
    finite("actuation", &[desired_velocity_mps, desired_steering_rad, sent_velocity_mps, sent_steering_rad])
}
