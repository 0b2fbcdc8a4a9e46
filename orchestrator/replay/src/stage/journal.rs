//! Replays the processes of a role by their journals: each takes, uses and decides the same in the same order.
//!
//! A process on another host is replayed on the clock of its host: what it took is mapped there, and what it published is
//! mapped back, by the offset that its host has used for each scan.

use std::collections::BTreeSet;

use actuation::ActuatorStage;
use console::exit::Failure;
use estimator::EstimatorStage;
use nmpc::ControllerStage;
use obstacles::DetectorStage;
use serde::de::DeserializeOwned;
use shared_types::{
    Actuation, AnySample, Checkpoint, Described, Journal, JournalEntry, JournalKind, Role, Sample, Stage,
    StageEvent, Stopwatch, TOPICS, Topic, shift_state,
};

use super::{Findings, Window};
use crate::drive::{Lane, moved};
use crate::{ReplayDrive, ReplayOptions};

/// An output that can't be recomputed.
const NO_STATE: &str = "no state of the process was recorded";
const LOST: &str = "a journal of the process was not recorded";
pub(super) const NO_JOURNAL: &str =
    "no journal of the process was recorded, as before processes published journals";
/// An injected fault alters the robot: a state is that of another robot.
const ALTERED: &str = "an injected fault altered the robot";
/// The fault is over, but it has changed the state.
const RESTORED: &str = "an injected fault had altered the robot";
const FOREIGN: &str = "not_compared: the process is no implementation of this program";

/// What was not recorded although a process had it.
#[derive(Debug, Clone, Copy)]
enum Missing {
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

/// A sample that a process has taken and not used yet.
#[derive(Clone, Copy)]
struct Waiting {
    entry: JournalEntry,
    /// It was handed over, with its times moved by this [ns].
    moved_ns: Option<i64>,
}

/// Hands samples to a stage as its process had them.
struct Taking<'d> {
    drive: &'d ReplayDrive,
    incarnation: u32,
}

impl Taking<'_> {
    fn give(&self, waiting: &Waiting, now_ns: u64, stage: &mut impl Stage) -> Result<(), Missing> {
        let drive = self.drive;
        match TOPICS.get(usize::from(waiting.entry.topic)) {
            Some(Topic::Scan) => self.give_from(&drive.scans, waiting, now_ns, stage),
            Some(Topic::Odometry) => self.give_from(&drive.odometries, waiting, now_ns, stage),
            Some(Topic::Pose) => self.give_from(&drive.poses, waiting, now_ns, stage),
            Some(Topic::Obstacles) => self.give_from(&drive.obstacles, waiting, now_ns, stage),
            Some(Topic::Command) => self.give_from(&drive.commands, waiting, now_ns, stage),
            Some(Topic::Actuation) => self.give_from(&drive.actuations, waiting, now_ns, stage),
            Some(Topic::Directive) => {
                // The scans of a goal are the same on all hosts.
                let Waiting { entry, .. } = waiting;
                let taken = drive.directives.of_number(entry.incarnation, entry.value);
                stage.take(AnySample::of(taken.ok_or(Missing::Input)?), now_ns);
                Ok(())
            }
            _ => Err(Missing::Input),
        }
    }

    fn give_from<S: Sample>(
        &self,
        lane: &Lane<S>,
        Waiting { entry, moved_ns }: &Waiting,
        now_ns: u64,
        stage: &mut impl Stage,
    ) -> Result<(), Missing> {
        let recorded = lane.of_number(entry.incarnation, entry.value).ok_or(Missing::Input)?;
        let sample = match *moved_ns {
            Some(by_ns) => moved(recorded, by_ns),
            None => self.drive.clocks.to_local(self.incarnation, recorded).ok_or(Missing::Clock)?,
        };
        stage.take(AnySample::of(&sample), now_ns);
        Ok(())
    }
}

/// A stage that is replayed.
pub(crate) trait Recomputed: Stage {
    /// Compares what else the process has published for the scan of `recorded`.
    fn compare_others(
        &mut self,
        _recorded: &Self::Output,
        _drive: &ReplayDrive,
        _options: &ReplayOptions,
        _findings: &mut Findings,
    ) {
    }

