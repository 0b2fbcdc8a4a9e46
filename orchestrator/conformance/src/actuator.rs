//! What an actuator must pass on, and when it must block the wheels whatever is commanded.

use shared_types::{
    Actuation, ActuationKind, Command, CommandKind, Level as CommandLevel, StopReason, Topic,
};
use vehicle::Control;
use vehicle::correction::{Correction, Linkage};

use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::drive::Course;
use super::lifecycle::end;
use super::message::Message;
use super::ranges::SENT;
use super::suite::{Setup, Suite};
use super::test_bench::{ANSWER_NS, TestBench};

/// Where in the drive the cases begin: the commands drive.
const FIRST_SCAN: u64 = 20;
/// Scans of a case.
const SCANS: usize = 10;

/// The cases of actuators alone.
pub(crate) const CASES: [Case; 10] = [
    Case {
        name: "limits",
        level: Level::Required,
        requirement: "A command to drive outside the limits (7.41) blocks the wheels.",
        why: "Whoever made it is broken.",
        tries: LIVE,
        play: limits,
    },
    Case {
        name: "sends-what-is-desired",
        level: Level::Required,
        requirement: "With the calibration `identity` it sends velocity and angle of the command.",
        why: "The plan was verified for these.",
        tries: LIVE,
        play: sends_what_is_desired,
    },
    Case {
        name: "calibration",
        level: Level::Recommended,
        requirement: "With the calibration of the settings it sends what undoes velocity factor and steering map.",
        why: "The robot would drive 1.4 times slower, and steer by another angle.",
        tries: LIVE,
        play: calibration,
    },
    Case {
        name: "obeys-stop",
        level: Level::Required,
        requirement: "A command `stop` or `land` blocks the wheels in answer to its scan, with its reason.",
        why: "It is the controller's only way to stop.",
        tries: LIVE,
        play: obeys_stop,
    },
    Case {
        name: "stop-wins",
        level: Level::Required,
        requirement: "While the directive says stop the wheels are blocked, whatever is commanded; at most one command may \
                      have been on its way.",
        why: "It is the user's only way to stop.",
        tries: LIVE,
        play: stop_wins,
    },
    Case {
        name: "silence",
        level: Level::Required,
        requirement: "Without a command it blocks the wheels by itself after one and a half periods, and before two.",
        why: "The robot would drive on by its last command.",
        tries: LIVE,
        play: silence,
    },
    Case {
        name: "two-after-silence",
        level: Level::Required,
        requirement: "After a silence it drives again with the second valid command in a row.",
        why: "A single one may be the last word of a process that is dying.",
        tries: LIVE,
        play: two_after_silence,
    },
    Case {
        name: "future",
        level: Level::Required,
        requirement: "A command of a scan that lies in the future is not driven.",
        why: "Its header is not to be believed, and with it nothing in it.",
        tries: LIVE,
        play: future,
    },
    Case {
        name: "last-word",
        level: Level::Required,
        requirement: "Asked to end (SIGTERM), its last word blocks the wheels.",
        why: "Until the robot's own dead-man acts they would go on turning.",
        tries: LIVE,
        play: last_word,
    },
    Case {
        name: "first-word",
        level: Level::Required,
        requirement: "Taking the place of another without its state, its first word blocks the wheels, without a command.",
        why: "The robot may be driving by the last word of the one before.",
        tries: LIVE,
        play: first_word,
    },
];

