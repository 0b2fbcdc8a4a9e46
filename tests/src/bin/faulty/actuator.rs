//! Actuators with a fault.

use actuation::{Actuator, ActuatorConfig};
use runtime::{Handover, Process};
use shared_types::{Actuation, ActuationKind, Command, CommandKind, Role, StopReason};
use vehicle::correction::Calibration;

use crate::Outcome;

/// Faults: `clamps`, `factor`, `uncalibrated`, `drives-on`, `ignores-stop`, `patient`, `hasty`, `believes`, `wordless`,
/// `eager`, `wary`, and `alone`, which knows of no person and no button, as all of them.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Actuator)?;
    let mut config = process.settings::<ActuatorConfig>("actuator")?;
    let bounds = config.vehicle.bounds;
    match fault {
        "hasty" => config.recovery = 1,
        "uncalibrated" => config.calibration = Calibration::Identity,
        _ => {}
    }
    let mut actuator = Actuator::new(config, process.period_ns())?;
    let commands = process.input::<Command>()?;
    let actuations = process.output::<Actuation>()?;
    let handover = process.resume::<actuation::ActuatorState>()?;
    if !process.start()? {
        return Ok(());
    }
    if handover == Handover::Lost && fault == "eager" {
        actuations.publish(&mut Actuation {
            kind: ActuationKind::Drive.wire(),
            desired_velocity_mps: 0.5,
            sent_velocity_mps: 0.7,
            ..Actuation::default()
        })?;
    }
    let poll_ns = process.period_ns() / 10;
    let mut fell_silent = false;
    while process.wait(Some(process.clock().now_ns() + poll_ns))? {
        let now_ns = process.clock().now_ns();
        let stop = process.directive().stop == 1 && fault != "ignores-stop";
        if stop && !actuator.is_stopped() {
            actuations.publish(&mut actuator.stop(now_ns, false))?;
        } else if !stop && actuator.is_stopped() {
            actuator.release();
        }
        while let Some(command) = commands.take() {
            let mut command = *command;
            match fault {
                "clamps" => {
                    command.velocity_mps =
                        command.velocity_mps.clamp(bounds.velocity_min_mps, bounds.velocity_max_mps);
                    command.steering_rad =
                        command.steering_rad.clamp(-bounds.steering_max_rad, bounds.steering_max_rad);
                }
                // It trusts no first command after a silence, whatever caused it.
                "wary" if fell_silent => (command.verified, fell_silent) = (0, false),
                "believes" => command.header.acquired_ns = now_ns,
                "drives-on" if command.reason != StopReason::None.wire() => {
                    (command.kind, command.verified) = (CommandKind::Drive.wire(), 1);
                    (command.velocity_mps, command.reason) = (0.5, StopReason::None.wire());
                }
                _ => {}
            }
            let mut actuation = actuator.answer(&command, process.clock().now_ns());
            if fault == "factor" {
                actuation.sent_velocity_mps *= 1.2;
            }
            actuations.publish(&mut actuation)?;
        }
        if fault != "patient"
            && let Some(mut block) = actuator.tick(process.clock().now_ns())
        {
            fell_silent = true;
            actuations.publish(&mut block)?;
        }
    }
    if fault != "wordless" {
        actuations.publish(&mut actuator.stop(process.clock().now_ns(), false))?;
    }
    Ok(())
}
