//! Another program in place of a stage: it runs alone in a system of its own, in lock-step, and receives the recorded
//! inputs of the stage.
//!
//! What the stage took, and in which order, is in its journals; without them it follows from the stamps of its outputs. Each
//! output of the process that was in charge is compared with what the program answers to the same inputs. It starts
//! like the first process of its role; a replay that begins later hands it the recorded state, as to a successor.

mod bench;
mod inputs;

use console::exit::Failure;
use runtime::Shutdown;
use shared_types::{Checkpoint, Header, Role, Sample};

use self::bench::Bench;
use self::inputs::Inputs;
use crate::drive::Lane;
use crate::stage::{Findings, Window};
use crate::{ReplayDrive, ReplayOptions};

/// A program that leaves so many scans in a row unanswered is given up.
const MAX_UNANSWERED: u32 = 3;

/// Replays a role by a program.
pub(crate) fn replay(
    role: Role,
    command: &[String],
    drive: &ReplayDrive,
    options: &ReplayOptions,
) -> anyhow::Result<Findings> {
    let mut findings = Findings::new(role, drive);
    let found = &mut findings;
    match role {
        Role::Robot => {
            return Err(Failure::bad_input(
                "--with robot is not possible: what a robot measures follows from no recorded input; allowed are estimator, obstacles, controller and actuator",
            ));
        }
        Role::Estimator => run(role, command, drive, options, found, &drive.poses)?,
        Role::Obstacles => run(role, command, drive, options, found, &drive.obstacles)?,
        Role::Controller => run(role, command, drive, options, found, &drive.commands)?,
        Role::Actuator => run(role, command, drive, options, found, &drive.actuations)?,
    }
    Ok(findings)
}

/// Asks the program for each output that counted, and compares the answers.
fn run<S: Sample>(
    role: Role,
    command: &[String],
    drive: &ReplayDrive,
    options: &ReplayOptions,
    findings: &mut Findings,
    lane: &Lane<S>,
) -> anyhow::Result<()> {
    let window = Window::of(drive, options);
    let outputs: Vec<&S> = lane
        .scans()
        .filter_map(|scan_id| {
            let answers = |sample: &&S| sample.is_answer() && drive.counts(role, sample.header());
            lane.of_scan(scan_id).find(answers)
        })
        .collect();
    let mut from_on = outputs.iter().map(|output| output.header());
    let Some(first) = from_on.find(|header| header.scan_id >= window.from) else { return Ok(()) };
    let from = options.from.unwrap_or(first.scan_id);
    let mut inputs = Inputs::new(role, drive);
    let state = state_before(role, drive, (from, first.incarnation), &mut inputs);
    let begin = state.map_or(first.scan_id, |state| inputs.scan_after(state));
    if let Some(state) = state {
        inputs.continue_from(state);
    }
    let shutdown = Shutdown::on_signals()?;
    let mut bench = Bench::<S>::start(role, command, drive, state, &shutdown)?;
    let mut unanswered = 0;
    for output in outputs {
        let header: Header = *output.header();
        if header.scan_id > window.to {
            break;
        }
        // Also before the state: the inputs that an estimator has received already are left out.
        let taken = inputs.of_output(&header);
        if header.scan_id < begin {
            continue;
        }
        let Some(taken) = taken else {
            findings.skip(output, "an input was not recorded");
            continue;
        };
        drive.keep_pace(&header);
        taken.into_iter().try_for_each(|input| bench.publish(input))?;
        let answer = bench.answer(header.scan_id)?;
        unanswered = if answer.is_some() { 0 } else { unanswered + 1 };
        if unanswered == MAX_UNANSWERED {
            return Err(Failure::process(format!(
                "{role}: the command left {MAX_UNANSWERED} scans in a row without an answer, the last is {}{}",
                header.scan_id,
                bench.last_lines()
            )));
        }
        if window.holds(&header, findings) {
            match answer {
                Some((answer, Ok(()))) => findings.compare(output, answer, role, drive, options),
                Some((_, Err(fault))) => findings.refuse(output, &fault.to_string()),
                None => findings.refuse(output, "no answer"),
            }
        }
    }
    Ok(())
}

/// The newest state before the output for a scan, first of its process; none at the start of a drive.
fn state_before<'a>(
    role: Role,
    drive: &'a ReplayDrive,
    (from, process): (u64, u32),
    inputs: &mut Inputs<'_>,
) -> Option<&'a Checkpoint> {
    let states = drive.checkpoints.samples.iter().filter(|state| state.role == role.wire());
    // Another program may have run in shadow, with states of another kind.
    let (own, others): (Vec<_>, Vec<_>) = states.partition(|state| state.header.incarnation == process);
    // An estimator that got an actuation late has saved a state of an earlier scan after its pose.
    let is_before = |state: &&&Checkpoint| state.header.scan_id < from && inputs.scan_after(state) <= from;
    let before = own.iter().rev().chain(others.iter().rev()).find(is_before);
    // A recording that begins in the middle of a drive.
    before.or_else(|| own.iter().chain(&others).find(|_| from > 1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::tests::{ESTIMATOR, late_actuation};

    #[test]
    fn a_program_begins_with_the_newest_state_before_the_first_output_that_is_asked_for() {
        let drive = late_actuation();
        let mut inputs = Inputs::new(Role::Estimator, &drive);
        let found = [1, 2, 3, 4].map(|from| {
            let state = state_before(Role::Estimator, &drive, (from, ESTIMATOR), &mut inputs)?;
            Some((state.header.sequence, inputs.scan_after(state)))
        });
        // State 3 is of scan 1, but the first output after it is of scan 3.
        assert_eq!(found, [None, Some((1, 2)), Some((3, 3)), Some((4, 4))]);
    }
}
