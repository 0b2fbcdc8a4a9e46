//! Counts of commands, blocks of the actuator and alarms of the estimator.

use std::collections::BTreeMap;

use figures::Distribution;
use shared_types::{
    Actuation, ActuationKind, Alarm, BlockReason, Command, LEARNED, Level, Pose, SolveStatus, StopReason,
    Suspect,
};

use crate::report::{ControllerReport, SelfCheckReport};

/// Name of a block because the scanner took no scan in time.
const GAP: &str = "gap";

/// Figures of the solver, and why the wheels were blocked.
#[derive(Debug, Clone)]
pub(super) struct Tally {
    lockstep: bool,
    solve: Distribution,
    iterations: Distribution,
    status: BTreeMap<String, u64>,
    level: BTreeMap<String, u64>,
    stops: BTreeMap<String, u64>,
    actuator_blocks: Option<BlockReason>,
    /// Gaps that the newest actuation has counted.
    gaps: Option<u64>,
    /// Whether the newest block is a silence, which may turn out to be a gap.
    is_silent: bool,
    self_check: SelfCheckReport,
    learned: [[f64; 2]; LEARNED.len()],
    alarmed: bool,
}

impl Tally {
    /// Zero counts. In lock-step the solver's time is left out: it is not the time of this computer.
    pub(super) fn new(lockstep: bool) -> Self {
        Self {
            lockstep,
            solve: Distribution::of_times(),
            iterations: Distribution::of_counts(),
            status: BTreeMap::new(),
            level: BTreeMap::new(),
            stops: BTreeMap::new(),
            actuator_blocks: None,
            gaps: None,
            is_silent: false,
            self_check: SelfCheckReport {
                suspect: Suspect::None.name().to_owned(),
                alarm: Alarm::None.name().to_owned(),
                ..SelfCheckReport::default()
            },
            learned: Default::default(),
            alarmed: false,
        }
    }

    /// Counts an alarm of the estimator's self-check of the calibration.
    pub(super) fn pose(&mut self, pose: &Pose) {
        let seen = &mut self.self_check;
        seen.rejected = pose.rejected;
        self.learned = std::array::from_fn(|place| [pose.learned[place], pose.learned_deviation[place]]);
        let alarm = Alarm::try_from(pose.alarm).unwrap_or(Alarm::None);
        if alarm != Alarm::None {
            if !self.alarmed {
                seen.alarms += 1;
                seen.suspect = Suspect::try_from(pose.suspect).map_or("unknown", Suspect::name).to_owned();
            }
            if seen.first_scan == 0 {
                seen.first_scan = pose.header.scan_id;
            }
            if seen.alarm != Alarm::Stop.name() && seen.alarm != alarm.name() {
                seen.alarm = alarm.name().to_owned();
            }
        }
        self.alarmed = alarm != Alarm::None;
    }

    /// What the self-check of the calibration found.
    pub(super) fn self_check(&self) -> SelfCheckReport {
        self.self_check.clone()
    }

    /// What the estimator has learned: of what it does not learn, nothing.
    pub(super) fn learned(&self) -> BTreeMap<String, [f64; 2]> {
        let all = LEARNED.iter().zip(self.learned).filter(|(_, [_, deviation])| *deviation > 0.0);
        all.map(|(name, figures)| ((*name).to_owned(), figures)).collect()
    }

    /// Counts a command.
    pub(super) fn command(&mut self, command: &Command) {
        let status = SolveStatus::try_from(command.status);
        if status != Ok(SolveStatus::NotSolved) {
            count(&mut self.status, status.map_or("unknown", SolveStatus::name));
        }
        count(&mut self.level, Level::try_from(command.level).map_or("unknown", Level::name));
        match StopReason::try_from(command.reason) {
            // Who drives is reported apart.
            Ok(StopReason::None | StopReason::Paused | StopReason::Released) => {}
            reason => count(&mut self.stops, reason.map_or("unknown", StopReason::name)),
        }
        if !matches!(status, Ok(SolveStatus::NotSolved)) {
            self.iterations.record(u64::from(command.iterations));
            if !self.lockstep {
                self.solve.record(command.solve_ns);
            }
        }
    }

    /// Counts blocks that the actuator decided by itself, each once, however often it is repeated, and gaps.
    pub(super) fn actuation(&mut self, actuation: &Actuation) {
        self.count_gaps(actuation.gaps);
        let reason = BlockReason::try_from(actuation.reason).ok().filter(|reason| {
            actuation.kind == ActuationKind::Block.wire()
                && !matches!(
                    reason,
                    BlockReason::None | BlockReason::Landed | BlockReason::Commanded | BlockReason::Start
                )
        });
        let is_new = reason != self.actuator_blocks;
        if let (Some(name), true) = (reason.map(BlockReason::name), is_new) {
            count(&mut self.stops, name);
        }
        if is_new || actuation.answers == 1 {
            self.is_silent = actuation.answers == 0 && reason == Some(BlockReason::NoCommand);
        }
        self.actuator_blocks = reason;
    }

