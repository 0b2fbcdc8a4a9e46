//! The process of the role `actuator`: command in, actuation out, and the stop that always wins.

use runtime::{Handover, Process};
use shared_types::{Actuation, Command, Role};

use crate::{Actuator, Config};

/// Runs until asked to end; its last actuation blocks the wheels.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Actuator)?;
    let mut actuator = Actuator::new(process.settings::<Config>("actuator")?, process.period_ns())?;
    let commands = process.input::<Command>()?;
    let actuations = process.output::<Actuation>()?;
    match process.resume()? {
        Handover::State(state) => actuator.resume(&state)?,
        // A robot that drives is stopped first; valid commands release it.
        Handover::Lost => actuations.publish(&mut actuator.stop(process.clock().now_ns()))?,
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
            actuations.publish(&mut actuator.stop(process.clock().now_ns()))?;
        } else if !stop && actuator.is_stopped() {
            actuator.release();
        }
        if commands.dropped() > dropped {
            dropped = commands.dropped();
            actuator.note_dropped();
        }
        while let Some(command) = commands.take() {
            let mut actuation = actuator.answer(&command, process.clock().now_ns());
            if let Some(fault) = actuator.refusal() {
                commands.refuse(&command, fault);
            }
            actuations.publish(&mut actuation)?;
            process.save(&actuation.header, &actuator.state())?;
            last = Some(*command);
        }
        if !process.clock().is_simulated()
            && let Some(mut block) = actuator.tick(process.clock().now_ns())
        {
            actuations.publish(&mut block)?;
        }
    }
    actuations.publish(&mut actuator.stop(process.clock().now_ns()))?;
    Ok(())
}
