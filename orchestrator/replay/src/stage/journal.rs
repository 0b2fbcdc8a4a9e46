//! Replays the processes of a role by their journals: each takes, uses and decides the same in the same order.
//!
//! A process on another host is replayed on the clock of its host: what it took is mapped there, and what it published is
//! mapped back, by the offset that its host has used for each scan.

use std::collections::BTreeSet;

use bytemuck::Pod;
use shared_types::{Checkpoint, Described, Journal, JournalEntry, JournalKind, Role, Sample, shift_state};

use super::{Findings, Window};
use crate::drive::{Lane, moved};
use crate::{ReplayDrive, ReplayOptions};

/// An output that can't be recomputed.
const NO_STATE: &str = "no state of the process was recorded";
const LOST: &str = "a journal of the process was not recorded";
const NO_JOURNAL: &str = "no journal of the process was recorded, as before processes published journals";
/// An injected fault alters the robot: a state is that of another robot.
const ALTERED: &str = "an injected fault altered the robot";
/// The fault is over, but it has changed the state.
const RESTORED: &str = "an injected fault had altered the robot";
const FOREIGN: &str = "not_compared: the process is no implementation of this program";

/// What was not recorded although a process had it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Missing {
    /// A sample.
    Input,
    /// The clock of its host in the scan of a sample.
    Clock,
}

impl Missing {
    fn reason(self) -> &'static str {
        match self {
            Self::Input => "an input was not recorded",
            Self::Clock => "the clock of the host of the process was not recorded",
        }
    }
}

/// How a process has taken samples.
pub(super) struct Taking<'d> {
    /// The samples.
    pub(super) drive: &'d ReplayDrive,
    incarnation: u32,
    /// The next one was handed over, with its times moved by this [ns].
    moved_ns: Option<i64>,
}

impl Taking<'_> {
    /// A sample as the process had it.
    pub(super) fn sample<S: Sample>(&self, lane: &Lane<S>, entry: &JournalEntry) -> Result<S, Missing> {
        let recorded = lane.of_number(entry.incarnation, entry.value).ok_or(Missing::Input)?;
        match self.moved_ns {
            Some(by_ns) => Ok(moved(recorded, by_ns)),
            None => self.drive.clocks.to_local(self.incarnation, recorded).ok_or(Missing::Clock),
        }
    }
}

/// The algorithm of one role, as its process calls it.
pub(super) trait Stage: Sized {
    /// The first output of the role.
    type Output: Sample;
    /// What its checkpoints hold.
    type State: Pod + Described;
    /// The role.
    const ROLE: Role;

    /// A process that begins without a state, with the settings of the recorded one.
    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self>;
    /// Continues from a state; false when it can't be used.
    fn resume(&mut self, state: &Self::State) -> bool;
    /// Remembers a sample that the process has taken.
    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>);
    /// Does what the process did: any kind of entry but those about samples and checkpoints.
    fn follow(&mut self, kind: JournalKind, value: u64) -> Result<(), Missing>;
    /// The output for a scan.
    fn output(&mut self, scan_id: u64) -> Result<Self::Output, Missing>;
    /// Compares what else the process has published for the scan of `recorded`.
    fn compare_others(
        &mut self,
        _recorded: &Self::Output,
        _drive: &ReplayDrive,
        _options: &ReplayOptions,
        _findings: &mut Findings,
    ) {
    }
}

/// Replays all processes of a role.
pub(super) fn replay<T: Stage>(
    lane: &Lane<T::Output>,
    drive: &ReplayDrive,
    options: &ReplayOptions,
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
fn replay_process<T: Stage>(
    (incarnation, lane): (u32, &Lane<T::Output>),
    drive: &ReplayDrive,
    options: &ReplayOptions,
    window: &Window,
    findings: &mut Findings,
    skipped: &mut Skipped,
) -> anyhow::Result<()> {
    let nearest = nearest_state(incarnation, drive, options);
    let taking = Taking { drive, incarnation, moved_ns: None };
    let mut process = Replayed {
        stage: T::begin(drive, incarnation)?,
        taking,
        nearest,
        unknown: nearest.map(|_| NO_STATE),
    };
    let mut next = 1;
    for journal in drive.journals(incarnation) {
        if journal.header.sequence != next {
            process.unknown = Some(if next == 1 { NO_STATE } else { LOST });
        }
        next = journal.header.sequence + 1;
        journal.used().iter().for_each(|entry| process.follow(entry));
        if journal.output == 0 {
            continue;
        }
        if journal.header.scan_id > window.to {
            skipped.settled.extend(lane.of_process(incarnation).map(|output| output.header().sequence));
            return Ok(());
        }
        let recorded = lane.of_number(incarnation, journal.output);
        process.compare(journal, recorded, (options, window), findings);
        skipped.settled.insert(journal.output);
    }
    Ok(())
}

/// A process that is replayed.
struct Replayed<'d, T> {
    stage: T,
    taking: Taking<'d>,
    /// Number of the state that it begins with, if it does not begin with its start.
    nearest: Option<u64>,
    /// Why the state of the stage is not that of the process.
    unknown: Option<&'static str>,
}

