//! Controllers with a fault.

use nmpc::{Budget, Controller};
use runtime::{Process, join};
use shared_types::{Command, CommandKind, Obstacles, Pose, Role, ScannerHealth, StopReason};

use crate::Outcome;

/// Faults: `never`, `blind`, `never-lands`, `careless`, `mute`, `planless`, `unverified`, `too-fast`, `not-finite`.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Controller)?;
    let config = process.settings::<nmpc::Config>("controller")?;
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
            }
            if fault == "careless" {
                pose.alarm = 0;
                obstacles.scanner = ScannerHealth::healthy(5.0);
            }
            let mut command = controller.step(&pose, &obstacles, &budget);
            match fault {
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
        }
    }
    Ok(())
}
