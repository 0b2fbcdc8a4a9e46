//! Recomputes actuations.

use actuation::{Actuator, ActuatorState, Config};
use shared_types::{Actuation, BlockReason, Role};

use super::{Findings, Origin, Window, each_process};
use crate::{Drive, Options};

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let config: Config = drive.table(Role::Actuator, "actuator")?;
    let window = Window::of(drive, options);
    let role = Role::Actuator;
    each_process::<Actuation, ActuatorState>(
        role,
        &drive.actuations,
        drive,
        options,
        findings,
        |outputs: &[&Actuation], origin, findings| {
            let mut actuator = Actuator::new(config.clone(), drive.period_ns)?;
            if let Origin::State(_, state) = &origin {
                actuator.resume(state)?;
            }
            for (index, output) in outputs.iter().enumerate() {
                if output.header.scan_id > window.to {
                    return Ok(outputs.len());
                }
                let stamps = output.header.stage(role);
                // Without an input nothing was taken.
                let now_ns = if output.answers == 1 { stamps.taken_ns } else { stamps.computed_ns };
                let replayed = match output.answers {
                    1 => {
                        if actuator.is_stopped() && !drive.is_stopped(now_ns) {
                            actuator.release();
                        }
                        let command = drive.input(&drive.commands, Role::Controller, &output.header);
                        command.map(|command| actuator.answer(command, now_ns))
                    }
                    _ => by_itself(&mut actuator, output, now_ns, drive.period_ns),
                };
                let Some(replayed) = replayed else { return Ok(index) };
                if window.holds(&output.header, findings) {
                    findings.compare(*output, replayed, role, drive, options);
                }
            }
            Ok(outputs.len())
        },
    )
}

/// A block that the actuator decided by itself: for a stop, or because no valid command came.
fn by_itself(actuator: &mut Actuator, output: &Actuation, now_ns: u64, period_ns: u64) -> Option<Actuation> {
    if output.reason == BlockReason::StopRequested.wire() {
        return Some(actuator.stop(now_ns));
    }
    if output.reason == BlockReason::InvalidCommand.wire() {
        actuator.note_dropped();
    }
    // The process had ticked long before; the time of that is not in the sample.
    actuator.tick(now_ns.saturating_sub(10 * period_ns));
    // Its stamps are some microseconds from the time that it read, which may be the last of the timeout.
    actuator.tick(now_ns).or_else(|| actuator.tick(now_ns + period_ns / 10))
}
