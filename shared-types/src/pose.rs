//! Where the robot is and how it moves.

use crate::fault::finite;
use crate::named::wire_enum;
use crate::sample::sample;
use crate::{Fault, Header};

wire_enum! {
    /// What the estimator suspects to be calibrated wrongly.
    pub enum Suspect {
        /// Nothing.
        None = 0 "none",
        /// The velocity factor kv: the speed at the wheels is not the desired one.
        VelocityFactor = 1 "velocity_factor",
        /// The steering map: the robot turns otherwise than commanded.
        Steering = 2 "steering",
        /// Odometry scale error, df: fraction of the travelled distance that is not reported.
        OdometryLongitudinal = 3 "odometry_longitudinal",
        /// The lateral drift of the odometry, dds.
        OdometryLateral = 4 "odometry_lateral_rate",
        /// The reported heading jumped.
        Heading = 5 "heading",
        /// The reported position jumped.
        Position = 6 "position",
        /// The vehicle description: the model makes a motion of it that no robot can have.
        Vehicle = 7 "vehicle",
    }
}

wire_enum! {
    /// What the estimator asks for because of its suspicion.
    pub enum Alarm {
        /// Nothing.
        None = 0 "none",
        /// Drive slowly.
        Slow = 1 "slow",
        /// Block the wheels.
        Stop = 2 "stop",
    }
}

/// Names of what [`Pose::learned`] holds.
pub const LEARNED: [&str; 6] = [
    "gyro_bias_radps",
    "odometry_longitudinal",
    "gyro_scale",
    "steering_offset_rad",
    "turn_share",
    "velocity_share",
];

sample! {
    /// Estimated state of the robot at the time of the front beam, and at the time the command will act.
    pub struct Pose(752, Pose, 0xe577_3226, "scanloop.Pose.v4", check) {
        /// Identity and stamps
        pub header: Header,
        /// Estimated yaw at the acquisition of the scan, x2 of (7.28) [rad]
        pub yaw_rad: f64,
        /// Estimated position along the track at the acquisition of the scan, x4 of (7.30) [m]
        pub x_m: f64,
        /// Estimated lateral position at the acquisition of the scan, x5 of (7.31) [m]
        pub y_m: f64,
        /// Covariance of (yaw, x, y) on the track, row by row [rad^2, rad m, m^2]
        pub covariance: [f64; 9],
        /// Covariance of (yaw, x, y) relative to what the scanner sees now, row by row: without the drift of the odometry
        /// since the start [rad^2, rad m, m^2]
        pub local_covariance: [f64; 9],
        /// Speed over ground at the acquisition of the scan, negative backwards [m/s]
        pub speed_mps: f64,
        /// Sideslip at the acquisition of the scan, x1 of (7.27) [rad]
        pub sideslip_rad: f64,
        /// Yaw rate at the acquisition of the scan, x3 of (7.29) [rad/s]
        pub yaw_rate_radps: f64,
        /// When the command for this scan is expected to act: the time of the predicted state [ns]
        pub predicted_ns: u64,
        /// Predicted sideslip [rad]
        pub predicted_sideslip_rad: f64,
        /// Predicted yaw [rad]
        pub predicted_yaw_rad: f64,
        /// Predicted yaw rate [rad/s]
        pub predicted_yaw_rate_radps: f64,
        /// Predicted position along the track [m]
        pub predicted_x_m: f64,
        /// Predicted lateral position [m]
        pub predicted_y_m: f64,
        /// Predicted speed, negative backwards [m/s]
        pub predicted_speed_mps: f64,
        /// Measured minus predicted (yaw, x, y) of the measurement update [rad, m, m]
        pub innovation: [f64; 3],
        /// Kalman gain of (yaw, x, y), row by row
        pub gain: [f64; 9],
        /// Normalised innovation squared
        pub nis: f64,
        /// Measurements refused by the gate since the start
        pub rejected: u64,
        /// What the estimator has learned of the robot: turn rate [rad/s], shares of the distance and of the turn that the
        /// odometry does not report, offset of the steering angle [rad], shares of turn and speed beyond those described
        pub learned: [f64; 6],
        /// Their standard deviations; 0 for what is not learned
        pub learned_deviation: [f64; 6],
        /// Part of the calibration that is suspected to be wrong, `Suspect`
        pub suspect: u32,
        /// Reaction that the estimator asks for because of it, `Alarm`
        pub alarm: u32,
    }
}

fn check(pose: &Pose) -> Result<(), Fault> {
    pose.header.check::<Pose>()?;
    Suspect::try_from(pose.suspect)?;
    Alarm::try_from(pose.alarm)?;
    finite(
        "pose",
        &[pose.yaw_rad, pose.x_m, pose.y_m, pose.speed_mps, pose.sideslip_rad, pose.yaw_rate_radps],
    )?;
    finite("covariance", &pose.covariance)?;
    finite("local_covariance", &pose.local_covariance)?;
    finite("learned", &pose.learned)?;
    finite("learned_deviation", &pose.learned_deviation)?;
    finite(
        "predicted",
        &[
            pose.predicted_sideslip_rad,
            pose.predicted_yaw_rad,
            pose.predicted_yaw_rate_radps,
            pose.predicted_x_m,
            pose.predicted_y_m,
            pose.predicted_speed_mps,
        ],
    )
}
