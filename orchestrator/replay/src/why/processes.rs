//! What is unusual about the processes of a scan, and what was logged meanwhile.

use shared_types::{ROLES, Role, Sample};

use super::Seen;
use crate::ReplayDrive;
use crate::drive::Lane;

/// A process counts as new for so many scans.
pub(crate) const NEW_SCANS: u64 = 10;
/// So many lines of logs are quoted at most.
const MAX_LINES: usize = 4;
/// A change of processes is logged within this time [ns].
const LOGGED_NS: u64 = 500_000_000;

/// What is unusual about the process of a role: new, late, or altered by an injected fault.
pub(super) fn process(drive: &ReplayDrive, role: Role, scan: u64) -> Option<String> {
    match role {
        Role::Robot => unusual(drive, &drive.scans, scan),
        Role::Estimator => unusual(drive, &drive.poses, scan),
        Role::Obstacles => unusual(drive, &drive.obstacles, scan),
        Role::Controller => unusual(drive, &drive.commands, scan),
        Role::Actuator => unusual(drive, &drive.actuations, scan),
    }
}

fn unusual<S: Sample>(drive: &ReplayDrive, lane: &Lane<S>, scan: u64) -> Option<String> {
    let role = S::TOPIC.writer()?;
    let number = |scan| drive.counted(lane, scan).map(|output| output.header().incarnation);
    let lately = lane.scans_down_from(scan.saturating_sub(1)).take(NEW_SCANS as usize);
    let earlier = lately.filter_map(|before| Some((before, number(before)?)));
    let Some(output) = drive.counted(lane, scan) else {
        let later = (scan + 1..=scan + NEW_SCANS).find_map(|after| Some((after, number(after)?)));
        let change = earlier.take(1).find_map(|before| Some(changed(drive, role, before, later?)));
        let change = change.flatten().map_or_else(String::new, |change| format!("; {change}"));
        return Some(format!("{role}: it gave no output that counts{change}"));
    };
    let header = output.header();
    let mut found = Vec::new();
    let other = earlier.collect::<Vec<_>>().into_iter().find(|(_, process)| *process != header.incarnation);
    let first =
        lane.scans_down_from(scan).take_while(|at| number(*at).is_none_or(|of| of == header.incarnation));
    let first = first.filter(|at| number(*at).is_some()).last().unwrap_or(scan);
    found.extend(other.and_then(|before| changed(drive, role, before, (first, header.incarnation))));
    let stamps = header.chain[..ROLES].iter().map(|stage| stage.published_ns).filter(|at| *at > 0);
    let since_ns = header.stage(role).published_ns.saturating_sub(header.acquired_ns);
    if role != Role::Robot && since_ns > drive.period_ns + drive.period_ns / 2 && stamps.count() > 1 {
        found.push(format!("late: {:.1} ms after the front beam", since_ns as f64 * 1e-6));
    }
    if drive.is_injected(S::TOPIC, header) {
        found
            .push(format!("an injected fault{} has changed its output", injected(drive, header.acquired_ns)));
    }
    if let Some(since) = drive.altered_since(scan).filter(|_| role == Role::Robot) {
        found.push(format!(
            "an injected fault{} alters it since scan {since}",
            injected(drive, header.acquired_ns)
        ));
    }
    if let Some(program) = drive.foreign(header.incarnation) {
        found.push(format!("it is `{}`", runtime::one_line(program)));
    }
    (!found.is_empty()).then(|| format!("{role}: {}", found.join("; ")))
}

/// How the process of a role became another one, between the last output of the one and the first of the other.
fn changed(
    drive: &ReplayDrive,
    role: Role,
    (last, old): (u64, u32),
    (first, new): (u64, u32),
) -> Option<String> {
    if old == new {
        return None;
    }
    let handed_over = drive.was_handed_over(role, old, new);
    // Numbers ascend: what comes back was there before.
    Some(match (handed_over, new < old) {
        (true, true) => format!(
            "rollback: process {old} was in charge until scan {last}, from scan {first} on {new} again"
        ),
        (true, false) => format!("swap: process {new} has taken over from {old} at scan {first}"),
        (false, _) => format!(
            "restart: process {old} ended or hung after scan {last}, process {new} gives outputs from scan {first} on"
        ),
    })
}

/// The name of the fault that was injected last before a scan ended, where it was logged.
fn injected(drive: &ReplayDrive, acquired_ns: u64) -> String {
    let until_ns = acquired_ns + drive.period_ns;
    let lines =
        drive.lines.iter().rev().filter(|line| line.log_ns <= until_ns && line.name == "orchestrator");
    let named =
        lines.filter_map(|line| line.text.split_once("fault injected for ")?.1.split(": ").nth(1)).next();
    named.map_or_else(String::new, |name| format!(", `{name}`,"))
}

/// What the orchestrator has logged around a scan, and what all processes have warned of in it.
pub(super) fn logged(drive: &ReplayDrive, seen: &Seen<'_>) -> Vec<String> {
    let from_ns = seen.scan.header.acquired_ns.saturating_sub(drive.period_ns);
    let to_ns = seen.scan.header.stage(Role::Robot).published_ns + drive.period_ns;
    let is_of_it = |at_ns: u64, by: &str, is_warning: bool| match by {
        "orchestrator" => (from_ns..=to_ns.saturating_add(LOGGED_NS)).contains(&at_ns),
        _ => is_warning && (from_ns..=to_ns).contains(&at_ns),
    };
    // At the end of a run all processes end, which explains nothing.
    let told = drive.lines.iter().filter(|line| !line.text.ends_with("ended: exit code 0"));
    let lines = told.filter(|line| is_of_it(line.log_ns, &line.name, line.is_warning));
    lines
        .take(MAX_LINES)
        .map(|line| format!("{}: {}", runtime::one_line(&line.name), runtime::one_line(line.text.trim())))
        .collect()
}