impl<T: Stage> Replayed<'_, T> {
    /// Does what one entry states.
    fn follow(&mut self, entry: &JournalEntry) {
        match JournalKind::try_from(u32::from(entry.kind)) {
            Ok(JournalKind::Moved) => self.taking.moved_ns = Some(entry.value.cast_signed()),
            Ok(JournalKind::Taken) => {
                self.stage.take(entry, &self.taking);
                self.taking.moved_ns = None;
            }
            Ok(JournalKind::Resumed) => {
                let moved_ns = self.taking.moved_ns.take().unwrap_or(0);
                let is_known = self.resume(entry.incarnation, entry.value, moved_ns);
                self.unknown = if is_known { None } else { Some(NO_STATE) };
            }
            Ok(JournalKind::Saved) => {
                let is_wanted = self.nearest.is_none_or(|nearest| entry.value >= nearest);
                let incarnation = self.taking.incarnation;
                let is_unknown = self.unknown.is_some_and(|reason| reason != ALTERED);
                if is_unknown && is_wanted && self.resume(incarnation, entry.value, 0) {
                    self.unknown = None;
                }
            }
            Ok(JournalKind::Altered) => {
                self.unknown = Some(if entry.value == 1 { ALTERED } else { RESTORED });
            }
            Ok(kind) if self.unknown.is_none() => {
                self.unknown = self.stage.follow(kind, entry.value).err().map(Missing::reason);
            }
            _ => {}
        }
    }

    /// Continues from the state that a process has saved with this number, with its times moved; false where it was not
    /// recorded.
    fn resume(&mut self, incarnation: u32, sequence: u64, moved_ns: i64) -> bool {
        let saved = self.taking.drive.checkpoints.of_number(incarnation, sequence);
        let Some(Ok(mut state)) = saved.map(Checkpoint::state::<T::State>) else { return false };
        shift_state(&T::State::KIND, bytemuck::bytes_of_mut(&mut state), moved_ns);
        self.stage.resume(&state)
    }

    /// Compares the output that follows a journal.
    fn compare(
        &mut self,
        journal: &Journal,
        recorded: Option<&T::Output>,
        (options, window): (&ReplayOptions, &Window),
        findings: &mut Findings,
    ) {
        let output = match self.unknown {
            Some(reason) => Err(reason),
            None => self.stage.output(journal.header.scan_id).map_err(Missing::reason),
        };
        self.unknown = output.as_ref().err().copied();
        // One that was not recorded may have been removed by an injected fault.
        let Some(recorded) = recorded.filter(|recorded| window.holds(recorded.header(), findings)) else {
            return;
        };
        let Taking { drive, incarnation, .. } = self.taking;
        let output = output
            .and_then(|output| drive.clocks.to_common(incarnation, &output).ok_or(Missing::Clock.reason()));
        match output {
            Ok(output) => {
                findings.compare(recorded, output, T::ROLE, drive, options);
                self.stage.compare_others(recorded, drive, options, findings);
            }
            Err(ALTERED | RESTORED) => findings.injected(),
            Err(reason) => findings.skip(recorded, reason),
        }
    }
}

/// The newest recorded state of the process before its first output that is asked for, by number.
///
/// The scan of a state does not tell: an estimator that got an actuation late has saved a state of an earlier scan after
/// its pose.
fn nearest_state(incarnation: u32, drive: &ReplayDrive, options: &ReplayOptions) -> Option<u64> {
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
    use actuation::ActuatorState;
    use emulator::service::RobotState;
    use estimator::EstimatorState;
    use nmpc::ControllerState;
    use obstacles::ObstaclesState;
    use shared_types::{Field, Kind, is_state_time};

    use super::*;
    use crate::drive::tests::{ESTIMATOR, late_actuation};

    /// Fields of states that end with `_ns` and hold no point in time of a clock: spans, and times since the start of a run.
    const SPANS: [&str; 8] = [
        "usual_age_ns",
        "clock_ns",
        "plant_ns",
        "last_actuation_ns",
        "reported_ns",
        "longest_blind_ns",
        "arrives_ns",
        "sweep_ns",
    ];

    fn names(kind: &Kind, found: &mut Vec<&'static str>) {
        match kind {
            Kind::Scalar(_) => {}
            Kind::Array(element, _) => names(element, found),
            Kind::Struct(_, fields) => fields.iter().for_each(|Field { name, kind, .. }| {
                found.push(name);
                names(kind, found);
            }),
        }
    }

    #[test]
    fn every_field_in_nanoseconds_of_a_state_is_a_point_in_time_or_none() {
        let mut found = Vec::new();
        for kind in [
            &RobotState::KIND,
            &EstimatorState::KIND,
            &ObstaclesState::KIND,
            &ControllerState::KIND,
            &ActuatorState::KIND,
        ] {
            names(kind, &mut found);
        }
        for name in found.iter().filter(|name| name.ends_with("_ns")) {
            assert!(is_state_time(name) != SPANS.contains(name), "{name}");
        }
    }

    #[test]
    fn a_replay_begins_with_the_newest_state_before_its_first_output() {
        let drive = late_actuation();
        let nearest =
            |from| nearest_state(ESTIMATOR, &drive, &ReplayOptions { from, ..ReplayOptions::default() });
        // State 3 is of scan 1 too, but holds the pose of scan 2.
        let found = [None, Some(1), Some(2), Some(3), Some(4)].map(nearest);
        assert_eq!(found, [None, None, Some(1), Some(3), Some(4)]);
    }
}
