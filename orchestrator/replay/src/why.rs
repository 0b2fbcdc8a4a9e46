//! Why the robot did what it did in one scan of a recorded drive.
//!
//! Each sentence is computed from the recording: from the samples of the scan, or by leading the controller there by its
//! journals and asking it. What is not known is left out, or said to be not known.

mod decision;
mod overview;
mod processes;
mod stopped;

use emulator::Referee;
use nmpc::{ControllerStage, ShapedBy};
use serde::Serialize;
use shared_types::{
    Actuation, Alarm, BlockReason, Command, CommandKind, Level, Obstacles, Pose, Role, Scan, ScannerState,
    SolveStatus, StopReason, Suspect,
};

use self::decision::{Decision, changes};
use self::overview::timing;
pub use self::overview::{Row, late, slow, stops};
pub(crate) use self::processes::NEW_SCANS;
use self::processes::{logged, process};
use crate::ReplayDrive;
use crate::stage::lead;

/// Components of the state as a reader knows them.
const COMPONENTS: [&str; 5] = ["sideslip", "yaw", "yaw rate", "x", "y"];

/// One sentence of the answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Sentence {
    /// What it is about.
    pub about: &'static str,
    /// The sentence.
    pub text: String,
}

/// A value with which the decision would have been another one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alternative {
    /// What is changed: `controller.clearance_m`, `earlier_s` or `later_s`.
    pub by: &'static str,
    /// The value nearest to the recorded one that was found.
    pub value: f64,
    /// Whether the robot drives with it.
    pub drives: bool,
}

/// The answer for one scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Why {
    /// The scan.
    pub scan: u64,
    /// The scan in which the stop was decided that holds in this one; else the scan itself.
    pub decided_at: u64,
    /// Whether the wheels might turn.
    pub drives: bool,
    /// Why they were blocked: names of a `BlockReason` and a `StopReason`.
    pub reason: [&'static str; 2],
    /// The sentences in their order.
    pub sentences: Vec<Sentence>,
    /// What would have changed the decision; empty where nothing is found or known.
    pub alternatives: Vec<Alternative>,
}

/// The samples of a scan that count.
struct Seen<'d> {
    scan: &'d Scan,
    pose: Option<&'d Pose>,
    obstacles: Option<&'d Obstacles>,
    command: Option<&'d Command>,
    actuation: Option<&'d Actuation>,
}

impl<'d> Seen<'d> {
    fn of(drive: &'d ReplayDrive, scan_id: u64) -> Option<Self> {
        Some(Self {
            scan: drive.counted(&drive.scans, scan_id)?,
            pose: drive.counted(&drive.poses, scan_id),
            obstacles: drive.counted(&drive.obstacles, scan_id),
            command: drive.counted(&drive.commands, scan_id),
            actuation: drive.counted(&drive.actuations, scan_id),
        })
    }
}

/// Answers for one scan.
///
/// # Errors
/// A scan that the recording does not have; exit code 2.
pub fn why(drive: &ReplayDrive, scan_id: u64) -> anyhow::Result<Why> {
    let shape = |seen: &Seen<'_>| match shaped_by(drive, seen) {
        Ok(text) => text,
        Err(reason) => Some(format!("not known: {reason}")),
    };
    let Some(mut why) = sentences(drive, scan_id, shape) else {
        return Err(drive.refuse(&format!("scan {scan_id} has no sample that counts")));
    };
    match Decision::of(drive, why.decided_at) {
        Ok(decision) => why.alternatives = changes(&decision),
        Err(reason) => why.add("otherwise", Some(format!("not known: {reason:#}"))),
    }
    let texts: Vec<String> = why.alternatives.iter().map(Alternative::text).collect();
    texts.into_iter().for_each(|text| why.add("otherwise", Some(text)));
    Ok(why)
}

/// What the samples of a scan tell without the controller: not what shaped the plan, and not what would have changed the
/// decision. `None` for a scan that the recording does not have.
pub fn told_by_samples(drive: &ReplayDrive, scan_id: u64) -> Option<Why> {
    sentences(drive, scan_id, |_| None)
}

