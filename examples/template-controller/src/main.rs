//! A controller of your own, ready to be copied and changed.
//!
//! Once per scan it receives the pose of the robot and the obstacles, and publishes one command.
//!
//! * `main.rs` is the process: ports, start, state, loop. It stays as it is.
//! * `controller.rs` is the order of decisions for one scan: stop, land, or drive a verified plan.
//! * `planner.rs` proposes plans. **Replace this file by your own idea.**
//! * `verify.rs` checks a plan. Keep it: a command may have `verified = 1` only when its plan has passed.
//! * `settings.rs` names the settings that are read.

mod controller;
mod planner;
mod settings;
mod verify;

use std::process::ExitCode;

use runtime::{Handover, Process, RuntimeError, join};
use shared_types::{Command, Obstacles, Pose, Role};

use crate::controller::Controller;

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
    let mut process = Process::attach(Role::Controller)?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.input::<Obstacles>()?;
    let commands = process.output::<Command>()?;
    let mut controller = Controller::new(process.settings("controller")?, process.period_ns());
    if let Handover::State(memory) = process.resume()? {
        controller.memory = memory;
    }
    if !process.start()? {
        return Ok(());
    }
    while process.wait_joined()? {
        while let Some((pose, obstacles)) = join(&poses, &obstacles) {
            let mut command = controller.step(&pose, &obstacles);
            commands.publish(&mut command)?;
            process.save(&command.header, &controller.memory)?;
        }
    }
    Ok(())
}