    /// The same process with other settings, before the scan `scan_id`.
    ///
    /// # Errors
    /// Why it can't continue with them.
    fn with_settings(&self, settings: Self::Settings, period_ns: u64, _scan_id: u64) -> Result<Self, String> {
        let mut other = Self::begin(settings, period_ns).map_err(|invalid| invalid.to_string())?;
        match self.state() {
            Some(state) if !other.resume(&state) => Err("it can't continue with these keys".to_owned()),
            _ => Ok(other),
        }
    }
}

impl Recomputed for EstimatorStage {}
impl Recomputed for DetectorStage {}
impl Recomputed for ControllerStage {}
impl Recomputed for ActuatorStage {}

/// Replays all processes of a role.
pub(super) fn replay<T: Recomputed>(
    lane: &Lane<T::Output>,
    drive: &ReplayDrive,
    options: &ReplayOptions,
    findings: &mut Findings,
) -> anyhow::Result<()>
where
    T::Settings: DeserializeOwned,
{
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
fn replay_process<T: Recomputed>(
    (incarnation, lane): (u32, &Lane<T::Output>),
    drive: &ReplayDrive,
    options: &ReplayOptions,
    window: &Window,
    findings: &mut Findings,
    skipped: &mut Skipped,
) -> anyhow::Result<()>
where
    T::Settings: DeserializeOwned,
{
    let mut process = Replayed::<T>::begin(incarnation, drive, options.from)?;
    for (place, (journal, follows)) in drive.numbered_journals(incarnation).enumerate() {
        process.come_to(place, follows);
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
pub(super) struct Replayed<'d, T> {
    pub(super) stage: T,
    taking: Taking<'d>,
    /// What it has taken and not used yet.
    waiting: Vec<Waiting>,
    /// By how much the times of what it takes next were moved [ns].
    moved_ns: Option<i64>,
    /// After how many readings of its clock the time for the next output is over.
    readings: Option<u64>,
    /// The port makes the next output a block.
    is_held_back: bool,
    /// Number of the state that it begins with, if it does not begin with its start.
    nearest: Option<u64>,
    /// Why the state of the stage is not that of the process.
    pub(super) unknown: Option<&'static str>,
    /// Incarnation and number of the actuation that it has used last.
    pub(super) actuation: Option<(u32, u64)>,
}

impl<'d, T: Recomputed> Replayed<'d, T>
where
    T::Settings: DeserializeOwned,
{
    /// A process before its first journal, or before that of the state from which the scan `from` is reached first.
    pub(super) fn begin(incarnation: u32, drive: &'d ReplayDrive, from: Option<u64>) -> anyhow::Result<Self> {
        let nearest = nearest_state(incarnation, drive, from);
        let settings = drive.settings.of_process(incarnation, T::ROLE)?;
        let stage = T::begin(settings, drive.period_ns).map_err(|invalid| {
            Failure::bad_input(format!("the settings of role {} for the replay: {invalid}", T::ROLE))
        })?;
        Ok(Self {
            stage,
            taking: Taking { drive, incarnation },
            waiting: Vec::new(),
            moved_ns: None,
            readings: None,
            is_held_back: false,
            nearest,
            unknown: nearest.map(|_| NO_STATE),
            actuation: None,
        })
    }
}

impl<T: Recomputed> Replayed<'_, T> {
    /// Comes to its journal with this place; whether it follows the one before.
    pub(super) fn come_to(&mut self, place: usize, follows: bool) {
        if !follows {
            self.unknown = Some(if place == 0 { NO_STATE } else { LOST });
        }
    }

    /// Does what one entry states.
    pub(super) fn follow(&mut self, entry: &JournalEntry) {
        let Ok(kind) = JournalKind::try_from(u32::from(entry.kind)) else { return };
        match kind {
            JournalKind::Moved => self.moved_ns = Some(entry.value.cast_signed()),
            JournalKind::Taken => {
                self.waiting.push(Waiting { entry: *entry, moved_ns: self.moved_ns.take() });
            }
            JournalKind::Resumed => {
                let moved_ns = self.moved_ns.take().unwrap_or(0);
                let is_known = self.resume(entry.incarnation, entry.value, moved_ns);
                self.unknown = if is_known { None } else { Some(NO_STATE) };
            }
            JournalKind::Saved => {
                let is_wanted = self.nearest.is_none_or(|nearest| entry.value >= nearest);
                let incarnation = self.taking.incarnation;
                let is_unknown = self.unknown.is_some_and(|reason| reason != ALTERED);
                if is_unknown && is_wanted && self.resume(incarnation, entry.value, 0) {
                    self.unknown = None;
                }
            }
            JournalKind::Altered => {
                self.unknown = Some(if entry.value == 1 { ALTERED } else { RESTORED });
            }
            JournalKind::Used => self.give(entry.value),
            JournalKind::Budget => self.readings = Some(entry.value),
            JournalKind::HeldBack => self.is_held_back = true,
            _ => {
                let event = StageEvent::of(kind, entry.value).filter(|_| self.unknown.is_none());
                event.map(|event| self.stage.follow(event));
            }
        }
    }

    /// Hands over what the process has taken, at the time at which it was used.
    ///
    /// A robot uses one actuation at a time. Those that it has taken before were in the state that it begins with, or came
    /// while its wheels were blocked: it has passed over them.
    fn give(&mut self, now_ns: u64) {
        let is_actuation = |waiting: &Waiting| waiting.entry.topic == Topic::Actuation as u16;
        let used = self.waiting.iter().rposition(is_actuation);
        for (index, waiting) in self.waiting.drain(..).enumerate() {
            if is_actuation(&waiting) {
                if T::ROLE == Role::Robot && Some(index) != used {
                    continue;
                }
                self.actuation = Some((waiting.entry.incarnation, waiting.entry.value));
            }
            if self.unknown.is_none() {
                self.unknown = self.taking.give(&waiting, now_ns, &mut self.stage).err().map(Missing::reason);
            }
        }
    }

    /// The output of the stage for a scan, or why there is none.
    pub(super) fn output(&mut self, scan_id: u64) -> Result<T::Output, &'static str> {
        // Detectors and controllers of earlier versions noted no time. A robot has what does not act yet.
        if T::ANSWERS.len() > 1 {
            self.give(0);
        }
        // With other settings an output takes another time, and its time does not end.
        let readings = self.readings.take().filter(|_| !self.taking.drive.is_changed);
        let is_held_back = std::mem::take(&mut self.is_held_back);
        if let Some(reason) = self.unknown {
            return Err(reason);
        }
        let watch = match self.taking.drive.simulated {
            true => Stopwatch::standing(),
            false => Stopwatch::recorded(readings),
        };
        let mut output = self.stage.output(scan_id, &watch).ok_or(Missing::Input.reason())?;
        if is_held_back {
            hold_back(&mut output);
        }
        Ok(output)
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
        let output = self.output(journal.header.scan_id);
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

/// Makes an actuation that drives a block, as the port of an actuator does.
fn hold_back<S: Sample>(output: &mut S) {
    if S::TOPIC == Topic::Actuation {
        let actuation: &mut Actuation = bytemuck::from_bytes_mut(bytemuck::bytes_of_mut(output));
        if actuation.drives() {
            actuation.hold_back();
        }
    }
}

/// The newest recorded state of the process before its first output that is asked for, by number.
///
/// The scan of a state does not tell: an estimator that got an actuation late has saved a state of an earlier scan after
/// its pose.
fn nearest_state(incarnation: u32, drive: &ReplayDrive, from: Option<u64>) -> Option<u64> {
    let (from, mut nearest) = (from?, None);
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
    const SPANS: [&str; 9] = [
        "usual_age_ns",
        "clock_ns",
        "plant_ns",
        "last_actuation_ns",
        "reported_ns",
        "longest_blind_ns",
        "arrives_ns",
        "sweep_ns",
        "lasted_ns",
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
        let nearest = |from| nearest_state(ESTIMATOR, &drive, from);
        // State 3 is of scan 1 too, but holds the pose of scan 2.
        let found = [None, Some(1), Some(2), Some(3), Some(4)].map(nearest);
        assert_eq!(found, [None, None, Some(1), Some(3), Some(4)]);
    }
}
