//! An estimator of your own: it believes the odometer, and predicts with constant speed and yaw rate.
//!
//! It does not correct or filter the reported pose. The default robot's odometer does not report 1 % of the distance, so
//! the robot misses the goal by that much. The estimator has no state, so it saves none.

use std::process::ExitCode;

use runtime::{Process, RuntimeError};
use shared_types::{Odometry, Pose, Role};

fn main() -> ExitCode {
    runtime::start_logging();
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            let is_usage = matches!(error, RuntimeError::NotInASystem(_) | RuntimeError::Layout(_));
            ExitCode::from(if is_usage { 2 } else { 1 })
        }
    }
}

fn run() -> Result<(), RuntimeError> {
    let mut process = Process::attach(Role::Estimator)?;
    let odometry = process.input::<Odometry>()?;
    let poses = process.output::<Pose>()?;
    if !process.start()? {
        return Ok(());
    }
    while process.wait(None)? {
        while let Some(measured) = odometry.take() {
            poses.publish(&mut pose_of(&measured, process.clock().now_ns()))?;
        }
    }
    Ok(())
}

/// The reported pose, and its prediction for `now_ns`, when the answer to this scan acts.
fn pose_of(measured: &Odometry, now_ns: u64) -> Pose {
    let Odometry { header, x_m, y_m, yaw_rad, speed_mps, .. } = *measured;
    let yaw_rate_radps = if measured.dt_s > 0.0 { measured.dyaw_rad / measured.dt_s } else { 0.0 };
    let ahead_s = now_ns.saturating_sub(header.acquired_ns) as f64 * 1e-9;
    let (sin, cos) = yaw_rad.sin_cos();
    Pose {
        header: header.answer(),
        yaw_rad,
        x_m,
        y_m,
        speed_mps,
        yaw_rate_radps,
        predicted_ns: now_ns,
        predicted_yaw_rad: yaw_rad + yaw_rate_radps * ahead_s,
        predicted_yaw_rate_radps: yaw_rate_radps,
        predicted_x_m: x_m + speed_mps * cos * ahead_s,
        predicted_y_m: y_m + speed_mps * sin * ahead_s,
        predicted_speed_mps: speed_mps,
        ..Pose::default()
    }
}
