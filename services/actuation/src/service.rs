//! The process of the role `actuator`: command in, actuation out, and the stop that always wins.

use runtime::{Handover, Process};
use shared_types::{Actuation, Command, JournalKind, Role};

use crate::{Actuator, ActuatorConfig};

/// Runs until asked to end; its last actuation blocks the wheels.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Actuator)?;
    let mut actuator = Actuator::new(process.settings::<ActuatorConfig>("actuator")?, process.period_ns())?;
    let commands = process.input::<Command>()?;
    let actuations = process.output::<Actuation>()?;
    match process.resume()? {
        Handover::State(state) => actuator.resume(&state)?,
        // A robot that drives is stopped first; valid commands release it.
        Handover::Lost => actuations.publish(&mut actuator.stop(stopped_ns(&process)))?,
        Handover::FirstStart => {}
    }
    if !process.start()? {
        return Ok(());
    }
    if let Some((scan_id, state)) = process.join()? {
        actuator.resume(&state)?;
        commands.skip_to(scan_id);
    }
    // The timeout is checked ten times a period, so the block is late by a tenth at most.
    let poll_ns = process.period_ns() / 10;
    let mut dropped = 0;
    let (mut last, period_ns) = (None, process.period_ns());
    while process.wait_preparing(Some(process.clock().now_ns() + poll_ns), &mut |due_ns| {
        if let Some(last) = &last {
            actuator.rehearse(last, period_ns, due_ns);
        }
    })? {
        let stop = process.directive().stop == 1;
        if stop && !actuator.is_stopped() {
            actuations.publish(&mut actuator.stop(stopped_ns(&process)))?;
        } else if !stop && actuator.is_stopped() {
            process.note(JournalKind::Released, 0);
            actuator.release();
        }
        if commands.dropped() > dropped {
            dropped = commands.dropped();
            process.note(JournalKind::Dropped, 0);
            actuator.note_dropped();
        }
        while let Some(command) = commands.take() {
            let mut actuation = actuator.answer(&command, process.now_ns());
            if let Some(fault) = actuator.refusal() {
                commands.refuse(&command, fault);
            }
            actuations.publish(&mut actuation)?;
            process.save(&actuation.header, &actuator.state())?;
            last = Some(*command);
        }
        if !process.clock().is_simulated() {
            let (now_ns, was_awake) = (process.clock().now_ns(), actuator.is_awake());
            let block = actuator.tick(now_ns);
            if block.is_some() || !was_awake {
                process.note(JournalKind::Timer, now_ns);
            }
            if let Some(mut block) = block {
                actuations.publish(&mut block)?;
            }
        }
    }
    actuations.publish(&mut actuator.stop(stopped_ns(&process)))?;
    Ok(())
}

/// The time at which the actuator stops [ns].
fn stopped_ns(process: &Process) -> u64 {
    let now_ns = process.clock().now_ns();
    process.note(JournalKind::Stopped, now_ns);
    now_ns
}
