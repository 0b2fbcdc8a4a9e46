//! Compares the estimated yaw with the true one, scan by scan, and prints the mean error at the end.
//!
//! It writes no topic. It reads the truth first, so in lock-step it answers every scan; the pose of the same scan is
//! waited for there, and in real time the newest one is used.

use std::process::ExitCode;

use runtime::{Companion, RuntimeError};
use shared_types::{Pose, Truth};

fn main() -> ExitCode {
    runtime::start_logging();
    match run() {
        Ok(Some(error_rad)) => {
            eprintln!("yaw_error_rad = {error_rad:.9}");
            ExitCode::SUCCESS
        }
        Ok(None) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// The root of the mean square of the yaw error [rad]; `None` without a scan.
fn run() -> Result<Option<f64>, RuntimeError> {
    let mut companion = Companion::attach()?;
    let truths = companion.input::<Truth>()?;
    let poses = companion.input::<Pose>()?;
    if !companion.start()? {
        return Ok(None);
    }
    let (mut squares, mut count) = (0.0, 0.0);
    while companion.wait(None)? {
        while let Some(truth) = truths.take()? {
            if let Some(pose) = poses.by_scan(truth.header.scan_id)? {
                let error_rad = (pose.yaw_rad - truth.yaw_rad).sin().asin();
                squares += error_rad * error_rad;
                count += 1.0;
            }
        }
    }
    Ok((count > 0.0).then(|| f64::sqrt(squares / count)))
}