    /// Counts gaps between scans. A block that was counted as silence, before a scan showed the gap, is one of them.
    fn count_gaps(&mut self, gaps: u64) {
        let new = gaps.saturating_sub(self.gaps.replace(gaps).unwrap_or(gaps));
        if new == 0 {
            return;
        }
        *self.stops.entry(GAP.to_owned()).or_default() += new;
        if std::mem::take(&mut self.is_silent)
            && let Some(silences) = self.stops.get_mut(BlockReason::NoCommand.name())
        {
            *silences -= 1;
            self.stops.retain(|_, count| *count > 0);
        }
    }

    /// The controller's part of the report.
    pub(super) fn controller(&self) -> ControllerReport {
        ControllerReport {
            solve_us: self.solve.figures(),
            iterations: self.iterations.figures(),
            status: self.status.clone(),
            level: self.level.clone(),
        }
    }

    /// How often each reason blocked the wheels.
    pub(super) fn stops(&self) -> BTreeMap<String, u64> {
        self.stops.clone()
    }
}

fn count(counts: &mut BTreeMap<String, u64>, name: &str) {
    if let Some(count) = counts.get_mut(name) {
        *count += 1;
    } else {
        counts.insert(name.to_owned(), 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared_types::CommandKind;

    #[test]
    fn an_alarm_counts_once_and_its_strongest_form_stays() {
        let mut tally = Tally::new(true);
        for (scan_id, alarm) in [(1, Alarm::None), (2, Alarm::Slow), (3, Alarm::Stop), (4, Alarm::Stop)] {
            let mut pose = Pose { alarm: alarm.wire(), rejected: scan_id, ..Pose::default() };
            pose.suspect = if alarm == Alarm::None { Suspect::None } else { Suspect::Heading }.wire();
            pose.header.scan_id = scan_id;
            tally.pose(&pose);
        }
        let seen = tally.self_check();
        assert_eq!((seen.alarms, seen.first_scan, seen.rejected), (1, 2, 4));
        assert_eq!((seen.suspect.as_str(), seen.alarm.as_str()), ("heading", "stop"));
    }

    #[test]
    fn commands_are_counted_by_status_level_and_stop_reason() {
        let mut tally = Tally::new(false);
        let solved = Command {
            kind: CommandKind::Drive.wire(),
            level: 1,
            status: 1,
            iterations: 3,
            ..Command::default()
        };
        tally.command(&Command { solve_ns: 2_000_000, ..solved });
        tally.command(&Command { solve_ns: 4_000_000, ..solved });
        tally.command(&Command { reason: StopReason::Blocked.wire(), ..Command::default() });
        tally.command(&Command { status: 99, ..Command::default() });
        let controller = tally.controller();
        assert_eq!(controller.status["converged"], 2);
        assert_eq!((controller.status.get("not_solved"), controller.status["unknown"]), (None, 1));
        assert_eq!((controller.level["converged"], controller.level["stop"]), (2, 2));
        assert_eq!(controller.solve_us.max, 4000.0);
        assert_eq!(tally.stops(), BTreeMap::from([("blocked".to_owned(), 1)]));
    }

    #[test]
    fn a_block_of_the_actuator_counts_once_however_often_it_is_repeated() {
        let mut tally = Tally::new(false);
        let block = Actuation { kind: 0, reason: BlockReason::NoCommand.wire(), ..Actuation::default() };
        let drive = Actuation { kind: ActuationKind::Drive.wire(), ..Actuation::default() };
        for actuation in [block, block, drive, block] {
            tally.actuation(&actuation);
        }
        assert_eq!(tally.stops(), BTreeMap::from([("no_command".to_owned(), 2)]));
    }

    #[test]
    fn a_gap_between_scans_counts_under_its_own_name() {
        let mut tally = Tally::new(false);
        let block = Actuation { kind: 0, reason: BlockReason::NoCommand.wire(), ..Actuation::default() };
        let drive = |gaps| Actuation { kind: ActuationKind::Drive.wire(), gaps, ..Actuation::default() };
        let refused = Actuation { answers: 1, ..block };
        // A silence, one that a command answers in vain, a gap, and one without a block, as in lock-step.
        for actuation in
            [drive(0), block, drive(0), block, refused, drive(0), block, block, drive(1), drive(2)]
        {
            tally.actuation(&actuation);
        }
        assert_eq!(tally.stops(), BTreeMap::from([("gap".to_owned(), 2), ("no_command".to_owned(), 2)]));
    }
}
