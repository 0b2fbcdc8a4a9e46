//! Where the robot is and how it moves: correction of measured data and an extended Kalman filter.
//!
//! One odometry sample in, one pose out. [`Estimator`] ties four pure parts together: the correction of measured
//! data, (7.36)-(7.40) ([`correction`]); the motion under the controls that were really sent ([`motion`]); the
//! filter, (7.20)-(7.26) ([`ekf`]); and the check that what is measured suffices, (7.1)-(7.2) ([`observability`]).

mod config;
pub mod correction;
pub mod ekf;
mod estimator;
pub mod forms;
pub mod motion;
pub mod observability;
pub mod self_check;
pub mod service;
mod state;

pub use config::{Config, Profile, Settings};
pub use estimator::Estimator;
pub use observability::Measured;
pub use state::EstimatorState;
