//! What the controller commands.

use std::fmt;

use crate::describe::layout;
use crate::fault::finite;
use crate::named::wire_enum;
use crate::sample::sample;
use crate::{Fault, Header};

/// How many nodes of the plan a command carries.
pub const PLAN_NODES: usize = 25;

wire_enum! {
    /// What the command asks for.
    pub enum CommandKind {
        /// Block the wheels for safety.
        Stop = 0 "stop",
        /// Drive with the velocity and steering angle of the command.
        Drive = 1 "drive",
        /// Block the wheels because the goal is reached.
        Land = 2 "land",
    }
}

wire_enum! {
    /// How the optimal control problem was solved.
    pub enum SolveStatus {
        /// No problem was solved for this command.
        NotSolved = 0 "not_solved",
        /// The KKT residual is within its tolerance.
        Converged = 1 "converged",
        /// The iteration limit came first; the best iterate is in the command.
        MaxIterations = 2 "max_iterations",
        /// The time budget came first; the best iterate is in the command.
        OutOfTime = 3 "out_of_time",
        /// No step could be computed.
        Failed = 4 "failed",
    }
}

wire_enum! {
    /// Where a command comes from: the rung of the ladder that was reached.
    pub enum Level {
        /// Wheels blocked.
        Stop = 0 "stop",
        /// The converged and verified solution for this scan.
        Converged = 1 "converged",
        /// The best verified iterate for this scan.
        BestIterate = 2 "best_iterate",
        /// The rest of the last verified plan, verified again against the obstacles of this scan.
        LastPlan = 3 "last_plan",
        /// What a person asks for, verified.
        Person = 4 "person",
    }
}

wire_enum! {
    /// Why the controller asks to block the wheels.
    pub enum StopReason {
        /// It does not.
        None = 0 "none",
        /// The goal is reached.
        Landed = 1 "landed",
        /// The path is blocked, or too near to steer around.
        Blocked = 2 "blocked",
        /// No plan of this scan or the last could be verified.
        Unverified = 3 "unverified",
        /// The inputs contradict each other or the bounds.
        BadInput = 4 "bad_input",
        /// The goal was passed and cannot be reached any more.
        GoalPassed = 5 "goal_passed",
        /// No input came in time.
        NoInput = 6 "no_input",
        /// The estimator suspects a wrong calibration.
        SelfCheck = 7 "self_check",
        /// The state of the process before was lost while the robot drove: it comes to rest first.
        StateLost = 8 "state_lost",
        /// At no speed can the robot stop in time: scans are too rare or the data too old.
        NoSafeSpeed = 9 "no_safe_speed",
        /// The scanner is blind, stuck or contradictory: obstacles would not be seen.
        Scanner = 10 "scanner",
        /// A described obstacle covers the robot: the obstacle detector is wrong.
        Covered = 11 "covered_by_obstacle",
        /// A person has paused the drive.
        Paused = 12 "paused",
        /// The person who drives asks for no motion, or is silent.
        Released = 13 "released",
        /// The robot stands to change between forwards and backwards.
        Reversal = 14 "reversal",
        /// Backwards, every plan leads to ground that the scanner has not shown.
        Unseen = 15 "unseen",
    }
}

layout! {
    /// State and control at one node of the plan.
    pub struct PlanNode(56) {
        /// Position along the track [m]
        pub x_m: f64,
        /// Lateral position [m]
        pub y_m: f64,
        /// Yaw [rad]
        pub yaw_rad: f64,
        /// Sideslip [rad]
        pub sideslip_rad: f64,
        /// Yaw rate [rad/s]
        pub yaw_rate_radps: f64,
        /// Velocity from this node to the next [m/s]
        pub velocity_mps: f64,
        /// Steering angle from this node to the next [rad]
        pub steering_rad: f64,
    }
}