fn sentences(
    drive: &ReplayDrive,
    scan_id: u64,
    shape: impl FnOnce(&Seen<'_>) -> Option<String>,
) -> Option<Why> {
    let seen = Seen::of(drive, scan_id)?;
    let decided_at = decided_at(drive, scan_id);
    let mut why = Why {
        scan: scan_id,
        decided_at,
        drives: seen.actuation.is_some_and(Actuation::drives),
        reason: reasons(seen.actuation),
        sentences: Vec::new(),
        alternatives: Vec::new(),
    };
    why.add("wheels", wheels(drive, &seen));
    why.add("outcome", outcome(drive, scan_id));
    why.add("rests on", rests_on(drive, &seen));
    why.add("time", timing(drive, &seen));
    if let Some(command) = seen.command {
        why.add("decision", decision(command));
        why.add("stop", stop(command, seen.obstacles, decided_at, scan_id));
    }
    why.add("limit", stopped::limit(drive, &seen, decided_at));
    if let Some(command) = seen.command {
        why.add("speed", speed(command));
        why.add("margin", margin(command));
        why.add("sides", sides(drive, command).filter(|_| why.drives));
    }
    why.add("shaped by", shape(&seen));
    why.add("estimate", seen.pose.and_then(estimate));
    why.add("scanner", seen.obstacles.and_then(scanner));
    for role in Role::ALL {
        why.add("processes", process(drive, *role, scan_id));
    }
    for line in logged(drive, &seen) {
        why.add("log", Some(line));
    }
    Some(why)
}

/// One screen.
impl std::fmt::Display for Why {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(formatter, "scan {}", self.scan)?;
        let mut before = "";
        self.sentences.iter().try_for_each(|Sentence { about, text }| {
            let shown = if std::mem::replace(&mut before, about) == *about { "" } else { about };
            writeln!(formatter, "{shown:<10} {text}")
        })
    }
}

impl Why {
    fn add(&mut self, about: &'static str, text: Option<String>) {
        self.sentences.extend(text.map(|text| Sentence { about, text }));
    }
}

impl Alternative {
    fn text(&self) -> String {
        let does = if self.drives { "it would have driven on" } else { "it would have stopped" };
        let value = self.value;
        match self.by {
            "earlier_s" => format!("{:.0} ms earlier on its way {does}", 1e3 * value),
            "later_s" => format!("{:.0} ms later on its way {does}", 1e3 * value),
            key => format!("with {key}={value:.3} {does}"),
        }
    }
}

/// The first scan of a stop of the controller for one reason.
pub(crate) fn decided_at(drive: &ReplayDrive, scan_id: u64) -> u64 {
    let stopped = |scan| {
        let command: &Command = drive.counted(&drive.commands, scan)?;
        (command.kind == CommandKind::Stop.wire()).then_some(command.reason)
    };
    let Some(reason) = stopped(scan_id) else { return scan_id };
    let before = drive.commands.scans_down_from(scan_id);
    before.take_while(|scan| stopped(*scan) == Some(reason)).last().unwrap_or(scan_id)
}

fn reasons(actuation: Option<&Actuation>) -> [&'static str; 2] {
    let Some(actuation) = actuation else { return ["no_command", "none"] };
    [
        BlockReason::try_from(actuation.reason).map_or("unknown", BlockReason::name),
        StopReason::try_from(actuation.stop_reason).map_or("unknown", StopReason::name),
    ]
}

fn wheels(drive: &ReplayDrive, seen: &Seen<'_>) -> Option<String> {
    let Some(actuation) = seen.actuation else {
        let newest = newest_in_period(drive, seen.scan);
        let does = newest.and_then(|newest| wheels(drive, &Seen { actuation: Some(newest), ..*seen }));
        let does = does.unwrap_or_else(|| "nothing was sent yet".to_owned());
        return Some(format!("this scan was not answered; at the end of its period {does}"));
    };
    let Actuation {
        desired_velocity_mps, desired_steering_rad, sent_velocity_mps, sent_steering_rad, ..
    } = actuation;
    if actuation.drives() {
        return Some(format!(
            "driven with {desired_velocity_mps:.3} m/s and {desired_steering_rad:.4} rad, sent as \
             {sent_velocity_mps:.3} m/s and {sent_steering_rad:.4} rad"
        ));
    }
    let limit_ms = 1.5e-6 * drive.period_ns as f64;
    Some(match reasons(Some(actuation)) {
        ["no_command", _] => format!("blocked: no valid command for {limit_ms:.0} ms, 1.5 scan periods"),
        [reason, stop] if stop == "none" || stop == reason => format!("blocked: {reason}"),
        [reason, stop] => format!("blocked: {reason}, because of {stop}"),
    })
}

