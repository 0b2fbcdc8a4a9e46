//! An estimator of one's own: it believes what the odometer reports, and looks ahead at constant speed and yaw rate.
//!
//! Nothing is corrected and nothing is filtered, so it drives as well as the odometer is good: the 1 % of the way
//! that the default robot's odometer misses becomes a miss at the goal. It keeps no state, so it needs no checkpoint.

use runtime::Process;
use shared_types::{Odometry, Pose, Role};

fn main() -> Result<(), runtime::RuntimeError> {
    runtime::start_logging();
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

/// The reported pose, and where it will be at `now_ns`, when the answer to this scan acts.
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
