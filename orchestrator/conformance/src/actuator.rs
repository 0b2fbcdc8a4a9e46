//! What an actuator must pass on, and when it must block the wheels whatever is commanded.

use shared_types::{Actuation, ActuationKind, Command, CommandKind, Level, StopReason};
use vehicle::bounds::ROUNDING;
use vehicle::correction::{CommandCorrection, Correction, Linkage};
use vehicle::{Bounds, Control};

use super::case::{Tried, Verdict, failed, passed_if, require};
use super::drive::Course;
use super::lifecycle::end;
use super::message::Message;
use super::suite::Suite;
use super::test_bench::{ANSWER_NS, TestBench};

/// The first scan of the cases: here the recorded commands drive.
const FIRST_SCAN: u64 = 20;
/// Scans of a case.
const SCANS: usize = 10;
/// Scans that nothing answers during a silence.
const MISSED_SCANS: u64 = 2;

pub(crate) fn limits(bench: &mut TestBench<'_>) -> Verdict {
    // Velocities [m/s] and steering angles [rad] outside the limits (7.41).
    let Bounds { velocity_max_mps, reverse_max_mps, steering_max_rad, .. } =
        bench.suite.vehicle.description.bounds;
    let (half_mps, sharp_rad) = (velocity_max_mps / 2.0, steering_max_rad + 0.14);
    let outside = [
        (half_mps, sharp_rad),
        (half_mps, -sharp_rad),
        (velocity_max_mps + 2.0, 0.0),
        (-reverse_max_mps - 0.2, 0.0),
    ];
    for (velocity, steering) in outside {
        let what = format!("a command of {velocity:.2} m/s and {steering:.2} rad");
        let set = |command: &mut Command| (command.velocity_mps, command.steering_rad) = (velocity, steering);
        not_driven(bench, &what, set)?;
    }
    Ok(format!("{} commands outside the limits", outside.len()))
}

/// Blocked wheels have stopped the robot after so many times of what it takes.
const STOPPED: f64 = 1.5;

/// Passes when the robot is sent what is right for what is commanded, with the calibration of the course, and after a stop
/// also backwards.
pub(crate) fn sends(bench: &mut TestBench<'_>) -> Verdict {
    let correction = bench.drive.settings.tuning.actuator.calibration.correction();
    let mut driven = 0;
    for actuation in bench.samples::<Actuation>(SCANS)? {
        let Some(command) = bench.drive.step(actuation.header.scan_id).command else { continue };
        if !actuation.drives() || command.kind != CommandKind::Drive.wire() {
            continue;
        }
        driven += 1;
        let desired = Control { velocity: command.velocity_mps, steering: command.steering_rad };
        require_sent(&bench.suite.vehicle.description.bounds, &correction, desired, &actuation)?;
    }
    require(driven * 2 >= SCANS, || format!("{driven} of {SCANS} commands to drive were driven"))?;
    // The first block comes with the first of them.
    let vehicle = &bench.suite.vehicle;
    for _ in 0..=vehicle.stopping_ns(STOPPED).div_ceil(bench.suite.period_ns) {
        bench.round_with(|message| message.change(stop))?;
    }
    let bounds = vehicle.description.bounds;
    if bounds.mirrored().is_none() {
        return Ok(format!("{driven} commands"));
    }
    // Backwards to the left.
    let back = Control { velocity: vehicle.back_mps(0.2), steering: bounds.steering_max_rad / 2.0 };
    for _ in 0..2 {
        let answer = bench.round_with(|message| message.change(|command| go(command, back)))?;
        require(drives(&answer), || format!("it does not drive at {:.2} m/s from rest", back.velocity))?;
        require_sent(&bounds, &correction, back, answer.sample()?)?;
    }
    Ok(format!("{driven} commands, and backwards"))
}

/// Requires that what is right for a control is sent.
fn require_sent(
    bounds: &Bounds,
    correction: &CommandCorrection,
    desired: Control,
    actuation: &Actuation,
) -> Tried {
    // The calibrations of these drives have no play, so the position of the linkage does not matter.
    let Correction { velocity, steering, .. } = correction.correct(bounds, desired, Linkage::default());
    let sent = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
    let off = (sent.0 - velocity).abs().max((sent.1 - steering).abs());
    let text = |velocity: f64, steering: f64| format!("{velocity:.4} m/s and {steering:.5} rad");
    let (right, desired) = (text(velocity, steering), text(desired.velocity, desired.steering));
    require(off <= ROUNDING, || format!("sent {} for {desired}; {right} is right", text(sent.0, sent.1)))
}

/// Makes it a command to stop.
fn stop(command: &mut Command) {
    (command.kind, command.level) = (CommandKind::Stop.wire(), Level::Stop.wire());
    (command.reason, command.verified) = (StopReason::Blocked.wire(), 0);
    (command.velocity_mps, command.steering_rad) = (0.0, 0.0);
}

/// Makes it a command to drive.
fn go(command: &mut Command, control: Control) {
    (command.kind, command.level) = (CommandKind::Drive.wire(), Level::Converged.wire());
    (command.reason, command.verified) = (StopReason::None.wire(), 1);
    (command.velocity_mps, command.steering_rad) = (control.velocity, control.steering);
}

