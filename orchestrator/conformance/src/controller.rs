//! What a controller must command: to drive where it may, and to stop where it must.

use shared_types::{
    Alarm, Command, CommandKind, GivenGoal, Level, Obstacle, Obstacles, Pose, ScannerHealth, ScannerState,
    StopReason, Suspect,
};
use vehicle::Goal;

use super::Trouble;
use super::case::{Tried, Verdict, failed, observed, passed_if, require};
use super::drive::{Course, Drive};
use super::message::Message;
use super::suite::Suite;
use super::test_bench::TestBench;

/// Scans of a case.
const SCANS: usize = 12;
/// Scans of a case whose inputs are spoilt.
const SPOILT_SCANS: u64 = 3;
/// Distance of the barrier from the robot's front [m].
const GAP_M: f64 = 0.52;

/// Distance to a goal that is set: the robot can land there [m].
const GOAL_AHEAD_M: f64 = 1.5;
/// Behind a goal no controller drives on [m].
const BEHIND_GOAL_M: f64 = 0.3;
/// A robot that has come so far along x is in the bend [m].
const IN_BEND_M: f64 = 5.0;

/// What is wrong with the inputs of a scan, and what makes them so.
pub(crate) type Spoilt = (&'static str, fn(&Drive, &mut Message));

/// The robot is not where the track is.
pub(crate) const OFF_THE_TRACK: [Spoilt; 1] = [("a pose 30 m beside the track", off_the_track)];
/// Pose and obstacles contradict each other.
pub(crate) const OBSTACLE_INSIDE: [Spoilt; 1] = [("an obstacle inside the robot", inside)];
/// The estimator tells to stop.
pub(crate) const ALARM: [Spoilt; 1] = [("a pose with the alarm `stop`", alarm)];
/// Scanners with which the robot must not drive.
pub(crate) const BAD_SCANNERS: [Spoilt; 4] = [
    ("a scanner that is blind", |_, message| scanner(message, ScannerState::Blind, 4.0)),
    ("a scanner that is stuck", |_, message| scanner(message, ScannerState::Stuck, 4.0)),
    ("a scanner that is contradictory", |_, message| scanner(message, ScannerState::Contradictory, 4.0)),
    ("a scanner that sees nothing ahead", |_, message| scanner(message, ScannerState::Healthy, 0.0)),
];

pub(crate) fn drives(bench: &mut TestBench<'_>) -> Verdict {
    let driven = driven(&bench.samples(SCANS)?).count();
    passed_if(driven * 10 >= SCANS * 9, format!("{driven} of {SCANS} commands drive"))
}

pub(crate) fn verified(bench: &mut TestBench<'_>) -> Verdict {
    let commands: Vec<Command> = bench.samples(SCANS)?;
    for Command { header, verified, .. } in driven(&commands) {
        require(*verified == 1, || format!("scan {}: `verified` is {verified}", header.scan_id))?;
    }
    some_drive(&commands, "drive commands")
}

/// Commands on a track without obstacles.
fn free_track(suite: &Suite) -> Tried<Vec<Command>> {
    suite.started_on(Course::Free, 1)?.samples(SCANS)
}

pub(crate) fn stops_before_a_barrier(suite: &Suite) -> Verdict {
    let (commands, in_front_m) = (before_a_barrier(suite)?, suite.vehicle.ahead_m(GAP_M));
    for command in &commands {
        let scan_id = command.header.scan_id;
        let drives = || format!("scan {scan_id}: it drives on, {in_front_m:.1} m before a barrier");
        require(!drives_on(command), drives)?;
        require(command.reason != StopReason::None.wire(), || "it stops without a reason")?;
    }
    let drives = free_track(suite)?.iter().any(drives_on);
    observed(drives, || "it does not drive on a free track either")?;
    Ok(format!("{} stops, {in_front_m:.1} m before a barrier", commands.len()))
}

/// Commands to a robot that rests before a barrier; a controller may need two scans to believe in an obstacle.
fn before_a_barrier(suite: &Suite) -> Tried<Vec<Command>> {
    let first_scan = suite.drive(Course::Barrier)?.ended as u64 - SCANS as u64;
    let mut bench = suite.started_on(Course::Barrier, first_scan)?;
    let mut commands = Vec::new();
    for _ in 0..SCANS {
        let x_m = bench.drive.step(bench.scan_id).pose.map_or(0.0, |pose| pose.predicted_x_m);
        let answer = bench
            .round_with(|message| message.change(|all| shift(all, x_m + suite.vehicle.ahead_m(GAP_M))))?;
        commands.push(*answer.sample()?);
    }
    Ok(commands.split_off(2))
}

/// Moves all obstacles along the track, so that their nearest box is at `x_m`.
fn shift(obstacles: &mut Obstacles, x_m: f64) {
    let nearest = obstacles.list().iter().map(|item| item.box_x_m).fold(f64::INFINITY, f64::min);
    let count = obstacles.list().len();
    for item in &mut obstacles.items[..count] {
        item.x_m += x_m - nearest;
        item.box_x_m += x_m - nearest;
    }
}

pub(crate) fn lands(suite: &Suite) -> Verdict {
    let lands = |command: &Command| command.kind == CommandKind::Land.wire();
    let drive = suite.drive(Course::Free)?;
    let landing = drive.steps.iter().position(|step| step.command.as_ref().is_some_and(lands));
    let first_scan = landing.unwrap_or(0) as u64 - 4;
    let mut bench = suite.started_on(Course::Free, first_scan)?;
    // Half a metre before the goal, and the resting robot after it.
    let commands: Vec<Command> = bench.samples(5 + SCANS)?;
    let (first, last) = (&commands[0], &commands[commands.len() - 1]);
    observed(!lands(first) || !lands(last), || "it lands also half a metre before the goal")?;
    let kind = CommandKind::try_from(last.kind).map_or("nothing known", CommandKind::name);
    let distance_m = bench.drive.step(last.header.scan_id).truth.goal_distance_m;
    passed_if(lands(last), format!("`{kind}` at {distance_m:.3} m from the goal"))
}

pub(crate) fn new_goal(bench: &mut TestBench<'_>) -> Verdict {
    let x_m =
        |bench: &TestBench<'_>| bench.drive.step(bench.scan_id).pose.map_or(0.0, |pose| pose.predicted_x_m);
    let goal = bench.drive.settings.scenario.goal.last();
    let [ahead_m, behind_m] = [GOAL_AHEAD_M, BEHIND_GOAL_M].map(|usual_m| bench.suite.vehicle.m(usual_m));
    let near = Goal { x_m: x_m(bench) + ahead_m, ..goal };
    give(bench, &near)?;
    let mut last = bench.round()?;
    while x_m(bench) < near.x_m + behind_m {
        last = bench.round()?;
    }
    let behind = || format!("it drives on, {behind_m} m behind a goal that was set");
    require(!drives_on(last.sample()?), behind)?;
    give(bench, &goal)?;
    let commands: Vec<Command> = bench.samples(SCANS)?;
    let drives = commands.last().is_some_and(drives_on);
    require(drives, || "it does not drive on to a goal that was set after it".to_owned())?;
    Ok(format!("it stops behind a goal {ahead_m} m ahead, and drives on to another"))
}

/// Sets the goal of the drive.
fn give(bench: &mut TestBench<'_>, goal: &Goal) -> Tried {
    let from_scan = bench.scan_id + 1;
    let Goal { x_m, y_m, tolerance_m, yaw_tolerance_rad, .. } = *goal;
    let given = GivenGoal { from_scan, x_m, y_m, tolerance_m, yaw_tolerance_rad, ..GivenGoal::default() };
    bench.direct(|directive| directive.goal = given)
}

pub(crate) fn bend(suite: &Suite) -> Verdict {
    let first_scan = suite.drive(Course::Bend)?.scan_at(IN_BEND_M);
    // A controller that follows lines only may refuse to start on a course.
    let refused = |trouble| match trouble {
        Trouble::Broken(error) => Trouble::Failed(format!("{error:#}")),
        other => other,
    };
    let mut bench = suite.started_on(Course::Bend, first_scan).map_err(refused)?;
    let commands: Vec<Command> = bench.samples(SCANS)?;
    let way = bench.drive.settings.scenario.course.clone().unwrap_or_default();
    for Command { header, plan, plan_length, .. } in driven(&commands) {
        let end = plan[..*plan_length as usize].last().map(|node| way.locate([node.x_m, node.y_m].into()));
        let [along_m, left_m] = end.unwrap_or_default();
        let beside_m = left_m.abs();
        let leaves = || format!("scan {}: its plan ends {beside_m:.2} m beside the course", header.scan_id);
        require(beside_m <= way.half_width_m(along_m), leaves)?;
    }
    some_drive(&commands, "drive commands in a bend")
}

/// Moves the pose out of the track.
fn off_the_track(_: &Drive, message: &mut Message) {
    message.change(|pose: &mut Pose| {
        pose.y_m += 30.0;
        pose.predicted_y_m += 30.0;
    });
}

/// Replaces all obstacles by one at the position of the robot.
fn inside(drive: &Drive, message: &mut Message) {
    let pose = drive.step(message.scan_id()).pose;
    let (Some(obstacles), Some(pose)) = (message.sample_mut::<Obstacles>(), pose) else { return };
    let mut item = Obstacle { id: 1, body: 1, a_m: 1.0, b_m: 0.8, sightings: 10, ..Obstacle::default() };
    (item.x_m, item.y_m) = (pose.predicted_x_m, pose.predicted_y_m);
    (item.box_x_m, item.box_y_m, item.box_length_m, item.box_width_m) = (item.x_m, item.y_m, 0.4, 0.4);
    (obstacles.count, obstacles.items) = (1, Default::default());
    obstacles.items[0] = item;
}

/// Raises the alarm that stops the robot.
fn alarm(_: &Drive, message: &mut Message) {
    message.change(|pose: &mut Pose| {
        (pose.suspect, pose.alarm) = (Suspect::VelocityFactor.wire(), Alarm::Stop.wire());
    });
}

/// Changes state and sight of the scanner.
fn scanner(message: &mut Message, state: ScannerState, seen_ahead_m: f64) {
    message.change(|described: &mut Obstacles| {
        described.scanner = ScannerHealth { state: state.wire(), ..ScannerHealth::healthy(seen_ahead_m) };
    });
}

/// Passes when none of these inputs makes it drive.
pub(crate) fn not_driven_on(suite: &Suite, spoilt: &[Spoilt]) -> Verdict {
    for (what, spoil) in spoilt {
        let mut bench = suite.started_on(Course::Corridor, 20)?;
        driving(&mut bench, what)?;
        let drive = bench.drive.clone();
        for _ in 0..SPOILT_SCANS {
            bench.ask_with(|message| spoil(&drive, message))?;
        }
        let last = bench.scan_id;
        // When this one is answered, so are those before it.
        bench.round()?;
        for scan_id in last - SPOILT_SCANS..last {
            bench.require_no_answer(scan_id, what)?;
        }
    }
    Ok(format!("no drive command in {} scans", SPOILT_SCANS * spoilt.len() as u64))
}

pub(crate) fn degraded_scanner(bench: &mut TestBench<'_>) -> Verdict {
    driving(bench, "the scanner is degraded")?;
    let careful_mps = bench.drive.settings.tuning.vehicle.careful_mps;
    let slowing = (1e9 / bench.suite.period_ns as f64).ceil() as usize;
    let mut fastest_mps = 0.0_f64;
    for scan in 0..slowing + SCANS {
        let answer = bench.round_with(|message| scanner(message, ScannerState::Degraded, 4.0))?;
        let command = answer.sample()?;
        if scan >= slowing && drives_on(command) {
            fastest_mps = fastest_mps.max(command.velocity_mps);
        }
    }
    let measured = format!("at most {fastest_mps:.2} m/s, {careful_mps} are allowed");
    passed_if(fastest_mps <= careful_mps + 0.01, measured)
}

/// Requires that the candidate drives before something happens.
fn driving(bench: &mut TestBench<'_>, before: &str) -> Tried {
    let drives = bench.samples(3)?.iter().any(drives_on);
    require(drives, || format!("it does not drive even before {before}"))
}

pub(crate) fn names_its_reason(suite: &Suite) -> Verdict {
    let mut all = before_a_barrier(suite)?;
    all.extend(free_track(suite)?);
    for command in &all {
        let Command { header, kind, level, reason, .. } = command;
        let is_above = *level != Level::Stop.wire();
        let has_reason = *reason != StopReason::None.wire();
        let wrong = || format!("scan {}: kind {kind}, level {level}, reason {reason}", header.scan_id);
        require(drives_on(command) == is_above && is_above != has_reason, wrong)?;
    }
    let driven = driven(&all).count();
    observed((1..all.len()).contains(&driven), || format!("{driven} of {} commands drive", all.len()))?;
    Ok(format!("{} commands", all.len()))
}

pub(crate) fn plan(bench: &mut TestBench<'_>) -> Verdict {
    let commands = bench.samples(SCANS)?;
    for command in driven(&commands) {
        let (scan_id, nodes, interval_s) = (command.header.scan_id, command.nodes(), command.plan_interval_s);
        let (Some(node), Some(pose)) = (nodes.first(), bench.drive.step(scan_id).pose) else {
            return failed(format!("scan {scan_id}: no plan"));
        };
        let off_m = (node.x_m - pose.predicted_x_m).hypot(node.y_m - pose.predicted_y_m);
        let count = nodes.len();
        let first = format!("the first {off_m:.2} m from the predicted state");
        let wrong = || format!("scan {scan_id}: {count} nodes {interval_s} s apart, {first}");
        require(count >= 2 && off_m <= 0.1 && interval_s > 0.0, wrong)?;
    }
    some_drive(&commands, "plans")
}

/// Passes when there is a command that drives.
fn some_drive(commands: &[Command], what: &str) -> Verdict {
    let count = driven(commands).count();
    require(count > 0, || "it never drove")?;
    Ok(format!("{count} {what}"))
}

/// The commands that drive.
fn driven(commands: &[Command]) -> impl Iterator<Item = &Command> {
    commands.iter().filter(|command| drives_on(command))
}

fn drives_on(command: &Command) -> bool {
    command.kind == CommandKind::Drive.wire()
}
