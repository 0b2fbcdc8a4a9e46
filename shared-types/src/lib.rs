//! The vocabulary of Scanloop: every sample that crosses a process border, with its layout pinned.
//!
//! A sample is a fixed-layout value (`#[repr(C)]`, no pointers, no implicit padding) that starts with a
//! [`Header`]. The header carries the identity of the scan that a sample answers, and the time stamps of all stages on
//! the way. So each actuation contains the timing of its whole chain.
//!
//! Units are SI, angles are radians counter-clockwise, the frame is x forward along the track, y to the left.

// Samples are used as they lie in memory, also by programs in other languages and by recordings.
#[cfg(not(all(target_pointer_width = "64", target_endian = "little")))]
compile_error!("the layouts of samples are those of 64-bit little endian machines");

mod account;
mod actuation;
mod authority;
mod checkpoint;
mod clock;
mod command;
mod constants;
mod describe;
mod device;
mod driven_by;
mod fault;
mod given_goal;
mod header;
mod health;
mod inbox;
mod journal;
mod layouts;
mod named;
mod nearest;
mod numbering;
mod obstacles;
mod odometry;
mod own;
mod pose;
mod refusal;
mod role;
mod rule;
mod sample;
mod scan;
mod stage;
mod supervision;
mod times;
mod topic;
mod topics;
mod truth;

pub use account::{Fate, InputAccount, Span, WRITERS};
pub use actuation::{Actuation, ActuationKind, BlockReason};
pub use authority::{Admission, Authority, AuthorityFilter};
pub use checkpoint::{CHECKPOINT_BYTES, Checkpoint, CheckpointError};
pub use clock::{ClockOffset, HOST_NAME_BYTES};
pub use command::{
    Blocking, Command, CommandKind, Level, Margin, PLAN_NODES, PlanNode, Sides, SolveStatus, StopReason,
};
pub use constants::{CONSTANTS, Constant, ENUMERATIONS, Number};
pub use describe::{Described, Enumeration, EnumerationValue, Field, Flag, Kind};
pub use device::{DEVICE_REASON_BYTES, Device, DeviceState};
pub use driven_by::{DrivenBy, GivenControl};
pub use fault::{Fault, finite};
pub use given_goal::GivenGoal;
pub use header::{Header, StageStamps, YOUNG_NS};
pub use health::{SECTOR_BEAMS, SECTORS, ScannerHealth, ScannerState, TOLERATED_ERRORS};
pub use inbox::{ASIDE_DEPTH, Inbox, InboxArrival, InboxRules, QUEUE_DEPTH};
pub use journal::{JOURNAL_ENTRIES, Journal, JournalEntry, JournalKind};
pub use layouts::{
    Both, Deviation, Difference, LayoutRow, Layouts, NotALayout, difference, difference_in, differences,
    topics_of,
};
pub use named::UnknownName;
pub use nearest::did_you_mean;
pub use numbering::{KnownScan, MAX_LATE, MAX_NUMBER, MAX_STAMP_NS, highest_sequence, require_sequence};
pub use obstacles::{MAX_OBSTACLES, Obstacle, Obstacles};
pub use odometry::Odometry;
pub use own::{LayoutFault, MAX_OWN_BYTES, OwnField, OwnType};
pub use pose::{Alarm, LEARNED, Pose, Suspect};
pub use refusal::{FIELD_NAME_BYTES, Refusal};
pub use role::{PORTS, ROLES, Role, SLOTS};
pub use rule::Rule;
pub use sample::{Sample, SampleType};
pub use scan::{
    BEAMS, FIRST_BEAM_YAW_RAD, FRONT_BEAM, MAX_BEAMS, MIN_RANGE_MM, PITCH_RAD, Scan, ScanGeometry, WINDOW,
};
pub use stage::{AnySample, AnyStage, Stage, StageEvent, StageShape, Stopwatch};
pub use supervision::{Directive, Heartbeat, Phase, ProcessState};
pub use times::{is_state_time, shift_state, shift_times};
pub use topic::{TOPICS, Topic};
pub use truth::Truth;