layout! {
    /// The clearance that a verified plan keeps between the body and obstacles, as a sum of its parts.
    pub struct Margin(40) {
        /// Distance kept in any case [m]
        pub base_m: f64,
        /// Uncertainty of the pose relative to the obstacles, along the plan [m]
        pub pose_m: f64,
        /// Speed times the age of the data when the command acts [m]
        pub latency_m: f64,
        /// Difference between the robot and its description [m]
        pub model_m: f64,
        /// Uncertainty of the described obstacles [m]
        pub perception_m: f64,
    }
}

layout! {
    /// The obstacle that a stop is for, or for which a person drives slower than it asks.
    pub struct Blocking(40) {
        /// Position of its centre along the track [m]
        pub x_m: f64,
        /// Lateral position of its centre [m]
        pub y_m: f64,
        /// The widest gap past it that the robot's body could use, negative when there is none [m]
        pub gap_m: f64,
        /// The gap that the robot needs there: its body and the margin on both sides [m]
        pub needed_m: f64,
        /// Identity of the ellipse, 0 when no obstacle is the reason
        pub id: u32,
        /// Unused, zero
        pub reserved: u32,
    }
}

layout! {
    /// Both sides of an obstacle, when a plan was solved for each.
    pub struct Sides(24) {
        /// Objective of the plan that passes the obstacle on its left, negative without such a plan
        pub left_objective: f64,
        /// The same on its right
        pub right_objective: f64,
        /// Identity of the ellipse, 0 when no sides were compared
        pub id: u32,
        /// Unused, zero
        pub reserved: u32,
    }
}

sample! {
    /// One verified command per scan, with the plan that it begins.
    pub struct Command(1912, Command, 0xdf01_b5da, "scanloop.Command.v4", check) {
        /// Identity and stamps
        pub header: Header,
        /// What the controller asks for, `CommandKind`
        pub kind: u32,
        /// Where the command comes from, `Level`
        pub level: u32,
        /// How the problem was solved, `SolveStatus`
        pub status: u32,
        /// Why the wheels are to be blocked, `StopReason`
        pub reason: u32,
        /// 1 when the plan was verified: bounds, obstacles and model
        pub verified: u32,
        /// Side on which the nearest obstacle in the way is passed: 1 left, -1 right, 0 none
        pub side: i32,
        /// SQP iterations
        pub iterations: u32,
        /// Active constraints at the solution
        pub active_constraints: u32,
        /// Desired velocity, u1 of (7.27)-(7.31), negative backwards [m/s]
        pub velocity_mps: f64,
        /// Desired steering angle, u2 of (7.27)-(7.31) [rad]
        pub steering_rad: f64,
        /// Infinity norm of the KKT conditions
        pub kkt_residual: f64,
        /// Largest violation of a hard constraint or of the model
        pub largest_violation: f64,
        /// Largest slack of an ellipse
        pub slack: f64,
        /// Value of the objective
        pub objective: f64,
        /// Time the solver used, zero in lock-step [ns]
        pub solve_ns: u64,
        /// Time of the first node of the plan [ns]
        pub plan_start_ns: u64,
        /// Time between two nodes of the plan [s]
        pub plan_interval_s: f64,
        /// Largest velocity at which the robot can still stop in time [m/s]
        pub speed_limit_mps: f64,
        /// The clearance that the plan keeps
        pub margin: Margin,
        /// The obstacle that a stop is for, or for which a person drives slower than it asks
        pub blocking: Blocking,
        /// What passing an obstacle on each side would cost
        pub sides: Sides,
        /// How many of `plan` are used
        pub plan_length: u32,
        /// Unused, zero
        pub reserved: u32,
        /// The planned nodes
        pub plan: [PlanNode; PLAN_NODES],
    }
}

impl Margin {
    /// The clearance [m].
    pub fn sum(&self) -> f64 {
        let Self { base_m, pose_m, latency_m, model_m, perception_m } = *self;
        base_m + pose_m + latency_m + model_m + perception_m
    }
}

impl fmt::Display for Blocking {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x_m, y_m, gap_m, needed_m, id, .. } = *self;
        write!(formatter, "obstacle {id} at ({x_m:.1}, {y_m:.1}): ")?;
        if gap_m >= needed_m {
            return write!(
                formatter,
                "too near to turn into its gap of {gap_m:.2} m, which is wide enough for {needed_m:.2} m"
            );
        }
        if gap_m < 0.0 {
            formatter.write_str("no gap")?
        } else {
            write!(formatter, "gap {gap_m:.2} m")?
        }
        write!(formatter, ", needs {needed_m:.2} m")
    }
}

