//! Controllers with a fault.

use nmpc::{Budget, Controller, ControllerState};
use runtime::{Process, join};
use shared_types::{Command, CommandKind, Level, Obstacles, Pose, Role, ScannerHealth, StopReason};

use crate::Outcome;

/// The scan at which `bad-state` ends, after it saved a state of nonsense.
const LAST_SCAN: u64 = 25;

/// Faults: `never`, `blind`, `never-lands`, `careless`, `mute`, `planless`, `unverified`, `too-fast`, `not-finite`,
/// `bad-state`, `halts`, `straight`, and `alone`, which knows of no person and no new goal, as all of them.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Controller)?;
    let mut config = process.settings::<nmpc::ControllerConfig>("controller")?;
    if fault == "straight" {
        config.course = vehicle::Course::default();
    }
    let budget = Budget::Iterations(config.budget_iterations);
    let mut controller = Controller::new(config)?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.input::<Obstacles>()?;
    let commands = process.output::<Command>()?;
    if !process.start()? {
        return Ok(());
    }
    while process.wait(None)? {
        while let Some((pose, obstacles)) = join(&poses, &obstacles) {
            let (mut pose, mut obstacles) = (*pose, *obstacles);
            if fault == "blind" {
                obstacles.count = 0;
                pose.predicted_y_m = pose.predicted_y_m.clamp(-1.0, 1.0);
                pose.y_m = pose.predicted_y_m;
            }
            if fault == "careless" {
                pose.alarm = 0;
                obstacles.scanner = ScannerHealth::healthy(5.0);
            }
            let mut command = controller.step(&pose, &obstacles, &budget);
            match fault {
                "halts" => {
                    command.kind = CommandKind::Stop.wire();
                    (command.level, command.reason) = (Level::Stop.wire(), StopReason::Blocked.wire());
                }
                "never" => command.kind = CommandKind::Stop.wire(),
                "never-lands" if command.kind == CommandKind::Land.wire() => {
                    command.kind = CommandKind::Stop.wire()
                }
                "mute" => command.reason = StopReason::None.wire(),
                "planless" => command.plan_length = 0,
                "unverified" => command.verified = 0,
                "too-fast" => command.velocity_mps = 1.5,
                "not-finite" => command.steering_rad = f64::NAN,
                _ => {}
            }
            commands.publish(&mut command)?;
            if fault == "bad-state" {
                process.save(&command.header, &spoiled(controller.state()))?;
                if command.header.scan_id >= LAST_SCAN {
                    return Err("ends on purpose".into());
                }
            }
        }
    }
    Ok(())
}

/// A state that keeps its times, so that its plan is used, and whose numbers are not finite.
fn spoiled(mut state: ControllerState) -> ControllerState {
    (state.velocity_mps, state.steering_rad) = (f64::NAN, f64::INFINITY);
    for node in &mut state.plan {
        (node.x_m, node.velocity_mps, node.steering_rad) = (f64::NAN, f64::NAN, f64::NEG_INFINITY);
    }
    state
}
