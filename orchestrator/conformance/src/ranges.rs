//! Ranges in which the numbers of each topic lie.

use std::ops::RangeInclusive;

use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Obstacle, Obstacles, Odometry, Pose, Scan,
};
use vehicle::Bounds;
use vehicle::bounds::{ANY_SENT_VELOCITY_MAX_MPS, ROUNDING};

use super::message::Message;
use super::trouble::{Verdict, failed};

/// Passes when every sample passes the check of its type and the ranges of its topic.
pub(crate) fn valid(received: &[Message], bounds: &Bounds) -> Verdict {
    for message in received {
        let ranges =
            message.check().map_err(|fault| fault.to_string()).and_then(|()| in_range(message, bounds));
        if let Err(reason) = ranges {
            return failed(format!("{} of scan {}: {reason}", message.topic(), message.scan_id()));
        }
    }
    Ok(format!("{} samples", received.len()))
}

/// Fails with the first number of the sample that is outside of its range.
fn in_range(message: &Message, bounds: &Bounds) -> Result<(), String> {
    message.get().map_or(Ok(()), pose)?;
    message.get().map_or(Ok(()), obstacles)?;
    message.get().map_or(Ok(()), |sample| command(sample, bounds))?;
    message.get().map_or(Ok(()), |sample| actuation(sample, bounds))?;
    message.get().map_or(Ok(()), scan)?;
    message.get().map_or(Ok(()), odometry)
}

/// Returns the name, the value and the range of the first of these fields that is outside.
macro_rules! within {
    ($range:expr, $sample:ident: $($field:ident),+) => {
        $(inside(stringify!($field), $sample.$field, $range)?;)+
    };
}

fn inside(name: &str, value: f64, range: RangeInclusive<f64>) -> Result<(), String> {
    let is_inside = range.contains(&value);
    let outside = || format!("{name} = {value} is outside {} to {}", range.start(), range.end());
    if is_inside { Ok(()) } else { Err(outside()) }
}

/// The ranges of a pose.
fn pose(pose: &Pose) -> Result<(), String> {
    within!(-1e6..=1e6, pose: x_m, y_m, predicted_x_m, predicted_y_m);
    within!(-3.2..=3.2, pose: yaw_rad);
    within!(-ANY_SENT_VELOCITY_MAX_MPS..=ANY_SENT_VELOCITY_MAX_MPS, pose: speed_mps, predicted_speed_mps);
    within!(-1.0..=1.0, pose: sideslip_rad);
    within!(-10.0..=10.0, pose: yaw_rate_radps);
    Ok(())
}

/// The ranges of a list of obstacles.
fn obstacles(obstacles: &Obstacles) -> Result<(), String> {
    let list = obstacles.list();
    for (index, item) in list.iter().enumerate() {
        if item.id == 0 || list[..index].iter().any(|other| other.id == item.id) {
            return Err(format!("id {} of ellipse {index} is zero or not its own", item.id));
        }
        within!(0.01..=20.0, item: a_m, b_m);
        within!(-20.0..=20.0, item: velocity_x_mps, velocity_y_mps);
        within!(0.0..=3600.0, item: unseen_s);
    }
    let rest = &obstacles.items[list.len()..];
    if rest.iter().any(|item| *item != Obstacle::default()) {
        return Err(format!("ellipses beyond count = {} are not zero", obstacles.count));
    }
    Ok(())
}

/// The ranges of a command: limits (7.41), verified when driving.
fn command(command: &Command, bounds: &Bounds) -> Result<(), String> {
    if command.kind != CommandKind::Drive.wire() {
        return Ok(());
    }
    let steering_rad = bounds.steering_max_rad + ROUNDING;
    let highest_mps =
        if command.velocity_mps < 0.0 { bounds.reverse_max_mps } else { bounds.velocity_max_mps };
    let range = bounds.velocity_min_mps - ROUNDING..=highest_mps + ROUNDING;
    inside("velocity_mps, in its direction,", command.velocity_mps.abs(), range)?;
    within!(-steering_rad..=steering_rad, command: steering_rad);
    inside("verified", command.verified.into(), 1.0..=1.0)
}

/// The ranges of an actuation: limits (7.41), limits of what is sent, no velocity with blocked wheels.
fn actuation(actuation: &Actuation, bounds: &Bounds) -> Result<(), String> {
    if actuation.kind != ActuationKind::Drive.wire() {
        return inside("sent_velocity_mps of blocked wheels", actuation.sent_velocity_mps, 0.0..=0.0);
    }
    let (desired_rad, sent_rad) =
        (bounds.steering_max_rad + ROUNDING, bounds.sent_steering_max_rad + ROUNDING);
    let desired_mps = -bounds.reverse_max_mps - ROUNDING..=bounds.velocity_max_mps + ROUNDING;
    within!(desired_mps, actuation: desired_velocity_mps);
    within!(-desired_rad..=desired_rad, actuation: desired_steering_rad);
    let sent_mps = bounds.sent_velocity_max_mps + ROUNDING;
    within!(-sent_mps..=sent_mps, actuation: sent_velocity_mps);
    within!(-sent_rad..=sent_rad, actuation: sent_steering_rad);
    Ok(())
}

/// The ranges of a scan, beyond its check.
fn scan(scan: &Scan) -> Result<(), String> {
    let returns = (0..scan.ranges().len()).filter_map(|beam| scan.range_m(beam));
    inside("range_m", returns.fold(0.0, f64::max), 0.0..=100.0)?;
    inside("period_ns", scan.period_ns as f64, 1e6..=10e9)
}

/// The ranges of an odometry sample.
fn odometry(odometry: &Odometry) -> Result<(), String> {
    within!(-1e6..=1e6, odometry: x_m, y_m);
    within!(-3.2..=3.2, odometry: yaw_rad);
    within!(-ANY_SENT_VELOCITY_MAX_MPS..=ANY_SENT_VELOCITY_MAX_MPS, odometry: speed_mps);
    within!(0.0..=10.0, odometry: dt_s);
    Ok(())
}
