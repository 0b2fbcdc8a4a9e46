//! The enumerations and constants that a process in another language needs to read and write samples.

use crate::{
    ActuationKind, Alarm, BEAMS, BlockReason, CHECKPOINT_BYTES, CommandKind, DEVICE_REASON_BYTES,
    DeviceState, DrivenBy, Enumeration, FIRST_BEAM_YAW_RAD, FRONT_BEAM, JOURNAL_ENTRIES, JournalKind, Level,
    MAX_BEAMS, MAX_OBSTACLES, MIN_RANGE_MM, PITCH_RAD, PLAN_NODES, Phase, ProcessState, ROLES, Role, Rule,
    SECTOR_BEAMS, SLOTS, ScannerState, SolveStatus, StopReason, Suspect, WINDOW,
};

/// All enumerations of the samples.
pub const ENUMERATIONS: [Enumeration; 16] = [
    Role::ENUMERATION,
    Phase::ENUMERATION,
    ProcessState::ENUMERATION,
    DeviceState::ENUMERATION,
    Suspect::ENUMERATION,
    ScannerState::ENUMERATION,
    Alarm::ENUMERATION,
    CommandKind::ENUMERATION,
    Level::ENUMERATION,
    SolveStatus::ENUMERATION,
    StopReason::ENUMERATION,
    DrivenBy::ENUMERATION,
    ActuationKind::ENUMERATION,
    BlockReason::ENUMERATION,
    Rule::ENUMERATION,
    JournalKind::ENUMERATION,
];

/// A named number of the vocabulary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constant {
    /// Its name.
    pub name: &'static str,
    /// What it means, with the unit in brackets.
    pub doc: &'static str,
    /// Its value.
    pub value: Number,
}

/// Value of a [`Constant`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// An integer.
    Integer(i64),
    /// A real number.
    Real(f64),
}

/// All constants of the samples.
pub const CONSTANTS: [Constant; 16] = [
    integer("ROLES", "Number of roles", ROLES),
    integer("SLOTS", "Largest number of processes in the loop", SLOTS),
    integer("MAX_BEAMS", "Largest number of beams of a scan", MAX_BEAMS),
    integer("BEAMS", "Number of beams of the URG-04LX", BEAMS),
    integer("FRONT_BEAM", "Index of its beam that looks straight ahead", FRONT_BEAM),
    integer(
        "FIRST_ANALYSED_BEAM",
        "Its first beam analysed for obstacles, 60 deg to the right",
        *WINDOW.start(),
    ),
    integer("LAST_ANALYSED_BEAM", "Its last beam analysed for obstacles, 60 deg to the left", *WINDOW.end()),
    integer("MIN_RANGE_MM", "Ranges below this are error codes: no return [mm]", MIN_RANGE_MM as usize),
    real("PITCH_RAD", "Angle between two of its beams [rad]", PITCH_RAD),
    real(
        "FIRST_BEAM_YAW_RAD",
        "Angle of its beam 0, counter-clockwise from straight ahead [rad]",
        FIRST_BEAM_YAW_RAD,
    ),
    integer("SECTOR_BEAMS", "Beams of one sector of evidence", SECTOR_BEAMS),
    integer("MAX_OBSTACLES", "How many ellipses a description can hold", MAX_OBSTACLES),
    integer("PLAN_NODES", "How many nodes of the plan a command carries", PLAN_NODES),
    integer("CHECKPOINT_BYTES", "How many bytes of state a checkpoint can hold", CHECKPOINT_BYTES),
    integer("JOURNAL_ENTRIES", "How many entries a journal can hold", JOURNAL_ENTRIES),
    integer("DEVICE_REASON_BYTES", "How many bytes the reason of a device can have", DEVICE_REASON_BYTES),
];

const fn integer(name: &'static str, doc: &'static str, value: usize) -> Constant {
    Constant { name, doc, value: Number::Integer(value as i64) }
}

const fn real(name: &'static str, doc: &'static str, value: f64) -> Constant {
    Constant { name, doc, value: Number::Real(value) }
}

impl std::fmt::Display for Number {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Integer(value) => write!(formatter, "{value}"),
            // The shortest text that reads back as the same bits.
            Self::Real(value) => write!(formatter, "{value:?}"),
        }
    }
}
