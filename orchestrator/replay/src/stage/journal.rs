//! Replays the processes of a role by their journals: each takes, uses and decides the same in the same order.

use std::collections::BTreeSet;

use bytemuck::Pod;
use shared_types::{Checkpoint, Described, Journal, JournalEntry, JournalKind, Role, Sample};

use super::{Findings, Window};
use crate::drive::Lane;
use crate::{Drive, Options};

/// An output that can't be recomputed.
const NO_STATE: &str = "no state of the process was recorded";
const LOST: &str = "a journal of the process was not recorded";
const NO_JOURNAL: &str = "no journal of the process was recorded, as before processes published journals";
const NO_INPUT: &str = "an input was not recorded";
/// An injected fault alters the robot: a state is that of another robot.
const ALTERED: &str = "an injected fault altered the robot";
/// The fault is over, but it has changed the state.
const RESTORED: &str = "an injected fault had altered the robot";
const FOREIGN: &str = "not_compared: the process is no implementation of this program";

/// An input that was not recorded.
pub(super) struct Missing;

/// The algorithm of one role, as its process calls it.
pub(super) trait Stage<'d>: Sized {
    /// The first output of the role.
    type Output: Sample;
    /// What its checkpoints hold.
    type State: Pod + Described;
    /// The role.
    const ROLE: Role;

    /// A process that begins without a state.
    fn begin(drive: &'d Drive) -> anyhow::Result<Self>;
    /// Continues from a state; false when it can't be used.
    fn resume(&mut self, state: &Self::State) -> bool;
    /// Remembers a sample that the process has taken.
    fn take(&mut self, entry: &JournalEntry, drive: &'d Drive);
    /// Does what the process did: any kind of entry but those about samples and checkpoints.
    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing>;
    /// The output for a scan.
    fn output(&mut self, scan_id: u64) -> Result<Self::Output, Missing>;
    /// Compares what else the process has published for the scan of `recorded`.
    fn compare_others(
        &mut self,
        _recorded: &Self::Output,
        _drive: &Drive,
        _options: &Options,
        _findings: &mut Findings,
    ) {
    }
}

/// Replays all processes of a role.
pub(super) fn replay<'d, T: Stage<'d>>(
    lane: &'d Lane<T::Output>,
    drive: &'d Drive,
    options: &Options,
    findings: &mut Findings,
) -> anyhow::Result<()> {
    let processes: BTreeSet<u32> = lane.samples.iter().map(|sample| sample.header().incarnation).collect();
    let window = Window::of(drive, options);
    for incarnation in processes {
        let mut skipped = Skipped::default();
        if drive.foreign(incarnation).is_some() {
            skipped.reason = FOREIGN;
        } else if drive.journals(incarnation).next().is_none() {
            skipped.reason = NO_JOURNAL;
        } else {
            replay_process::<T>((incarnation, lane), drive, options, &window, findings, &mut skipped)?;
        }
        if [FOREIGN, NO_JOURNAL].contains(&skipped.reason) {
            findings.leave_out(incarnation, drive);
        }
        // Also those of which no journal tells.
        for output in lane.of_process(incarnation) {
            let header = output.header();
            if skipped.settled.contains(&header.sequence) || !window.holds(header, findings) {
                continue;
            }
            match drive.is_injected(T::Output::TOPIC, header) {
                true => findings.injected(),
                false => findings.skip(output, skipped.reason),
            }
        }
    }
    Ok(())
}

/// Which outputs were compared, counted or left out, and why the others are skipped.
struct Skipped {
    settled: BTreeSet<u64>,
    reason: &'static str,
}

impl Default for Skipped {
    fn default() -> Self {
        Self { settled: BTreeSet::new(), reason: LOST }
    }
}

/// Replays one process from its start, or from the first recorded state behind each gap.
fn replay_process<'d, T: Stage<'d>>(
    (incarnation, lane): (u32, &'d Lane<T::Output>),
    drive: &'d Drive,
    options: &Options,
    window: &Window,
    findings: &mut Findings,
    skipped: &mut Skipped,
) -> anyhow::Result<()> {
    let nearest = nearest_state(incarnation, drive, options);
    let mut stage = T::begin(drive)?;
    let mut unknown = nearest.map(|_| NO_STATE);
    let mut next = 1;
    for journal in drive.journals(incarnation) {
        if journal.header.sequence != next {
            unknown = Some(if next == 1 { NO_STATE } else { LOST });
        }
        next = journal.header.sequence + 1;
        for entry in journal.used() {
            follow(&mut stage, entry, incarnation, nearest, drive, &mut unknown);
        }
        if journal.output == 0 {
            continue;
        }
        if journal.header.scan_id > window.to {
            skipped.settled.extend(lane.of_process(incarnation).map(|output| output.header().sequence));
            return Ok(());
        }
        let recorded = lane.of_number(incarnation, journal.output);
        compare(&mut stage, journal, recorded, &mut unknown, (drive, options, window), findings);
        skipped.settled.insert(journal.output);
    }
    Ok(())
}

/// Does what one entry states; `unknown` is why the state of the stage is not that of the process.
fn follow<'d, T: Stage<'d>>(
    stage: &mut T,
    entry: &JournalEntry,
    incarnation: u32,
    nearest: Option<u64>,
    drive: &'d Drive,
    unknown: &mut Option<&'static str>,
) {
    let resume = |stage: &mut T, incarnation: u32| {
        let state = drive.checkpoints.of_number(incarnation, entry.value).map(Checkpoint::state::<T::State>);
        matches!(state, Some(Ok(state)) if stage.resume(&state))
    };
    match JournalKind::try_from(u32::from(entry.kind)) {
        Ok(JournalKind::Taken) => stage.take(entry, drive),
        Ok(JournalKind::Resumed) => {
            *unknown = if resume(stage, entry.incarnation) { None } else { Some(NO_STATE) };
        }
        Ok(JournalKind::Saved) => {
            let is_wanted = nearest.is_none_or(|nearest| entry.value >= nearest);
            let is_unknown = unknown.is_some_and(|reason| reason != ALTERED);
            if is_unknown && is_wanted && resume(stage, incarnation) {
                *unknown = None;
            }
        }
        Ok(JournalKind::Altered) => *unknown = Some(if entry.value == 1 { ALTERED } else { RESTORED }),
        Ok(kind) if unknown.is_none() => {
            *unknown = stage.follow(kind, entry.value).err().map(|Missing| NO_INPUT);
        }
        _ => {}
    }
}

/// Compares the output that follows a journal.
fn compare<'d, T: Stage<'d>>(
    stage: &mut T,
    journal: &Journal,
    recorded: Option<&T::Output>,
    unknown: &mut Option<&'static str>,
    (drive, options, window): (&Drive, &Options, &Window),
    findings: &mut Findings,
) {
    let output = match *unknown {
        Some(reason) => Err(reason),
        None => stage.output(journal.header.scan_id).map_err(|Missing| NO_INPUT),
    };
    *unknown = output.as_ref().err().copied();
    // One that was not recorded may have been removed by an injected fault.
    let Some(recorded) = recorded.filter(|recorded| window.holds(recorded.header(), findings)) else {
        return;
    };
    match output {
        Ok(output) => {
            findings.compare(recorded, output, T::ROLE, drive, options);
            stage.compare_others(recorded, drive, options, findings);
        }
        Err(ALTERED | RESTORED) => findings.injected(),
        Err(reason) => findings.skip(recorded, reason),
    }
}

/// The newest recorded state of the process before its first output that is asked for, by number.
///
/// The scan of a state does not tell: an estimator that got an actuation late has saved a state of an earlier scan after
/// its pose.
fn nearest_state(incarnation: u32, drive: &Drive, options: &Options) -> Option<u64> {
    let (from, mut nearest) = (options.from?, None);
    for journal in drive.journals(incarnation) {
        let saved = journal.used().iter().filter(|entry| entry.kind == JournalKind::Saved.wire() as u16);
        let is_recorded = |number: &u64| drive.checkpoints.of_number(incarnation, *number).is_some();
        nearest = saved.map(|entry| entry.value).rfind(is_recorded).or(nearest);
        if journal.output > 0 && journal.header.scan_id >= from {
            break;
        }
    }
    nearest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::tests::{ESTIMATOR, late_actuation};

    #[test]
    fn a_replay_begins_with_the_newest_state_before_its_first_output() {
        let drive = late_actuation();
        let nearest = |from| nearest_state(ESTIMATOR, &drive, &Options { from, ..Options::default() });
        // State 3 is of scan 1 too, but holds the pose of scan 2.
        let found = [None, Some(1), Some(2), Some(3), Some(4)].map(nearest);
        assert_eq!(found, [None, None, Some(1), Some(3), Some(4)]);
    }
}
