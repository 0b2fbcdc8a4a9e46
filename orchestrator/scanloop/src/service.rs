//! `scanloop service NAME`: the built-in implementations.

mod injection;

use std::os::unix::process::CommandExt;
use std::process::Command;

use actuation::ActuatorStage;
use console::exit::{Exit, Failure};
use estimator::EstimatorStage;
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use plan::system::ROS2;
use runtime::stage;
use shared_types::did_you_mean;
use supervision::child::other_program;
use supervision::entry::IMPLEMENTATIONS;

use crate::bench::latency::noise;

/// Runs one built-in implementation until it is told to end.
///
/// # Errors
/// An unknown name, a process that was started by hand (both exit code 2), and errors of the process itself.
pub(crate) fn run(name: &str) -> anyhow::Result<Exit> {
    runtime::start_logging();
    if let Some(ended) = noise::run(name) {
        return ended.map(|()| Exit::Done);
    }
    let implementation = IMPLEMENTATIONS.iter().find(|(of, _)| *of == name);
    let faults = implementation.map(|(_, role)| injection::arm(*role)).transpose()?;
    match name {
        "emulator" => match faults {
            Some(faults) => emulator::service::run_with_faults(faults)?,
            None => emulator::service::run()?,
        },
        "player" => player::service::run()?,
        "ros2" => {
            let error = Command::new(other_program(ROS2, "services/ros2")?).arg("robot").exec();
            return Err(Failure::process(format!("{ROS2}: {error}")));
        }
        // Started by `player`, and no process of the system.
        "player-guard" => player::guard::run()?,
        "ekf" => stage::run::<EstimatorStage>()?,
        "ellipses" => stage::run::<DetectorStage>()?,
        "nmpc" => stage::run::<ControllerStage>()?,
        "actuation" => stage::run::<ActuatorStage>()?,
        _ => {
            let known = IMPLEMENTATIONS.map(|(name, _)| name).join(", ");
            let meant = did_you_mean(name, IMPLEMENTATIONS.map(|(name, _)| name));
            let message = format!("unknown implementation `{name}`: expected one of {known}.{meant}");
            return Err(Failure::bad_input(message));
        }
    }
    Ok(Exit::Done)
}