fn limits(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let bad = [(0.5, 0.2), (0.5, -0.2), (3.0, 0.0), (-0.5, 0.0)];
    for (velocity, steering) in bad {
        let scan_id = with_command(&mut bench, |command| {
            (command.velocity_mps, command.steering_rad) = (velocity, steering);
        })?;
        bench.rounds(2)?;
        bench.require_no_answer(scan_id, &format!("a command of {velocity} m/s and {steering} rad"))?;
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
        let actuation = actuation(&received.message)?;
        let Some(command) = bench.drive.step(actuation.header.scan_id).command else { continue };
        if actuation.kind != ActuationKind::Drive.wire() || command.kind != CommandKind::Drive.wire() {
            continue;
        }
        driven += 1;
        let desired = Control { velocity: command.velocity_mps, steering: command.steering_rad };
        // The calibrations of these drives know no play, so where the linkage stands does not matter.
        let Correction { velocity, steering, .. } = correction.correct(desired, Linkage::default());
        let off = (actuation.sent_velocity_mps - velocity)
            .abs()
            .max((actuation.sent_steering_rad - steering).abs());
        require(off <= SENT, || {
            format!(
                "sent {:.4} m/s and {:.5} rad for {:.4} m/s and {:.5} rad; {velocity:.4} m/s and {steering:.5} rad is right",
                actuation.sent_velocity_mps, actuation.sent_steering_rad, desired.velocity, desired.steering
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
        let scan_id = with_command(&mut bench, |command| {
            command.kind = kind.wire();
            command.level = CommandLevel::Stop.wire();
            command.reason = reason.wire();
            command.verified = 0;
            (command.velocity_mps, command.steering_rad) = (0.0, 0.0);
        })?;
        let answer = bench.answer(scan_id)?;
        let answer = actuation(&answer.message)?;
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
    for received in bench.received.iter().filter(|received| received.message.scan_id() > before) {
        require(received.message.is_harmless(), || {
            format!(
                "it drives by scan {}, {} scans after the stop",
                received.message.scan_id(),
                received.message.scan_id() - before
            )
        })?;
    }
    let blocked = bench
        .received
        .iter()
        .any(|received| received.message.scan_id() >= before && received.message.is_harmless());
    require(blocked, || "it says nothing that blocks the wheels".to_owned())?;
    bench.direct(|directive| directive.stop = 0)?;
    let after = bench.rounds(4)?;
    let drives = after.last().is_some_and(|received| !received.message.is_harmless());
    require(drives, || "it does not drive again when the stop is over".to_owned())?;
    Ok("blocked while the directive says stop".to_owned())
}

fn silence(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let last = bench.round()?;
    let from_ns = last.message.header().stage(suite.role).published_ns;
    let received = bench.received.len();
    let blocks = |bench: &TestBench<'_>| {
        bench.received[received..].iter().position(|received| received.message.is_harmless())
    };
    bench.until(ANSWER_NS, |bench| blocks(bench).is_some())?;
    let Some(index) = blocks(&bench) else { return failed("it drives on without a command") };
    let block = &bench.received[received + index].message;
    let after = block.header().stage(suite.role).published_ns.saturating_sub(from_ns);
    let periods = after as f64 / suite.period_ns as f64;
    let text = format!("blocked {periods:.2} periods after the last command");
    if (1.0..2.0).contains(&periods) { Ok(text) } else { failed(text) }
}

fn two_after_silence(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let received = bench.received.len();
    let blocks = |bench: &TestBench<'_>| {
        bench.received[received..].iter().any(|received| received.message.is_harmless())
    };
    if !bench.until(ANSWER_NS, blocks)? {
        return failed("it drives on without a command");
    }
    bench.begin();
    let kinds: Vec<bool> = bench.rounds(3)?.iter().map(|received| !received.message.is_harmless()).collect();
    require(kinds == [false, true, true], || {
        let names = kinds.iter().map(|drives| if *drives { "drive" } else { "block" });
        format!("{} after the silence", names.collect::<Vec<_>>().join(", "))
    })?;
    Ok("block, drive, drive".to_owned())
}

fn future(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    let period_ns = suite.period_ns;
    let scan_id = with_command(&mut bench, |command| command.header.acquired_ns += 5 * period_ns)?;
    bench.rounds(2)?;
    bench.require_no_answer(scan_id, "a command five periods ahead")?;
    Ok("1 command five periods ahead".to_owned())
}

fn last_word(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.may_end = true;
    end(&mut bench)?;
    let last = bench.received.last().map(|received| received.message.is_harmless());
    require(last == Some(true), || "its last word drives".to_owned())?;
    Ok("its last word blocks the wheels".to_owned())
}

fn first_word(suite: &Suite) -> Verdict {
    let mut bench = driving(suite)?;
    bench.replace()?;
    bench.received.clear();
    bench.spawn(true, None)?;
    bench.wait_for_state(shared_types::ProcessState::Connected)?;
    if !bench.until(ANSWER_NS, |bench| !bench.received.is_empty())? {
        return failed("it says nothing without a command");
    }
    require(bench.received[0].message.is_harmless(), || "its first word drives".to_owned())?;
    Ok("its first word blocks the wheels".to_owned())
}

/// A candidate that has been commanded to drive, and does.
fn driving(suite: &Suite) -> Result<TestBench<'_>, Trouble> {
    let mut bench = suite.started(Setup { first_scan: FIRST_SCAN, ..Setup::default() })?;
    let last = bench.rounds(5)?.pop();
    let drives = last.is_some_and(|received| !received.message.is_harmless());
    require(drives, || "it blocks the wheels after five commands to drive".to_owned())?;
    Ok(bench)
}

/// Says the next command, changed; returns its scan.
fn with_command(bench: &mut TestBench<'_>, change: impl FnOnce(&mut Command)) -> Result<u64, Trouble> {
    let scan_id = bench.scan_id;
    bench.wait_until_due(scan_id)?;
    let mut message = bench.message(Topic::Command, scan_id)?;
    if let Message::Command(command) = &mut message {
        change(command);
    }
    bench.publish(&mut message)?;
    bench.scan_id += 1;
    Ok(scan_id)
}

fn actuation(message: &Message) -> Result<Actuation, Trouble> {
    match message {
        Message::Actuation(actuation) => Ok(**actuation),
        other => failed(format!("{} where {} was expected", other.topic(), Topic::Actuation)),
    }
}
