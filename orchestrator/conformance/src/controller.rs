//! What a controller must want: to drive where it may, and to stop where it must.

use shared_types::{
    Alarm, Command, CommandKind, Level as CommandLevel, Obstacle, Obstacles, StopReason, Suspect, Topic,
};

use super::case::{Case, LIVE, Level, Trouble, Verdict, failed, require};
use super::drive::Course;
use super::message::Message;
use super::suite::{Setup, Suite};
use super::test_bench::TestBench;

/// Scans of a case.
const SCANS: usize = 12;
/// How far before the barrier the robot's centre is: 0.5 m from its front [m].
const IN_FRONT_M: f64 = 0.8;

/// The cases of controllers alone.
pub(crate) const CASES: [Case; 9] = [
    Case {
        name: "drives",
        level: Level::Required,
        requirement: "On a free track it commands to drive.",
        why: "A robot that stands is safe and of no use.",
        tries: LIVE,
        play: drives,
    },
    Case {
        name: "stops-before-a-barrier",
        level: Level::Required,
        requirement: "Half a metre in front of a barrier over the whole width of the track it stops, and says why.",
        why: "There is no way around it.",
        tries: LIVE,
        play: stops_before_a_barrier,
    },
    Case {
        name: "lands",
        level: Level::Required,
        requirement: "At the goal it commands `land`.",
        why: "Landed is how a run ends as `reached`.",
        tries: LIVE,
        play: lands,
    },
    Case {
        name: "off-the-track",
        level: Level::Required,
        requirement: "A pose far outside the track is not driven on.",
        why: "The pose or the track must be wrong, and nobody knows which.",
        tries: LIVE,
        play: off_the_track,
    },
    Case {
        name: "obstacle-inside",
        level: Level::Recommended,
        requirement: "An obstacle where the robot is, is not driven on.",
        why: "Pose and obstacles contradict each other.",
        tries: LIVE,
        play: obstacle_inside,
    },
    Case {
        name: "verified",
        level: Level::Required,
        requirement: "A drive command says `verified` = 1, and says so only of a plan that keeps bounds, obstacles and model.",
        why: "The actuator drops any other drive command, and the wheels are blocked.",
        tries: LIVE,
        play: verified,
    },
    Case {
        name: "obeys-alarm",
        level: Level::Required,
        requirement: "A pose whose alarm is `stop` is not driven on.",
        why: "The estimator knows that the robot is not where it seems, or moves otherwise than told.",
        tries: LIVE,
        play: obeys_alarm,
    },
    Case {
        name: "names-its-reason",
        level: Level::Recommended,
        requirement: "A drive command has a level above `stop` and no stop reason, a stop has level `stop` and a reason.",
        why: "The report tells the user why the robot stopped.",
        tries: LIVE,
        play: names_its_reason,
    },
    Case {
        name: "plan",
        level: Level::Recommended,
        requirement: "A drive command carries its plan: at least two nodes, the first within 0.1 m of the predicted state.",
        why: "What is verified, shown and followed in the next scan is the plan.",
        tries: LIVE,
        play: plan,
    },
];

fn drives(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Free, ..Setup::default() })?;
    let driven = count_drives(&bench.rounds(SCANS)?)?;
    require(driven * 10 >= SCANS * 9, || format!("{driven} of {SCANS} commands drive"))?;
    Ok(format!("{driven} of {SCANS} commands drive"))
}

fn verified(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Free, ..Setup::default() })?;
    let mut driven = 0;
    for received in bench.rounds(SCANS)? {
        let command = command(&received.message)?;
        if command.kind == CommandKind::Drive.wire() {
            require(command.verified == 1, || {
                format!("scan {}: `verified` is {}", command.header.scan_id, command.verified)
            })?;
            driven += 1;
        }
    }
    require(driven > 0, || "it never drove".to_owned())?;
    Ok(format!("{driven} drive commands"))
}

fn stops_before_a_barrier(suite: &Suite) -> Verdict {
    let commands = before_a_barrier(suite)?;
    for command in &commands {
        require(command.kind != CommandKind::Drive.wire(), || {
            format!("scan {}: it drives on, {IN_FRONT_M} m before a barrier", command.header.scan_id)
        })?;
        require(command.reason != StopReason::None.wire(), || "it stops without a reason".to_owned())?;
    }
    Ok(format!("{} stops, {IN_FRONT_M} m before a barrier", commands.len()))
}

/// Commands to a robot that stands before a barrier; a controller may look twice before it believes what it sees.
fn before_a_barrier(suite: &Suite) -> Result<Vec<Command>, Trouble> {
    let first_scan = suite.drive(Course::Barrier)?.ended as u64 - SCANS as u64;
    let mut bench = suite.started(Setup { course: Course::Barrier, first_scan, ..Setup::default() })?;
    let mut commands = Vec::new();
    for _ in 0..SCANS {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        let x_m = bench.drive.step(scan_id).pose.map_or(0.0, |pose| pose.predicted_x_m);
        for mut message in bench.inputs(scan_id)? {
            if let Message::Obstacles(obstacles) = &mut message {
                bring(obstacles, x_m + IN_FRONT_M);
            }
            bench.publish(&mut message)?;
        }
        commands.push(command(&bench.answer(scan_id)?.message)?);
        bench.scan_id += 1;
    }
    Ok(commands.split_off(2))
}

/// Moves all obstacles along the track, so that their nearest box is at `x_m`.
fn bring(obstacles: &mut Obstacles, x_m: f64) {
    let nearest = obstacles.list().iter().map(|item| item.box_x_m).fold(f64::INFINITY, f64::min);
    let count = obstacles.list().len();
    for item in &mut obstacles.items[..count] {
        item.x_m += x_m - nearest;
        item.box_x_m += x_m - nearest;
    }
}

