//! Ranges in which the numbers of each topic lie.

use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Obstacle, Obstacles, Odometry, Pose, Scan,
};
use vehicle::Bounds;
use vehicle::correction::{SENT_STEERING_MAX_RAD, SENT_VELOCITY_MAX_MPS};

use super::message::Message;
use super::test_bench::Received;
use super::trouble::{Trouble, failed};

/// Rounding of a solver, as in the actuator [m/s, rad].
const ROUNDING: f64 = 1e-6;
/// Largest difference between what is sent and what should be [m/s, rad]: single precision on the way is allowed.
pub(crate) const SENT: f64 = 1e-6;

/// That every sample passes the check of its type and the ranges of its topic.
pub(crate) fn valid(received: &[Received]) -> Result<(), Trouble> {
    for Received { message, .. } in received {
        let scan_id = message.scan_id();
        if let Err(fault) = message.check() {
            return failed(format!("{} of scan {scan_id}: {fault}", message.topic()));
        }
        let ranges = match message {
            Message::Pose(sample) => pose(sample),
            Message::Obstacles(sample) => obstacles(sample),
            Message::Command(sample) => command(sample),
            Message::Actuation(sample) => actuation(sample),
            Message::Scan(sample) => scan(sample),
            Message::Odometry(sample) => odometry(sample),
            Message::Truth(_) => Ok(()),
        };
        if let Err(reason) = ranges {
            return failed(format!("{} of scan {scan_id}: {reason}", message.topic()));
        }
    }
    Ok(())
}

/// Fails with the name, the value and the range of the first number that is outside.
fn within(numbers: &[(&str, f64, std::ops::RangeInclusive<f64>)]) -> Result<(), String> {
    for (name, value, range) in numbers {
        if !range.contains(value) {
            return Err(format!("{name} = {value} is outside {} to {}", range.start(), range.end()));
        }
    }
    Ok(())
}

/// The ranges of a pose.
fn pose(pose: &Pose) -> Result<(), String> {
    let far = -1e6..=1e6;
    within(&[
        ("x_m", pose.x_m, far.clone()),
        ("y_m", pose.y_m, far.clone()),
        ("predicted_x_m", pose.predicted_x_m, far.clone()),
        ("predicted_y_m", pose.predicted_y_m, far),
        ("yaw_rad", pose.yaw_rad, -3.2..=3.2),
        ("speed_mps", pose.speed_mps, -10.0..=10.0),
        ("predicted_speed_mps", pose.predicted_speed_mps, -10.0..=10.0),
        ("sideslip_rad", pose.sideslip_rad, -1.0..=1.0),
        ("yaw_rate_radps", pose.yaw_rate_radps, -10.0..=10.0),
    ])
}

/// The ranges of a description.
fn obstacles(obstacles: &Obstacles) -> Result<(), String> {
    let list = obstacles.list();
    for (index, item) in list.iter().enumerate() {
        if item.id == 0 || list[..index].iter().any(|other| other.id == item.id) {
            return Err(format!("id {} of ellipse {index} is zero or not its own", item.id));
        }
        within(&[
            ("a_m", item.a_m, 0.01..=20.0),
            ("b_m", item.b_m, 0.01..=20.0),
            ("velocity_x_mps", item.velocity_x_mps, -20.0..=20.0),
            ("velocity_y_mps", item.velocity_y_mps, -20.0..=20.0),
            ("unseen_s", item.unseen_s, 0.0..=3600.0),
        ])?;
    }
    let rest = &obstacles.items[list.len()..];
    if rest.iter().any(|item| *item != Obstacle::default()) {
        return Err(format!("ellipses beyond count = {} are not zero", obstacles.count));
    }
    Ok(())
}

/// The ranges of a command: limits (7.41), verified when driving.
fn command(command: &Command) -> Result<(), String> {
    if command.kind != CommandKind::Drive.wire() {
        return Ok(());
    }
    let bounds = Bounds::default();
    let steering = bounds.steering_max_rad + ROUNDING;
    within(&[
        (
            "velocity_mps",
            command.velocity_mps,
            bounds.velocity_min_mps - ROUNDING..=bounds.velocity_max_mps + ROUNDING,
        ),
        ("steering_rad", command.steering_rad, -steering..=steering),
        ("verified", f64::from(command.verified), 1.0..=1.0),
    ])
}

/// The ranges of an actuation: limits (7.41), limits of what is sent, no velocity with blocked wheels.
fn actuation(actuation: &Actuation) -> Result<(), String> {
    if actuation.kind != ActuationKind::Drive.wire() {
        return within(&[("sent_velocity_mps of blocked wheels", actuation.sent_velocity_mps, 0.0..=0.0)]);
    }
    let bounds = Bounds::default();
    let (desired, sent) = (bounds.steering_max_rad + SENT, SENT_STEERING_MAX_RAD + SENT);
    within(&[
        ("desired_velocity_mps", actuation.desired_velocity_mps, 0.0..=bounds.velocity_max_mps + SENT),
        ("desired_steering_rad", actuation.desired_steering_rad, -desired..=desired),
        ("sent_velocity_mps", actuation.sent_velocity_mps, 0.0..=SENT_VELOCITY_MAX_MPS + SENT),
        ("sent_steering_rad", actuation.sent_steering_rad, -sent..=sent),
    ])
}

/// The ranges of a scan, beyond what its check says.
fn scan(scan: &Scan) -> Result<(), String> {
    let returns = (0..scan.ranges_mm.len()).filter_map(|beam| scan.range_m(beam));
    let farthest = returns.fold(0.0, f64::max);
    within(&[("range_m", farthest, 0.0..=65.0), ("period_ns", scan.period_ns as f64, 1e6..=10e9)])
}

/// The ranges of an odometry sample.
fn odometry(odometry: &Odometry) -> Result<(), String> {
    within(&[
        ("x_m", odometry.x_m, -1e6..=1e6),
        ("y_m", odometry.y_m, -1e6..=1e6),
        ("yaw_rad", odometry.yaw_rad, -3.2..=3.2),
        ("speed_mps", odometry.speed_mps, -10.0..=10.0),
        ("dt_s", odometry.dt_s, 0.0..=10.0),
    ])
}
