//! Which scans of a drive are worth a question: stops, slow ones, late and lost ones.

use std::cmp::Ordering;

use serde::Serialize;
use shared_types::{Actuation, Header, Role};

use super::{Seen, newest_in_period, reasons, stop};
use crate::ReplayDrive;

/// So many slow scans are listed.
const SLOWEST: usize = 10;

/// One scan of an overview.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The scan.
    pub scan: u64,
    /// How many scans a stop lasted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lasted_scans: Option<u64>,
    /// How long the answer took from the end of the sweep [ms]; nothing where there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub took_ms: Option<f64>,
    /// What happened.
    pub text: String,
}

impl Row {
    /// Its amount with the unit.
    pub fn amount(&self) -> String {
        match (self.lasted_scans, self.took_ms) {
            (Some(scans), _) => format!("{scans} scans"),
            (None, Some(ms)) => format!("{ms:.2} ms"),
            (None, None) => "-".to_owned(),
        }
    }

    fn timed(scan: u64, took_ms: Option<f64>, text: String) -> Self {
        Self { scan, lasted_scans: None, took_ms, text }
    }
}

/// The stops of a drive: the first scan of each with blocked wheels, how many followed, and the reason.
pub fn stops(drive: &ReplayDrive) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    let mut last = None::<(u64, [&str; 2])>;
    for scan in drive.scans.scans().filter(|scan| *scan <= drive.last_scan()) {
        let Some(seen) = Seen::of(drive, scan) else { continue };
        let sent = seen.actuation.or_else(|| newest_in_period(drive, seen.scan));
        let Some(actuation) = sent.filter(|sent| !sent.drives()) else {
            last = None;
            continue;
        };
        let reason = reasons(Some(actuation));
        match (rows.last_mut(), last) {
            (Some(row), Some((before, same))) if before + 1 == scan && same == reason => {
                row.lasted_scans = Some(scan + 1 - row.scan);
            }
            _ => {
                let cause = seen.command.and_then(|command| stop(command, seen.obstacles, scan, scan));
                let text = match cause {
                    Some(cause) if reason[0] == "commanded" => cause,
                    _ => reason[0].to_owned(),
                };
                rows.push(Row { scan, lasted_scans: Some(1), took_ms: None, text });
            }
        }
        last = Some((scan, reason));
    }
    rows
}

/// The scans that took longest from the end of the sweep to the actuation, and the stage that took most of it.
pub fn slow(drive: &ReplayDrive) -> Vec<Row> {
    let answered = drive.scans.scans().filter_map(|scan| drive.counted(&drive.actuations, scan));
    let mut rows: Vec<Row> = answered.filter_map(|actuation| took(&actuation.header)).collect();
    rows.sort_by(|one, other| other.took_ms.partial_cmp(&one.took_ms).unwrap_or(Ordering::Equal));
    rows.truncate(SLOWEST);
    rows
}

/// How long the answer of a scan took, and how long half of them took at most.
pub(super) fn timing(drive: &ReplayDrive, seen: &Seen<'_>) -> Option<String> {
    let Row { took_ms, text, .. } = took(&seen.actuation?.header).filter(|_| !drive.simulated)?;
    // Of the scans until then, so that the answer stays the same while the drive continues.
    let until = drive.scans.scans().take_while(|scan| *scan <= seen.scan.header.scan_id);
    let all = until.filter_map(|scan| took(&drive.counted(&drive.actuations, scan)?.header)?.took_ms);
    let mut all: Vec<f64> = all.collect();
    all.sort_by(f64::total_cmp);
    Some(format!(
        "{:.2} ms from the end of the sweep, usually {:.2} ms; {text}",
        took_ms?,
        all.get(all.len() / 2)?
    ))
}

fn took(header: &Header) -> Option<Row> {
    let published = |role: Role| header.stage(role).published_ns;
    let ms = |from: u64, to: u64| to.saturating_sub(from) as f64 * 1e-6;
    let begun_ns = published(Role::Robot);
    // Each stage begins when the one before has published what it waits for.
    let order = [Role::Robot, Role::Estimator, Role::Obstacles, Role::Controller, Role::Actuator];
    let parts = order.windows(2).map(|pair| (pair[1], ms(published(pair[0]), published(pair[1]))));
    let (most, part) = parts.max_by(|one, other| one.1.total_cmp(&other.1))?;
    let computed = ms(header.stage(most).taken_ns, header.stage(most).computed_ns);
    let amount = ms(begun_ns, published(Role::Actuator));
    let text = format!("{most} took {part:.3} ms of it, {computed:.3} ms of that computing");
    Some(Row::timed(header.scan_id, Some(amount), text))
}

/// The scans that were answered after the next one was published, or never, with the last stage that answered.
pub fn late(drive: &ReplayDrive) -> Vec<Row> {
    let mut rows = Vec::new();
    for scan in drive.scans.scans().filter(|scan| *scan < drive.last_scan()) {
        let Some(seen) = Seen::of(drive, scan) else { continue };
        let next =
            drive.counted(&drive.scans, scan + 1).map(|next| next.header.stage(Role::Robot).published_ns);
        let (published_ns, begun_ns) = (
            |sent: &Actuation| sent.header.stage(Role::Actuator).published_ns,
            seen.scan.header.stage(Role::Robot).published_ns,
        );
        match seen.actuation.map(published_ns) {
            None => rows.push(Row::timed(scan, None, format!("never answered: {}", ends_at(&seen)))),
            Some(at_ns) if next.is_some_and(|next_ns| at_ns > next_ns) => {
                let amount = at_ns.saturating_sub(begun_ns) as f64 * 1e-6;
                let text = seen.actuation.and_then(|sent| took(&sent.header)).map(|row| row.text);
                rows.push(Row::timed(scan, Some(amount), text.unwrap_or_default()));
            }
            Some(_) => {}
        }
    }
    rows
}

/// Where the way of a scan ends.
fn ends_at(seen: &Seen<'_>) -> String {
    let outputs = [
        (Role::Estimator, seen.pose.is_some()),
        (Role::Obstacles, seen.obstacles.is_some()),
        (Role::Controller, seen.command.is_some()),
    ];
    let missing =
        outputs.into_iter().find(|(_, is_there)| !is_there).map_or(Role::Actuator, |(role, _)| role);
    format!("the {missing} gave no output that counts")
}
