//! What an actuator must pass on, and when it must block the wheels whatever is commanded.

use shared_types::{Actuation, ActuationKind, Command, CommandKind, Level, StopReason};
use vehicle::Control;
use vehicle::bounds::ROUNDING;
use vehicle::correction::{Correction, Linkage};

use super::case::{Play, Trouble, Verdict, failed, passed_if, require};
use super::drive::Course;
use super::lifecycle::end;
use super::message::Received;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// The first scan of the cases: here the recorded commands drive.
const FIRST_SCAN: u64 = 20;
/// Scans of a case.
const SCANS: usize = 10;
/// Scans that nothing answers during a silence.
const MISSED_SCANS: u64 = 2;

/// The cases of actuators alone.
pub(crate) const CASES: [(&str, Play); 11] = [
    ("limits", limits),
    ("sends-what-is-desired", sends_what_is_desired),
    ("calibration", calibration),
    ("obeys-stop", obeys_stop),
    ("stop-wins", stop_wins),
    ("silence", silence),
    ("two-after-silence", two_after_silence),
    ("gap", gap),
    ("future", future),
    ("last-word", last_message),
    ("first-word", first_message),
];

fn limits(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let bad = [(0.5, 0.2), (0.5, -0.2), (3.0, 0.0), (-0.5, 0.0)];
    for (velocity, steering) in bad {
        let what = format!("a command of {velocity} m/s and {steering} rad");
        not_driven(&mut bench, &what, |command| {
            (command.velocity_mps, command.steering_rad) = (velocity, steering);
        })?;
    }
    Ok(format!("{} commands outside the limits", bad.len()))
}

fn sends_what_is_desired(suite: &Suite) -> Verdict {
    sends(suite, Course::Exact)
}

fn calibration(suite: &Suite) -> Verdict {
    sends(suite, Course::Corridor)
}

fn sends(suite: &Suite, course: Course) -> Verdict {
    let mut bench = suite.started(Setup { course, first_scan: FIRST_SCAN, ..Setup::default() })?;
    let correction = bench.drive.settings.tuning.actuator.calibration.correction();
    let mut driven = 0;
    for received in bench.rounds(SCANS)? {
        let actuation = received.message.sample::<Actuation>()?;
        let Some(command) = bench.drive.step(actuation.header.scan_id).command else { continue };
        if received.message.is_harmless() || command.kind != CommandKind::Drive.wire() {
            continue;
        }
        driven += 1;
        let desired = Control { velocity: command.velocity_mps, steering: command.steering_rad };
        // The calibrations of these drives have no play, so the position of the linkage does not matter.
        let Correction { velocity, steering, .. } = correction.correct(desired, Linkage::default());
        let sent = (actuation.sent_velocity_mps, actuation.sent_steering_rad);
        let off = (sent.0 - velocity).abs().max((sent.1 - steering).abs());
        require(off <= ROUNDING, || {
            format!(
                "sent {:.4} m/s and {:.5} rad for {:.4} m/s and {:.5} rad; {velocity:.4} m/s and {steering:.5} rad is right",
                sent.0, sent.1, desired.velocity, desired.steering
            )
        })?;
    }
    require(driven * 2 >= SCANS, || format!("{driven} of {SCANS} commands to drive were driven"))?;
    Ok(format!("{driven} commands"))
}

fn obeys_stop(suite: &Suite) -> Verdict {
    for (kind, reason) in [(CommandKind::Stop, StopReason::Blocked), (CommandKind::Land, StopReason::Landed)]
    {
        let mut bench = driving(suite)?;
        let answer = with_command(&mut bench, |command| {
            command.kind = kind.wire();
            command.level = Level::Stop.wire();
            command.reason = reason.wire();
            command.verified = 0;
            (command.velocity_mps, command.steering_rad) = (0.0, 0.0);
        })
        .and_then(|scan_id| bench.answer(scan_id))?;
        let answer = answer.message.sample::<Actuation>()?;
        require(answer.kind == ActuationKind::Block.wire(), || format!("it drives after `{kind}`"))?;
        require(answer.stop_reason == reason.wire(), || {
            format!("stop reason {} after `{kind}` because of `{reason}`", answer.stop_reason)
        })?;
    }
    Ok("`stop` and `land` block the wheels".to_owned())
}

