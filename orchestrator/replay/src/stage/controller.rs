//! Recomputes commands.

use std::cell::Cell;

use nmpc::{Budget, Config, Controller, ControllerState};
use shared_types::{Command, Role, SolveStatus};

use super::{Findings, Origin, Window, each_process};
use crate::compare::{difference, take_over};
use crate::{Drive, Options};

/// A solver reads the clock once per iteration; no scan has more iterations [readings].
const MAX_READINGS: u64 = 200;

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let config: Config = drive.table(Role::Controller, "controller")?;
    let window = Window::of(drive, options);
    let role = Role::Controller;
    each_process::<Command, ControllerState>(
        role,
        &drive.commands,
        drive,
        options,
        findings,
        |commands: &[&Command], origin, findings| {
            let mut controller = Controller::new(config.clone())?;
            if let Origin::State(_, state) = &origin {
                controller.resume(state);
            }
            for (index, command) in commands.iter().enumerate() {
                if command.header.scan_id > window.to {
                    return Ok(commands.len());
                }
                let pose = drive.input(&drive.poses, Role::Estimator, &command.header);
                let obstacles = drive.input(&drive.obstacles, Role::Obstacles, &command.header);
                let replayed = pose.zip(obstacles).map(|(pose, obstacles)| {
                    if drive.simulated {
                        return controller.step(
                            pose,
                            obstacles,
                            &Budget::Iterations(config.budget_iterations),
                        );
                    }
                    let before = controller.state();
                    let mut replayed =
                        timed(&mut |budget: &Budget<'_>| controller.step(pose, obstacles, budget), u64::MAX);
                    if !drive.is_changed
                        && (command.status == SolveStatus::OutOfTime.wire() || differs(command, &replayed))
                    {
                        // Its time may have ended meanwhile: the reading of the clock that ended it is looked for.
                        for readings in 0..MAX_READINGS {
                            controller.resume(&before);
                            let other = timed(
                                &mut |budget: &Budget<'_>| controller.step(pose, obstacles, budget),
                                readings,
                            );
                            if !differs(command, &other) {
                                replayed = other;
                                break;
                            }
                        }
                        if differs(command, &replayed) {
                            controller.resume(&before);
                            replayed = timed(
                                &mut |budget: &Budget<'_>| controller.step(pose, obstacles, budget),
                                u64::MAX,
                            );
                        }
                    }
                    replayed
                });
                let Some(replayed) = replayed else { return Ok(index) };
                if window.holds(&command.header, findings) {
                    findings.compare(*command, replayed, role, drive, options);
                }
            }
            Ok(commands.len())
        },
    )
}

/// A step whose time ends after this many readings of the clock.
fn timed(step: &mut dyn FnMut(&Budget<'_>) -> Command, readings: u64) -> Command {
    let read = Cell::new(0);
    let now_ns = || {
        read.set(read.get() + 1);
        u64::from(read.get() > readings)
    };
    step(&Budget::Deadline { deadline_ns: 1, now_ns: &now_ns })
}

fn differs(recorded: &Command, replayed: &Command) -> bool {
    let mut replayed = *replayed;
    take_over(recorded, &mut replayed, Role::Controller);
    difference(recorded, &replayed).is_some()
}