/// What was sent last in the period of a scan.
fn newest_in_period<'d>(drive: &'d ReplayDrive, scan: &Scan) -> Option<&'d Actuation> {
    let published_ns = |sent: &Actuation| sent.header.stage(Role::Actuator).published_ns;
    let end_ns = scan.header.stage(Role::Robot).published_ns + drive.period_ns;
    let counted = drive.actuations.samples.iter().filter(|sent| drive.counts(Role::Actuator, &sent.header));
    counted.filter(|sent| published_ns(sent) <= end_ns).max_by_key(|sent| published_ns(sent))
}

/// The samples on the way to the wheels, with their processes and ages.
fn rests_on(drive: &ReplayDrive, seen: &Seen<'_>) -> Option<String> {
    let newest = seen.actuation.map(|sample| &sample.header);
    let newest = newest.or(seen.command.map(|sample| &sample.header)).unwrap_or(&seen.scan.header);
    let ms = |at_ns: u64| (at_ns as f64 - newest.acquired_ns as f64) * 1e-6;
    let stages = Role::ALL.iter().filter(|role| newest.stage(**role).published_ns > 0);
    let steps: Vec<String> = stages
        .map(|role| {
            let stage = newest.stage(*role);
            format!("{role} {:.2} ms", ms(stage.published_ns))
        })
        .collect();
    Some(match drive.simulated {
        true => format!(
            "scan {}, {:.2} ms after its front beam; in simulated time stages take none",
            newest.scan_id,
            ms(newest.stage(Role::Robot).published_ns)
        ),
        false => format!("scan {}, published after its front beam by {}", newest.scan_id, steps.join(", ")),
    })
}

/// How the drive ended, if it had until this scan.
fn outcome(drive: &ReplayDrive, scan_id: u64) -> Option<String> {
    let scenario = drive.scenario().ok()?;
    let mut truths = drive.truths(scan_id).peekable();
    // Of a long drive only the last seconds are read: which of several goals it was about is not known then.
    let is_whole = truths.peek().is_some_and(|(first, _)| first.header.scan_id == 1);
    if scenario.goal.all().len() > 1 && !is_whole {
        return None;
    }
    let mut referee = Referee::new(&scenario);
    truths.find_map(|(truth, actuation)| {
        let outcome = referee.observe(truth, actuation)?;
        Some(format!("{outcome} in scan {}: {}", truth.header.scan_id, referee.reason()))
    })
}

fn decision(command: &Command) -> Option<String> {
    let name = |level: u32| Level::try_from(level).map_or("unknown", Level::name);
    let status = SolveStatus::try_from(command.status).map_or("unknown", SolveStatus::name);
    let Command { iterations, kkt_residual, slack, objective, .. } = command;
    let solved = match command.status == SolveStatus::NotSolved.wire() {
        true => "no problem was solved".to_owned(),
        false => format!(
            "{status} after {iterations} iterations, residual {kkt_residual:.1e}, slack {slack:.3}, objective {objective:.3}"
        ),
    };
    Some(format!("rung `{}` of converged, best_iterate, last_plan, stop; {solved}", name(command.level)))
}

fn stop(command: &Command, obstacles: Option<&Obstacles>, decided_at: u64, scan: u64) -> Option<String> {
    if command.kind == CommandKind::Drive.wire() {
        return None;
    }
    let reason = StopReason::try_from(command.reason).map_or("unknown", StopReason::name);
    let number = match (command.stopped_for(), obstacles) {
        (Some(blocking), _) => format!(" by {blocking}"),
        (None, Some(obstacles)) if reason == "scanner" => format!(": {}", obstacles.scanner),
        _ => String::new(),
    };
    let held = if decided_at < scan { format!(", since scan {decided_at}") } else { String::new() };
    Some(format!("{reason}{number}{held}"))
}

