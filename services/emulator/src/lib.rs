//! The emulated robot: a SUMMIT with a Hokuyo URG-04LX on a track with obstacles, and the referee of a drive.
//!
//! The plant is the model (7.27)-(7.31) with true imperfections: a velocity factor, a bent steering map, backlash, lags,
//! delays, slipping tyres, and an odometer that drifts. The laser takes its beams one after the other while the robot moves.
//! Everything is a pure function of scenario, seed and the actuations received: no clock, no files, no processes.
//!
//! Read [`emulator`] first; it puts [`plant`], [`odometer`], [`laser`] and [`scene`] together.

pub mod emulator;
pub mod history;
pub mod laser;
pub mod noise;
pub mod odometer;
pub mod plant;
pub mod referee;
pub mod scenario;
pub mod scene;
pub mod schedule;
pub mod service;
pub mod solid;
pub mod steering_map;

pub use emulator::{Emulator, EmulatorState, Received};
pub use referee::{DriveProgress, EstimatedScan, JudgedBy, Outcome, Referee};
pub use scenario::{Scenario, ScenarioError};
