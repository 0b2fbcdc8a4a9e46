//! A driver of your own robot, ready to be copied and changed.
//!
//! It publishes a scan and the odometry at its front beam once per sweep, and writes velocity and steering angle to the
//! wheels.
//!
//! * `device.rs` reads and writes the robot. **Replace its three functions.** As shipped they are a small simulation.
//! * `driver.rs` is what every driver must do: stamps, gaps, the dead man.
//! * `odometry.rs` gives the pose at the front beam, continuous when the base restarts.

mod device;
mod driver;
mod odometry;

use std::process::ExitCode;

use runtime::{Process, RuntimeError};
use shared_types::Role;

use crate::driver::Driver;

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
    let mut process = Process::attach(Role::Robot)?;
    let mut driver = Driver::new(&mut process)?;
    if process.start()? {
        while process.wait(Some(process.clock().now_ns() + driver::POLL_NS))? {
            driver.turn(&mut process)?;
        }
    }
    driver.end(&mut process)
}
