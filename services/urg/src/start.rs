//! The steps from a connection to the measurement.

use crate::coding::{decode, verified};
use crate::command::{Measurement, ScipCommand};
use crate::status::ScipStatus;

/// Round trips for the time: the shortest of ten is short.
const ROUND_TRIPS: u8 = 10;
/// A scanner that refuses a command is asked again after this time [ns].
const SOON_NS: u64 = 140_000_000;
/// A scanner with a fault is tried again after this time [ns].
const FAULT_NS: u64 = 1_000_000_000;

/// One command of the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    Stop,
    SelectScip2,
    LeaveTimeMode,
    Version,
    Parameters,
    State,
    EnterTimeMode,
    ReadTime(u8),
    ExitTimeMode,
    LaserOn,
    Start,
}

/// What follows the reply to a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    Ask(Step),
    Measure,
    /// All questions are answered.
    Done,
    /// Begin anew after this time [ns].
    Fault(u64),
}

impl Step {
    pub(crate) fn command(self, measurement: &Measurement) -> ScipCommand {
        match self {
            Self::Stop => ScipCommand::Quit,
            Self::SelectScip2 => ScipCommand::SelectScip2,
            Self::LeaveTimeMode | Self::ExitTimeMode => ScipCommand::TimeModeOff,
            Self::Version => ScipCommand::Version,
            Self::Parameters => ScipCommand::Parameters,
            Self::State => ScipCommand::State,
            Self::EnterTimeMode => ScipCommand::TimeModeOn,
            Self::ReadTime(_) => ScipCommand::Time,
            Self::LaserOn => ScipCommand::LaserOn,
            Self::Start => ScipCommand::Measure(*measurement),
        }
    }

    /// What follows a reply with this status.
    pub(crate) fn after(self, status: ScipStatus, identify_only: bool) -> Outcome {
        let number = status.number();
        match self {
            Self::Stop if status == ScipStatus::DONE => Outcome::Ask(Self::Version),
            Self::Stop if status == ScipStatus::SCIP_1 => Outcome::Ask(Self::SelectScip2),
            Self::Stop if status == ScipStatus::NOT_ALLOWED => Outcome::Ask(Self::LeaveTimeMode),
            Self::SelectScip2 | Self::LeaveTimeMode => Outcome::Ask(Self::Version),
            Self::Version => Outcome::Ask(Self::Parameters),
            Self::Parameters if status == ScipStatus::DONE => Outcome::Ask(Self::State),
            Self::State if identify_only => Outcome::Done,
            Self::State => Outcome::Ask(Self::EnterTimeMode),
            Self::EnterTimeMode if matches!(number, Some(0 | 2)) => Outcome::Ask(Self::ReadTime(0)),
            // A model without time mode: its smallest delay is computed.
            Self::EnterTimeMode => Outcome::Ask(Self::LaserOn),
            Self::ReadTime(count) if count + 1 < ROUND_TRIPS => Outcome::Ask(Self::ReadTime(count + 1)),
            Self::ReadTime(_) => Outcome::Ask(Self::ExitTimeMode),
            Self::ExitTimeMode => Outcome::Ask(Self::LaserOn),
            Self::LaserOn if matches!(number, Some(0 | 2)) => Outcome::Ask(Self::Start),
            Self::Start if status == ScipStatus::DONE => Outcome::Measure,
            Self::LaserOn | Self::Start => Outcome::Fault(FAULT_NS),
            Self::Stop | Self::Parameters => Outcome::Fault(SOON_NS),
        }
    }

    /// The time in the reply to [`ScipCommand::Time`] [ms, 24 bits].
    pub(crate) fn time_of(text: &[u8]) -> Option<u32> {
        let line = text.split(|byte| *byte == b'\n').next()?;
        verified(line).filter(|text| text.len() == 4).and_then(decode)
    }
}