fn stop_wins(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let before = bench.scan_id;
    bench.direct(|directive| directive.stop = 1)?;
    bench.rounds(6)?;
    let from = |first| bench.received.iter().filter(move |received| received.message.scan_id() >= first);
    if let Some(driven) = from(before + 1).find(|received| drives(received)) {
        let scan_id = driven.message.scan_id();
        return failed(format!("it drives by scan {scan_id}, {} scans after the stop", scan_id - before));
    }
    let blocked = from(before).any(|received| !drives(received));
    require(blocked, || "it publishes nothing that blocks the wheels".to_owned())?;
    bench.direct(|directive| directive.stop = 0)?;
    require(bench.rounds(4)?.last().is_some_and(drives), || {
        "it does not drive again when the stop is over".to_owned()
    })?;
    Ok("blocked while the directive says stop".to_owned())
}

fn silence(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let published_ns = |received: &Received| received.message.header().stage(suite.role).published_ns;
    let from_ns = published_ns(&bench.round()?);
    let block = wait_for_block(&mut bench)?;
    let periods = published_ns(&block).saturating_sub(from_ns) as f64 / suite.period_ns as f64;
    passed_if((1.0..2.0).contains(&periods), format!("blocked {periods:.2} periods after the last command"))
}

fn two_after_silence(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    wait_for_block(&mut bench)?;
    // Scans came meanwhile and were not answered.
    bench.scan_id += MISSED_SCANS;
    bench.begin();
    let kinds: Vec<bool> = bench.rounds(3)?.iter().map(drives).collect();
    require(kinds == [false, true, true], || {
        let names = kinds.iter().map(|drives| if *drives { "drive" } else { "block" });
        format!("{} after the silence", names.collect::<Vec<_>>().join(", "))
    })?;
    Ok("block, drive, drive".to_owned())
}

fn gap(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    wait_for_block(&mut bench)?;
    bench.begin();
    let answers = bench.rounds(2)?;
    require(answers.iter().all(drives), || "it waits for a second command after a gap".to_owned())?;
    Ok("drives with the first command after the gap".to_owned())
}

/// Waits until the actuator blocks the wheels without a command.
fn wait_for_block(bench: &mut TestBench<'_>) -> Result<Received, Trouble> {
    let count = bench.received.len();
    let block =
        |bench: &TestBench<'_>| bench.received[count..].iter().find(|received| !drives(received)).cloned();
    bench.until(ANSWER_NS, |bench| block(bench).is_some())?;
    block(bench).map_or_else(|| failed("it drives on without a command"), Ok)
}

fn future(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let period_ns = suite.period_ns;
    not_driven(&mut bench, "a command five periods ahead", |command| {
        command.header.acquired_ns += 5 * period_ns;
    })?;
    Ok("1 command five periods ahead".to_owned())
}

fn last_message(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.may_end = true;
    end(&mut bench)?;
    let blocks = bench.received.last().is_some_and(|received| !drives(received));
    require(blocks, || "its last message drives".to_owned())?;
    Ok("its last message blocks the wheels".to_owned())
}

fn first_message(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.replace(true, None)?;
    if !bench.until(ANSWER_NS, |bench| !bench.received.is_empty())? {
        return failed("it publishes nothing without a command");
    }
    require(!drives(&bench.received[0]), || "its first message drives".to_owned())?;
    Ok("its first message blocks the wheels".to_owned())
}

/// A candidate that has been commanded to drive, and does.
fn driving(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started_at(FIRST_SCAN)?;
    require(bench.rounds(5)?.last().is_some_and(drives), || {
        "it blocks the wheels after five commands to drive".to_owned()
    })?;
    Ok(bench)
}

fn drives(received: &Received) -> bool {
    !received.message.is_harmless()
}

/// Publishes the next command, changed; returns its scan.
fn with_command(bench: &mut TestBench<'_>, change: impl Fn(&mut Command)) -> Result<u64, Trouble> {
    bench.ask_with(|message| message.change(&change))?;
    Ok(bench.scan_id - 1)
}

/// Requires that a changed command does not drive.
fn not_driven(bench: &mut TestBench<'_>, what: &str, change: impl Fn(&mut Command)) -> Result<(), Trouble> {
    let scan_id = with_command(bench, change)?;
    bench.rounds(2)?;
    bench.require_no_answer(scan_id, what)
}