fn speed(command: &Command) -> Option<String> {
    let Command { velocity_mps, speed_limit_mps, .. } = command;
    (command.kind == CommandKind::Drive.wire()).then(|| {
        format!("{velocity_mps:.3} m/s; {speed_limit_mps:.3} m/s is the fastest at which it can still stop in time")
    })
}

fn margin(command: &Command) -> Option<String> {
    let shared_types::Margin { base_m, pose_m, latency_m, model_m, perception_m } = command.margin;
    (command.margin.sum() > 0.0).then(|| {
        format!(
            "{:.3} m = base {base_m:.3} + pose {pose_m:.3} + latency {latency_m:.3} + model {model_m:.3} + perception {perception_m:.3}",
            command.margin.sum()
        )
    })
}

/// On which side the nearest obstacle is passed, and how both sides of an obstacle scored when they were compared last.
fn sides(drive: &ReplayDrive, command: &Command) -> Option<String> {
    let side = match command.side {
        1 => "left",
        -1 => "right",
        _ => return None,
    };
    let cost = |value: f64| if value < 0.0 { "no plan".to_owned() } else { format!("{value:.3}") };
    let scans = drive.commands.scans_down_from(command.header.scan_id);
    let compared = scans
        .filter_map(|scan| Some((scan, drive.counted(&drive.commands, scan)?.sides)))
        .find(|(_, sides)| sides.id > 0);
    let compared = compared.map(|(scan, shared_types::Sides { left_objective, right_objective, id, .. })| {
        let (left, right) = (cost(left_objective), cost(right_objective));
        format!("obstacle {id} costs {left} on its left and {right} on its right, compared in scan {scan}")
    });
    let compared = compared.unwrap_or_else(|| "no plan was solved for the other side".to_owned());
    Some(format!("the nearest obstacle is passed on its {side}; {compared}"))
}

/// The limits that shaped the plan, which the controller computes again.
fn shaped_by(drive: &ReplayDrive, seen: &Seen<'_>) -> anyhow::Result<Option<String>> {
    let Some(command) = seen.command else { return Ok(None) };
    if command.status == SolveStatus::NotSolved.wire() {
        return Ok(None);
    }
    let (incarnation, scan_id) = (command.header.incarnation, command.header.scan_id);
    let led = lead::<ControllerStage>((incarnation, &drive.commands), drive, None, scan_id + 1)?;
    let limits = led.stage.controller().shaping();
    let list = seen.obstacles.map(Obstacles::list).unwrap_or_default();
    let texts = limits.iter().take(3).map(|shaping| {
        let what = match shaping.by {
            ShapedBy::Bound(component) => format!("the bound of {}", COMPONENTS[component.min(4)]),
            ShapedBy::Obstacle(id) => match list.iter().find(|obstacle| obstacle.id == id) {
                Some(body) => format!("ellipse {id} at ({:.2}, {:.2})", body.x_m, body.y_m),
                None => format!("ellipse {id}"),
            },
        };
        format!("{what} after {:.2} s, multiplier {:.3}", shaping.after_s, shaping.multiplier)
    });
    let texts: Vec<String> = texts.collect();
    Ok(Some(if texts.is_empty() { "no limit: the reference alone".to_owned() } else { texts.join("; ") }))
}

fn estimate(pose: &Pose) -> Option<String> {
    let suspect = Suspect::try_from(pose.suspect).map_or("unknown", Suspect::name);
    let alarm = Alarm::try_from(pose.alarm).map_or("unknown", Alarm::name);
    (pose.suspect != Suspect::None.wire())
        .then(|| format!("the estimator suspects {suspect}, and asks for: {alarm}; NIS {:.1}", pose.nis))
}

fn scanner(obstacles: &Obstacles) -> Option<String> {
    (obstacles.scanner.state() != ScannerState::Healthy).then(|| obstacles.scanner.to_string())
}
