//! Where the robot is and how it moves: correction of the odometry and an extended Kalman filter.
//!
//! One odometry sample in, one pose out. [`Estimator`] combines five pure parts: the yaw of a gyro, if there is one
//! ([`gyro`]); the correction of the odometry, (7.36)-(7.40) ([`correction`]); the motion under the controls that were really sent ([`motion`]); the filter,
//! (7.20)-(7.26) ([`ekf`]); and the check that the measured states suffice, (7.1)-(7.2) ([`observability`]).

mod config;
pub mod correction;
pub mod dead_reckoning;
pub mod ekf;
mod estimator;
pub mod gyro;
pub mod increments;
pub mod laser;
pub mod learned;
pub mod motion;
pub mod observability;
pub mod self_check;
mod stage;
mod state;

pub use config::{EstimatorConfig, FilterSettings, NoiseProfile};
pub use estimator::Estimator;
pub use observability::Measured;
pub use stage::EstimatorStage;
pub use state::EstimatorState;
