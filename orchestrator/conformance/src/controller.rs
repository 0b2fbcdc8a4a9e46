//! What a controller must command: to drive where it may, and to stop where it must.

use shared_types::{
    Alarm, Command, CommandKind, Level, Obstacle, Obstacles, Pose, ScannerHealth, ScannerState, StopReason,
    Suspect,
};

use super::case::{Play, Trouble, Verdict, failed, observed, passed_if, require};
use super::drive::{Course, Drive};
use super::message::{Message, Received};
use super::suite::{Setup, Suite};

/// Scans of a case.
const SCANS: usize = 12;
/// Distance of the barrier from the robot's centre: 0.5 m from its front [m].
const IN_FRONT_M: f64 = 0.8;

/// Changes an input of a scan.
type Spoil = fn(&Drive, &mut Message);

/// The cases of controllers alone.
pub(crate) const CASES: [(&str, Play); 11] = [
    ("drives", drives),
    ("stops-before-a-barrier", stops_before_a_barrier),
    ("lands", lands),
    ("off-the-track", off_the_track),
    ("obstacle-inside", obstacle_inside),
    ("verified", verified),
    ("obeys-alarm", obeys_alarm),
    ("obeys-the-scanner", obeys_the_scanner),
    ("degraded-scanner", degraded_scanner),
    ("names-its-reason", names_its_reason),
    ("plan", plan),
];

fn drives(suite: &Suite) -> Verdict {
    let driven = driven(&free_track(suite)?)?.len();
    passed_if(driven * 10 >= SCANS * 9, format!("{driven} of {SCANS} commands drive"))
}

fn verified(suite: &Suite) -> Verdict {
    let driven = driven(&free_track(suite)?)?;
    for command in &driven {
        let Command { header, verified, .. } = command;
        require(*verified == 1, || format!("scan {}: `verified` is {verified}", header.scan_id))?;
    }
    require(!driven.is_empty(), || "it never drove".to_owned())?;
    Ok(format!("{} drive commands", driven.len()))
}

/// Commands on a track without obstacles.
fn free_track(suite: &Suite) -> Result<Vec<Received>, Trouble> {
    suite.started(Setup { course: Course::Free, ..Setup::default() })?.rounds(SCANS)
}

fn stops_before_a_barrier(suite: &Suite) -> Verdict {
    let commands = before_a_barrier(suite)?;
    for received in &commands {
        let Command { header, reason, .. } = received.message.sample()?;
        require(received.message.is_harmless(), || {
            format!("scan {}: it drives on, {IN_FRONT_M} m before a barrier", header.scan_id)
        })?;
        require(*reason != StopReason::None.wire(), || "it stops without a reason".to_owned())?;
    }
    let driven = driven(&free_track(suite)?)?.len();
    observed(driven > 0, || "it does not drive on a free track either".to_owned())?;
    Ok(format!("{} stops, {IN_FRONT_M} m before a barrier", commands.len()))
}

