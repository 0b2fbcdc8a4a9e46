//! The matrix of faults and phases: each cell is a drive with one fault that begins in one phase, and its verdict.
//!
//! A cell is judged by the true wheels, not by a flag: nothing may be touched, the drive must end as its fault allows,
//! and the way that the wheels drove until the fault was detected is limited ([`DetectionLimits`]). Cells of faults of
//! samples and of the robot are driven here, in simulated time, see [`Rig`]. Cells with processes that die, hang or
//! flood need real processes; they are judged by the same [`judge`].

mod cell;
pub mod course;
mod finding;
mod piped;
mod rig;
mod simulate;

pub use cell::{Cell, CellVerdict, DetectionLimits, DrivenWay, Observed, Passed, judge};
pub use finding::{Finding, FindingPlace, Findings};
pub use piped::PipedStage;
pub use rig::Rig;
pub use simulate::Simulation;
