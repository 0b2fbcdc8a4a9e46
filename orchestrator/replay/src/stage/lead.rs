//! Leads one process by its journals to the beginning of a scan.

use serde::de::DeserializeOwned;
use shared_types::{JournalEntry, JournalKind, Sample, TOPICS, Topic};

use super::journal::{NO_JOURNAL, Recomputed, Replayed};
use crate::ReplayDrive;
use crate::compare::{FieldDifference, difference_to};
use crate::drive::{DriveSettings, Lane};

/// A process that has used nothing of a scan yet.
pub(crate) struct Led<T> {
    pub(crate) stage: T,
    /// Incarnation and number of the actuation that it has used last.
    pub(crate) actuation: Option<(u32, u64)>,
    /// The scan.
    pub(crate) scan: u64,
    /// How its output for this scan differs from the recorded one, where settings are changed.
    pub(crate) parts: Option<FieldDifference>,
}

/// Leads the process `incarnation` to the scan `to`. With settings that hold from a scan on it is led no further than to
/// the first scan whose output is another with them.
///
/// # Errors
/// Why its state there is not known, or can't be continued from with these settings.
pub(crate) fn lead<T: Recomputed>(
    (incarnation, lane): (u32, &Lane<T::Output>),
    drive: &ReplayDrive,
    changed: Option<(&DriveSettings, u64)>,
    to: u64,
) -> anyhow::Result<Led<T>>
where
    T::Settings: DeserializeOwned,
{
    let refuse = |reason: &str| drive.refuse(&format!("{}: {reason}", T::ROLE));
    if let Some(program) = drive.foreign(incarnation) {
        return Err(refuse(&format!("it was `{program}`, whose state this program can't compute again")));
    }
    if drive.journals(incarnation).next().is_none() {
        return Err(refuse(NO_JOURNAL));
    }
    let first = changed.map_or(to, |(_, at)| at.min(to));
    // What has no inputs changes at once after its output before, and a checkpoint lacks what its own scan was decided by: it
    // begins a scan earlier.
    let is_source = T::ANSWERS.is_empty();
    let mut process = Replayed::<T>::begin(incarnation, drive, Some(first.saturating_sub(1)))?;
    let mut is_changed = false;
    let mut change = |process: &mut Replayed<'_, T>, scan: u64| -> anyhow::Result<()> {
        let Some((settings, _)) = changed.filter(|(_, at)| scan >= *at && !is_changed) else { return Ok(()) };
        let other = settings.of_process(incarnation, T::ROLE)?;
        let other = process.stage.with_settings(other, drive.period_ns, scan);
        process.stage = other.map_err(|reason| refuse(&format!("scan {scan}: {reason}")))?;
        is_changed = true;
        Ok(())
    };
    let led = |process: &Replayed<'_, T>, scan| Led {
        stage: process.stage.clone(),
        actuation: process.actuation,
        scan,
        parts: None,
    };
    let (mut begun, mut before) = (0, None::<Led<T>>);
    for (place, (journal, follows)) in drive.numbered_journals(incarnation).enumerate() {
        process.come_to(place, follows);
        let entries = journal.used().iter().map(Some);
        // What has no inputs begins a scan with its output.
        for entry in entries.chain([None]) {
            let scan = match entry {
                Some(entry) => answered::<T>(drive, entry),
                None => (journal.output > 0 && is_source).then_some(journal.header.scan_id),
            };
            if let Some(scan) = scan.filter(|scan| *scan > begun) {
                begun = scan;
                if let Some(reason) = process.unknown.filter(|_| scan >= first) {
                    return Err(refuse(reason));
                }
                if changed.is_some_and(|(_, at)| scan >= at) {
                    change(&mut process, scan)?;
                    before = Some(led(&process, scan));
                }
                if scan >= to {
                    return Ok(led(&process, to));
                }
            }
            entry.into_iter().for_each(|entry| process.follow(entry));
        }
        if journal.output == 0 {
            continue;
        }
        let was_known = process.unknown.is_none();
        let output = process.output(journal.header.scan_id);
        process.unknown = output.as_ref().err().copied();
        let recorded = lane.of_number(incarnation, journal.output);
        if let (Some(before), Some(recorded)) = (before.as_mut().filter(|_| was_known), recorded)
            && drive.counts(T::ROLE, recorded.header())
            && !drive.is_injected(T::Output::TOPIC, recorded.header())
        {
            before.parts = match output {
                Ok(output) => difference_to(recorded, output, T::ROLE),
                Err(_) => Some(FieldDifference::missing(recorded)),
            };
            if before.parts.is_some() {
                break;
            }
        }
        if is_source && process.unknown.is_none() && journal.header.scan_id < to {
            change(&mut process, journal.header.scan_id + 1)?;
        }
    }
    match before {
        Some(before) if before.parts.is_some() || changed.is_some() && to == u64::MAX => Ok(before),
        // It ended before; what it was then is the newest that is known.
        _ => match process.unknown {
            Some(reason) => Err(refuse(reason)),
            None => Ok(led(&process, to)),
        },
    }
}

/// The scan of a sample that is answered, if an entry states that it was taken.
fn answered<T: Recomputed>(drive: &ReplayDrive, entry: &JournalEntry) -> Option<u64> {
    let topic = *TOPICS.get(usize::from(entry.topic))?;
    let is_taken = entry.kind == JournalKind::Taken.wire() as u16;
    if !is_taken || !T::ANSWERS.iter().any(|of| of.topic == topic) {
        return None;
    }
    let number = (entry.incarnation, entry.value);
    match topic {
        Topic::Scan => drive.scans.scan_of(number),
        Topic::Odometry => drive.odometries.scan_of(number),
        Topic::Pose => drive.poses.scan_of(number),
        Topic::Obstacles => drive.obstacles.scan_of(number),
        Topic::Command => drive.commands.scan_of(number),
        _ => None,
    }
}