/// Commands to a robot that rests before a barrier; a controller may need two scans to believe in an obstacle.
fn before_a_barrier(suite: &Suite) -> Result<Vec<Received>, Trouble> {
    let first_scan = suite.drive(Course::Barrier)?.ended as u64 - SCANS as u64;
    let mut bench = suite.started(Setup { course: Course::Barrier, first_scan, ..Setup::default() })?;
    let mut commands = Vec::new();
    for _ in 0..SCANS {
        let x_m = bench.drive.step(bench.scan_id).pose.map_or(0.0, |pose| pose.predicted_x_m);
        let answer = bench.round_with(|message| message.change(|all| shift(all, x_m + IN_FRONT_M)));
        commands.push(answer?);
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

fn lands(suite: &Suite) -> Verdict {
    let drive = suite.drive(Course::Free)?;
    let landed =
        |step: &pipeline::Step| step.command.is_some_and(|command| command.kind == CommandKind::Land.wire());
    let landing = drive.steps.iter().position(landed).unwrap_or(0) as u64 + 1;
    let mut bench =
        suite.started(Setup { course: Course::Free, first_scan: landing - 5, ..Setup::default() })?;
    // Half a metre before the goal, and the resting robot after it.
    let received = bench.rounds(5 + SCANS)?;
    let last = received[received.len() - 1].message.sample::<Command>()?;
    let kind = CommandKind::try_from(last.kind).map_or("nothing known", CommandKind::name);
    let distance_m = bench.drive.step(last.header.scan_id).truth.goal_distance_m;
    let is_landing = last.kind == CommandKind::Land.wire();
    let first = received[0].message.sample::<Command>()?;
    observed(!is_landing || first.kind != CommandKind::Land.wire(), || {
        "it lands also half a metre before the goal".to_owned()
    })?;
    passed_if(is_landing, format!("`{kind}` at {distance_m:.3} m from the goal"))
}

fn off_the_track(suite: &Suite) -> Verdict {
    not_driven_on(suite, "a pose 30 m beside the track", |_, message| {
        message.change(|pose: &mut Pose| {
            pose.y_m += 30.0;
            pose.predicted_y_m += 30.0;
        });
    })
}

fn obstacle_inside(suite: &Suite) -> Verdict {
    not_driven_on(suite, "an obstacle inside the robot", inside)
}

fn obeys_alarm(suite: &Suite) -> Verdict {
    not_driven_on(suite, "a pose with the alarm `stop`", |_, message| {
        message.change(|pose: &mut Pose| {
            (pose.suspect, pose.alarm) = (Suspect::VelocityFactor.wire(), Alarm::Stop.wire());
        });
    })
}

fn obeys_the_scanner(suite: &Suite) -> Verdict {
    let faults: [(&str, Spoil); 4] = [
        ("a scanner that is blind", |_, message| scanner(message, ScannerState::Blind)),
        ("a scanner that is stuck", |_, message| scanner(message, ScannerState::Stuck)),
        ("a scanner that is contradictory", |_, message| scanner(message, ScannerState::Contradictory)),
        ("a scanner that sees nothing ahead", |_, message| {
            message.change(|described: &mut Obstacles| described.scanner = ScannerHealth::healthy(0.0));
        }),
    ];
    for (what, fault) in faults {
        not_driven_on(suite, what, fault)?;
    }
    Ok("no drive command in 12 scans".to_owned())
}

/// Changes the state of the scanner, which else sees far.
fn scanner(message: &mut Message, state: ScannerState) {
    message.change(|described: &mut Obstacles| {
        described.scanner = ScannerHealth { state: state.wire(), ..ScannerHealth::healthy(4.0) };
    });
}

fn degraded_scanner(suite: &Suite) -> Verdict {
    let mut bench = suite.started_at(20)?;
    let before = driven(&bench.rounds(3)?)?;
    require(!before.is_empty(), || "it does not drive even before the scanner is degraded".to_owned())?;
    let careful_mps = bench.drive.settings.tuning.vehicle.careful_mps;
    let slowing = (1e9 / suite.period_ns as f64).ceil() as usize;
    let mut fastest_mps = 0.0_f64;
    for scan in 0..slowing + SCANS {
        let answer = bench.round_with(|message| scanner(message, ScannerState::Degraded))?;
        if scan >= slowing {
            let commanded = driven(&[answer])?;
            fastest_mps = commanded.iter().map(|command| command.velocity_mps).fold(fastest_mps, f64::max);
        }
    }
    let measured = format!("at most {fastest_mps:.2} m/s, {careful_mps} are allowed");
    passed_if(fastest_mps <= careful_mps + 0.01, measured)
}

/// Passes when spoilt inputs do not make it drive.
fn not_driven_on(suite: &Suite, what: &str, spoil: Spoil) -> Verdict {
    let mut bench = suite.started_at(20)?;
    let before = driven(&bench.rounds(3)?)?;
    require(!before.is_empty(), || format!("it does not drive even before {what}"))?;
    let drive = bench.drive.clone();
    for _ in 0..3 {
        bench.ask_with(|message| spoil(&drive, message))?;
    }
    let last = bench.scan_id;
    // When this one is answered, so are those before it.
    bench.round()?;
    for scan_id in last - 3..last {
        bench.require_no_answer(scan_id, what)?;
    }
    Ok("no drive command in 3 scans".to_owned())
}

/// Replaces all obstacles by one at the position of the robot.
fn inside(drive: &Drive, message: &mut Message) {
    let pose = drive.step(message.scan_id()).pose;
    let (Some(obstacles), Some(pose)) = (message.sample_mut::<Obstacles>(), pose) else { return };
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

fn names_its_reason(suite: &Suite) -> Verdict {
    let mut all = before_a_barrier(suite)?;
    all.extend(free_track(suite)?);
    for received in &all {
        let Command { header, kind, level, reason, .. } = received.message.sample()?;
        let drives = *kind == CommandKind::Drive.wire();
        let is_above = *level != Level::Stop.wire();
        let has_reason = *reason != StopReason::None.wire();
        require(drives == is_above && drives != has_reason, || {
            format!("scan {}: kind {kind}, level {level}, reason {reason}", header.scan_id)
        })?;
    }
    let driven = driven(&all)?.len();
    observed((1..all.len()).contains(&driven), || format!("{driven} of {} commands drive", all.len()))?;
    Ok(format!("{} commands", all.len()))
}

fn plan(suite: &Suite) -> Verdict {
    let mut bench = suite.started_at(20)?;
    let driven = driven(&bench.rounds(SCANS)?)?;
    for command in &driven {
        let scan_id = command.header.scan_id;
        let (nodes, interval_s) = (command.nodes(), command.plan_interval_s);
        let (Some(node), Some(pose)) = (nodes.first(), bench.drive.step(scan_id).pose) else {
            return failed(format!("scan {scan_id}: no plan"));
        };
        let off_m = (node.x_m - pose.predicted_x_m).hypot(node.y_m - pose.predicted_y_m);
        require(nodes.len() >= 2 && off_m <= 0.1 && interval_s > 0.0, || {
            format!(
                "scan {scan_id}: {} nodes {interval_s} s apart, the first {off_m:.2} m from the predicted state",
                nodes.len()
            )
        })?;
    }
    require(!driven.is_empty(), || "it never drove".to_owned())?;
    Ok(format!("{} plans", driven.len()))
}

/// The commands that drive.
fn driven(received: &[Received]) -> Result<Vec<Command>, Trouble> {
    let commands: Result<Vec<Command>, Trouble> =
        received.iter().map(|received| received.message.sample().copied()).collect();
    Ok(commands?.into_iter().filter(|command| command.kind == CommandKind::Drive.wire()).collect())
}
