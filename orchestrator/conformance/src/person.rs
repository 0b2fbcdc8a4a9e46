//! What actuator and controller must do when a person takes over, or presses a button.

use runtime::monotonic_ns;
use shared_types::{Actuation, BlockReason, Command, CommandKind, DrivenBy, GivenControl, Level};

use super::actuator::drives;
use super::case::{Tried, Verdict, require};
use super::message::Message;
use super::test_bench::TestBench;

/// Scans in which a change takes effect, and some more in which it must last.
const SCANS: usize = 6;
/// A button that is silent for so long counts as pressed [ns].
const SILENT_NS: u64 = 600_000_000;
/// Scans until a change must have taken effect.
const ON_ITS_WAY: usize = 2;

/// What the person asks for: velocity [m/s] and steering angle [rad].
fn asked(bench: &TestBench<'_>) -> (f64, f64) {
    let vehicle = &bench.suite.vehicle;
    (vehicle.mps(0.3), vehicle.description.bounds.steering_max_rad.min(0.02))
}

/// Says who drives, and what a person asks for now.
fn let_drive(bench: &mut TestBench<'_>, driven_by: DrivenBy, number: u64) -> Tried {
    let (velocity_mps, steering_rad) = asked(bench);
    let given_ns = if number == 0 { 0 } else { monotonic_ns() };
    bench.direct(|directive| {
        directive.driven_by = driven_by.wire();
        directive.person = GivenControl { number, given_ns, velocity_mps, steering_rad };
    })
}

/// Plays some scans, and requires of the last ones that none drives.
fn no_wheels(bench: &mut TestBench<'_>, when: &str) -> Tried {
    let answers = bench.rounds(SCANS)?;
    let driven = answers.iter().skip(ON_ITS_WAY).find(|answer| drives(answer));
    require(driven.is_none(), || format!("it drives {when}"))
}

/// Plays some scans, and requires that the last one drives.
fn wheels(bench: &mut TestBench<'_>, when: &str) -> Tried {
    let drives = bench.rounds(SCANS)?.last().is_some_and(drives);
    require(drives, || format!("it does not drive {when}"))
}

pub(crate) fn paused(bench: &mut TestBench<'_>) -> Verdict {
    let_drive(bench, DrivenBy::Nobody, 0)?;
    no_wheels(bench, "while nobody does")?;
    let_drive(bench, DrivenBy::Controller, 0)?;
    wheels(bench, "when the controller does again")?;
    Ok("blocked while nobody drives".to_owned())
}

pub(crate) fn by_hand(bench: &mut TestBench<'_>) -> Verdict {
    let by_person =
        |message: &mut Message| message.change(|command: &mut Command| command.level = Level::Person.wire());
    let_drive(bench, DrivenBy::Person, 1)?;
    no_wheels(bench, "by the controller while a person does")?;
    let mut driven = 0;
    for number in 2..2 + SCANS as u64 {
        let_drive(bench, DrivenBy::Person, number)?;
        driven += usize::from(drives(&bench.round_with(by_person)?));
    }
    require(driven + ON_ITS_WAY >= SCANS, || format!("{driven} of {SCANS} commands of a person drove"))?;
    // The person is gone: what was asked for last gets old.
    let mut late = Vec::new();
    for _ in 0..SCANS {
        late.push(bench.round_with(by_person)?);
    }
    let driven = late.iter().skip(ON_ITS_WAY).find(|answer| drives(answer));
    require(driven.is_none(), || "it drives by what a person asked for long ago".to_owned())?;
    Ok("only commands of the person drive, and only fresh ones".to_owned())
}

pub(crate) fn emergency_stop(bench: &mut TestBench<'_>) -> Verdict {
    let press = |bench: &mut TestBench<'_>, is_pressed| {
        if let Some(button) = &mut bench.button {
            button.set(is_pressed);
        }
        bench.turn()
    };
    // Until the button has said something it counts as pressed.
    let resume = |bench: &mut TestBench<'_>| {
        let_drive(bench, DrivenBy::Nobody, 0)?;
        no_wheels(bench, "while nobody does")?;
        let_drive(bench, DrivenBy::Controller, 0)?;
        wheels(bench, "when the controller does again")
    };
    resume(bench)?;
    for (is_pressed, when) in
        [(Some(true), "while the button is pressed"), (None, "while the button is silent")]
    {
        press(bench, is_pressed)?;
        bench.rounds((SILENT_NS / bench.suite.period_ns) as usize + 1)?;
        no_wheels(bench, when)?;
        let reason =
            bench.received.last().and_then(Message::get).map(|actuation: &Actuation| actuation.reason);
        require(reason == Some(BlockReason::EmergencyStop.wire()), || {
            format!("reason {reason:?} {when}, not `emergency_stop`")
        })?;
        press(bench, Some(false))?;
        no_wheels(bench, "when the button is released, before the orchestrator takes note of it")?;
        resume(bench)?;
    }
    Ok("pressed and silent".to_owned())
}

/// Requires that a candidate drives while the controller does.
pub(crate) fn commanded(bench: &mut TestBench<'_>) -> Tried {
    wheels(bench, "on a free track")
}

pub(crate) fn follows(bench: &mut TestBench<'_>) -> Verdict {
    let (mut driven, mut scans) = (0, Vec::new());
    for number in 1..=SCANS as u64 {
        let_drive(bench, DrivenBy::Person, number)?;
        scans.push(bench.round()?);
    }
    let (velocity_mps, steering_rad) = asked(bench);
    for answer in scans.iter().skip(ON_ITS_WAY) {
        let command: &Command = answer.sample()?;
        let asked = (command.velocity_mps - velocity_mps).abs() < 1e-9
            && (command.steering_rad - steering_rad).abs() < 1e-9;
        let drives = command.kind == CommandKind::Drive.wire();
        require(!drives || asked && command.level == Level::Person.wire(), || {
            let (asked_mps, asked_rad) = (velocity_mps, steering_rad);
            let Command { velocity_mps, steering_rad, level, .. } = command;
            format!(
                "{velocity_mps} m/s, {steering_rad} rad, level {level} where a person asks for {asked_mps} and {asked_rad}"
            )
        })?;
        driven += usize::from(drives);
    }
    let_drive(bench, DrivenBy::Nobody, 0)?;
    no_wheels(bench, "while nobody does")?;
    Ok(format!("{driven} commands as asked for"))
}
