//! Calibration of a robot from recorded runs, before it drives by itself.
//!
//! Three kinds of runs give three results, each with its standard error:
//!
//! * straight runs between two fixed points: the velocity factor kv ([`velocity`]);
//! * steady circle runs: the steering map, its inverse for the correction of commands, the play ([`steering`]);
//! * sine runs: the odometry coefficients df and dds of (7.38)-(7.40) ([`drift`]) and the play again ([`backlash`]).
//!
//! [`record`] holds the tables of runs, [`drive`] collects them from the emulated robot as a person with a tape
//! measure and a stopwatch would, [`file`] is what `scanloop run --calibration` reads. Everything here is a pure
//! function of its inputs, without clock and files.

pub mod backlash;
pub mod chart;
pub mod drift;
pub mod drive;
mod estimate;
pub mod file;
mod least_squares;
pub mod record;
mod refusal;
pub mod steering;
pub mod velocity;

pub use chart::FitChart;
pub use estimate::Estimate;
pub use file::CalibrationFile;
pub use refusal::RunRefusal;