impl Command {
    /// The obstacle that this command blocks the wheels for, if one is the reason and its figures are numbers.
    pub fn stopped_for(&self) -> Option<Blocking> {
        let reasons = [StopReason::Blocked, StopReason::Unverified].map(StopReason::wire);
        let stops = self.kind == CommandKind::Stop.wire() && reasons.contains(&self.reason);
        self.named().filter(|_| stops)
    }

    /// The obstacle for which a person drives slower than it asks, if there is one.
    pub fn slowed_for(&self) -> Option<Blocking> {
        let slows = self.kind == CommandKind::Drive.wire() && self.level == Level::Person.wire();
        self.named().filter(|_| slows)
    }

    fn named(&self) -> Option<Blocking> {
        let Blocking { x_m, y_m, gap_m, needed_m, id, .. } = self.blocking;
        let is_named = id != 0 && [x_m, y_m, gap_m, needed_m].iter().all(|value| value.is_finite());
        is_named.then_some(self.blocking)
    }

    /// The used nodes of the plan.
    pub fn nodes(&self) -> &[PlanNode] {
        &self.plan[..(self.plan_length as usize).min(PLAN_NODES)]
    }
}

fn check(command: &Command) -> Result<(), Fault> {
    command.header.check::<Command>()?;
    let kind = CommandKind::try_from(command.kind)?;
    Level::try_from(command.level)?;
    SolveStatus::try_from(command.status)?;
    StopReason::try_from(command.reason)?;
    finite("velocity_mps", &[command.velocity_mps])?;
    finite("steering_rad", &[command.steering_rad])?;
    if command.plan_length as usize > PLAN_NODES {
        return Err(Fault::OutOfRange { field: "plan_length", value: f64::from(command.plan_length) });
    }
    if kind == CommandKind::Drive && command.verified != 1 {
        return Err(Fault::NotVerified { value: command.verified });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn a_drive_command_that_was_not_verified_is_refused() {
        let mut command = Command { kind: CommandKind::Drive.wire(), ..Command::default() };
        command.header.layout = Command::LAYOUT;
        assert_eq!(command.check(), Err(Fault::NotVerified { value: 0 }));
        command.verified = 1;
        assert_eq!(command.check(), Ok(()));
        command.steering_rad = f64::INFINITY;
        assert_eq!(command.check(), Err(Fault::NotFinite { field: "steering_rad" }));
    }

    #[test]
    fn a_stop_names_its_obstacle_only_when_one_is_the_reason() {
        let blocking = Blocking { x_m: 6.04, y_m: 0.1, gap_m: 0.12, needed_m: 0.62, id: 17, reserved: 0 };
        let mut command = Command { reason: StopReason::Blocked.wire(), blocking, ..Command::default() };
        let named = "obstacle 17 at (6.0, 0.1): gap 0.12 m, needs 0.62 m";
        assert_eq!(command.stopped_for().unwrap().to_string(), named);
        command.blocking.gap_m = -0.3;
        assert_eq!(
            command.stopped_for().unwrap().to_string(),
            "obstacle 17 at (6.0, 0.1): no gap, needs 0.62 m"
        );
        command.blocking.gap_m = f64::NAN;
        assert_eq!(command.stopped_for(), None);
        command.blocking = blocking;
        command.reason = StopReason::Unverified.wire();
        assert_eq!(command.stopped_for(), Some(blocking));
        command.kind = CommandKind::Drive.wire();
        assert_eq!(command.stopped_for(), None);
        (command.kind, command.reason) = (CommandKind::Stop.wire(), StopReason::Landed.wire());
        assert_eq!(command.stopped_for(), None);
        (command.reason, command.blocking.id) = (StopReason::Blocked.wire(), 0);
        assert_eq!(command.stopped_for(), None);
    }
}