pub(crate) fn obeys_stop(suite: &Suite) -> Verdict {
    for (kind, reason) in [(CommandKind::Stop, StopReason::Blocked), (CommandKind::Land, StopReason::Landed)]
    {
        let mut bench = suite.started_on(Course::Corridor, FIRST_SCAN)?;
        driving(&mut bench)?;
        let scan_id = with_command(&mut bench, |command| {
            stop(command);
            (command.kind, command.reason) = (kind.wire(), reason.wire());
        })?;
        let answer = bench.answer(scan_id)?;
        let Actuation { kind: answered, stop_reason, .. } = answer.sample()?;
        require(*answered == ActuationKind::Block.wire(), || format!("it drives after `{kind}`"))?;
        let other = || format!("stop reason {stop_reason} after `{kind}` because of `{reason}`");
        require(*stop_reason == reason.wire(), other)?;
    }
    Ok("`stop` and `land` block the wheels".to_owned())
}

pub(crate) fn stop_wins(bench: &mut TestBench<'_>) -> Verdict {
    let before = bench.scan_id;
    bench.direct(|directive| directive.stop = 1)?;
    bench.rounds(6)?;
    let from = |first| bench.received.iter().filter(move |received| received.scan_id() >= first);
    let driven = from(before + 1).find(|received| drives(received));
    let scan_id = driven.map_or(before, |received| received.scan_id());
    let drives_on = || format!("it drives by scan {scan_id}, {} scans after the stop", scan_id - before);
    require(driven.is_none(), drives_on)?;
    let blocked = from(before).any(|received| !drives(received));
    require(blocked, || "it publishes nothing that blocks the wheels")?;
    bench.direct(|directive| directive.stop = 0)?;
    let drives = bench.rounds(4)?.last().is_some_and(drives);
    require(drives, || "it does not drive again when the stop is over")?;
    Ok("blocked while the directive says stop".to_owned())
}

pub(crate) fn silence(bench: &mut TestBench<'_>) -> Verdict {
    let published_ns = |received: &Message| received.header().stage(bench.suite.role).published_ns;
    let from_ns = published_ns(&bench.round()?);
    let block = wait_for_block(bench)?;
    let periods = published_ns(&block).saturating_sub(from_ns) as f64 / bench.suite.period_ns as f64;
    passed_if((1.0..2.0).contains(&periods), format!("blocked {periods:.2} periods after the last command"))
}

pub(crate) fn two_after_silence(bench: &mut TestBench<'_>) -> Verdict {
    let kinds = after_silence(bench, MISSED_SCANS, 3)?;
    require(kinds == ["block", "drive", "drive"], || format!("{} after the silence", kinds.join(", ")))?;
    Ok("block, drive, drive".to_owned())
}

pub(crate) fn gap(bench: &mut TestBench<'_>) -> Verdict {
    let kinds = after_silence(bench, 0, 2)?;
    require(kinds == ["drive", "drive"], || "it waits for a second command after a gap")?;
    Ok("drives with the first command after the gap".to_owned())
}

/// The answers to commands after a time without, in which scans came that were not answered.
fn after_silence(bench: &mut TestBench<'_>, missed: u64, count: usize) -> Tried<Vec<&'static str>> {
    wait_for_block(bench)?;
    bench.scan_id += missed;
    bench.begin();
    let answers = bench.rounds(count)?;
    Ok(answers.iter().map(|answer| if drives(answer) { "drive" } else { "block" }).collect())
}

/// Waits until the actuator blocks the wheels without a command.
fn wait_for_block(bench: &mut TestBench<'_>) -> Tried<Message> {
    let count = bench.received.len();
    let block = bench.find(ANSWER_NS, |bench| {
        bench.received[count..].iter().find(|received| !drives(received)).cloned()
    })?;
    block.map_or_else(|| failed("it drives on without a command"), Ok)
}

pub(crate) fn future(bench: &mut TestBench<'_>) -> Verdict {
    let ahead_ns = 5 * bench.suite.period_ns;
    not_driven(bench, "a command five periods ahead", |command| command.header.acquired_ns += ahead_ns)?;
    Ok("1 command five periods ahead".to_owned())
}

pub(crate) fn last_message(bench: &mut TestBench<'_>) -> Verdict {
    bench.may_end = true;
    end(bench)?;
    let blocks = bench.received.last().is_some_and(|received| !drives(received));
    require(blocks, || "its last message drives")?;
    Ok("its last message blocks the wheels".to_owned())
}

pub(crate) fn first_message(bench: &mut TestBench<'_>) -> Verdict {
    bench.replace(true, None)?;
    let publishes = bench.until(ANSWER_NS, |bench| !bench.received.is_empty())?;
    require(publishes, || "it publishes nothing without a command")?;
    require(!drives(&bench.received[0]), || "its first message drives")?;
    Ok("its first message blocks the wheels".to_owned())
}

/// Requires that a candidate that is commanded to drive does.
pub(crate) fn driving(bench: &mut TestBench<'_>) -> Tried {
    let drives = bench.rounds(5)?.last().is_some_and(drives);
    require(drives, || "it blocks the wheels after five commands to drive")
}

pub(crate) fn drives(received: &Message) -> bool {
    !received.is_harmless()
}

/// Publishes the next command, changed; returns its scan.
fn with_command(bench: &mut TestBench<'_>, change: impl Fn(&mut Command)) -> Tried<u64> {
    bench.ask_with(|message| message.change(&change))?;
    Ok(bench.scan_id - 1)
}

/// Requires that a changed command does not drive.
fn not_driven(bench: &mut TestBench<'_>, what: &str, change: impl Fn(&mut Command)) -> Tried {
    let scan_id = with_command(bench, change)?;
    bench.rounds(2)?;
    bench.require_no_answer(scan_id, what)
}