fn lands(suite: &Suite) -> Verdict {
    let drive = suite.drive(Course::Free)?;
    let landed =
        |step: &pipeline::Step| step.command.is_some_and(|command| command.kind == CommandKind::Land.wire());
    let landing = drive.steps.iter().position(landed).unwrap_or(0) as u64 + 1;
    let mut bench =
        suite.started(Setup { course: Course::Free, first_scan: landing - 5, ..Setup::default() })?;
    // Half a metre before the goal, and the standing robot after it.
    let received = bench.rounds(5 + SCANS)?;
    let last = command(&received[received.len() - 1].message)?;
    let kind = CommandKind::try_from(last.kind).map_or("nothing known", CommandKind::name);
    let distance_m = bench.drive.step(last.header.scan_id).truth.goal_distance_m;
    let text = format!("`{kind}` at {distance_m:.3} m from the goal");
    if last.kind == CommandKind::Land.wire() { Ok(text) } else { failed(text) }
}

fn off_the_track(suite: &Suite) -> Verdict {
    not_driven_on(suite, "a pose 30 m beside the track", |_, message| {
        if let Message::Pose(pose) = message {
            pose.y_m += 30.0;
            pose.predicted_y_m += 30.0;
        }
    })
}

fn obstacle_inside(suite: &Suite) -> Verdict {
    not_driven_on(suite, "an obstacle inside the robot", inside)
}

fn obeys_alarm(suite: &Suite) -> Verdict {
    not_driven_on(suite, "a pose with the alarm `stop`", |_, message| {
        if let Message::Pose(pose) = message {
            (pose.suspect, pose.alarm) = (Suspect::VelocityFactor.wire(), Alarm::Stop.wire());
        }
    })
}

/// That inputs spoilt in one way are not driven on.
fn not_driven_on(suite: &Suite, what: &str, spoil: fn(&TestBench<'_>, &mut Message)) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 20, ..Setup::default() })?;
    let before = bench.rounds(3)?;
    require(count_drives(&before)? > 0, || format!("it does not drive even before {what}"))?;
    for _ in 0..3 {
        let scan_id = bench.scan_id;
        bench.wait_until_due(scan_id)?;
        for mut message in bench.inputs(scan_id)? {
            spoil(&bench, &mut message);
            bench.publish(&mut message)?;
        }
        bench.scan_id += 1;
    }
    let last = bench.scan_id;
    // When this one is answered, so are those before it.
    bench.round()?;
    for scan_id in last - 3..last {
        bench.require_no_answer(scan_id, what)?;
    }
    Ok("no drive command in 3 scans".to_owned())
}

/// Replaces all obstacles by one that stands where the robot is.
fn inside(bench: &TestBench<'_>, message: &mut Message) {
    if let Message::Obstacles(obstacles) = message {
        let Some(pose) = bench.drive.step(obstacles.header.scan_id).pose else { return };
        obstacles.items = Default::default();
        obstacles.count = 1;
        obstacles.items[0] = Obstacle {
            id: 1,
            body: 1,
            x_m: pose.predicted_x_m,
            y_m: pose.predicted_y_m,
            a_m: 1.0,
            b_m: 0.8,
            box_x_m: pose.predicted_x_m,
            box_y_m: pose.predicted_y_m,
            box_length_m: 0.4,
            box_width_m: 0.4,
            sightings: 10,
            ..Obstacle::default()
        };
    }
}

fn names_its_reason(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { course: Course::Free, ..Setup::default() })?;
    let mut all = before_a_barrier(suite)?;
    for received in bench.rounds(SCANS)? {
        all.push(command(&received.message)?);
    }
    for command in &all {
        let drives = command.kind == CommandKind::Drive.wire();
        let above = command.level != CommandLevel::Stop.wire();
        let reason = command.reason != StopReason::None.wire();
        require(drives == above && drives != reason, || {
            format!(
                "scan {}: kind {}, level {}, reason {}",
                command.header.scan_id, command.kind, command.level, command.reason
            )
        })?;
    }
    Ok(format!("{} commands", all.len()))
}

fn plan(suite: &Suite) -> Verdict {
    let mut bench = suite.started(Setup { first_scan: 20, ..Setup::default() })?;
    let mut plans = 0;
    for received in bench.rounds(SCANS)? {
        let command = command(&received.message)?;
        if command.kind != CommandKind::Drive.wire() {
            continue;
        }
        let (Some(node), Some(pose)) =
            (command.nodes().first(), bench.drive.step(command.header.scan_id).pose)
        else {
            return failed(format!("scan {}: no plan", command.header.scan_id));
        };
        let off_m = (node.x_m - pose.predicted_x_m).hypot(node.y_m - pose.predicted_y_m);
        require(command.nodes().len() >= 2 && off_m <= 0.1 && command.plan_interval_s > 0.0, || {
            format!(
                "scan {}: {} nodes {} s apart, the first {off_m:.2} m from the predicted state",
                command.header.scan_id,
                command.nodes().len(),
                command.plan_interval_s
            )
        })?;
        plans += 1;
    }
    require(plans > 0, || "it never drove".to_owned())?;
    Ok(format!("{plans} plans"))
}

fn count_drives(received: &[super::test_bench::Received]) -> Result<usize, Trouble> {
    let mut count = 0;
    for received in received {
        count += usize::from(command(&received.message)?.kind == CommandKind::Drive.wire());
    }
    Ok(count)
}

fn command(message: &Message) -> Result<Command, Trouble> {
    match message {
        Message::Command(command) => Ok(**command),
        other => failed(format!("{} where {} was expected", other.topic(), Topic::Command)),
    }
}
