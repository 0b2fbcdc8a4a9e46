//! Nonlinear model predictive control of the robot: from pose and obstacles to one verified command per scan.

pub mod collocation;
mod condense;
mod curvature;
mod dense;
mod config;
mod controller;
mod guide;
mod hurdles;
mod interval;
mod kkt;
mod landing;
mod lateral;
mod lattice;
mod newton;
mod objective;
mod planner;
mod problem;
mod reference;
mod rollout;
mod scene;
mod settings;
mod qp;
mod shooting;
mod side;
mod sqp;
mod state;
mod stop_rule;
#[cfg(test)]
mod testing;
mod usable;
mod verify;
mod warm;
pub mod service;

pub use collocation::{Collocation, Scheme};
pub use config::{Config, Goal, StopSettings, Track, WeightSettings};
pub use controller::Controller;
pub use guide::{Guide, GuideSettings};
pub use interval::{Propagation, propagate};
pub use qp::QpChoice;
pub use shooting::roll_out;
pub use side::Side;
pub use state::ControllerState;
pub use settings::SolverSettings;
pub use sqp::Solver;
pub use usable::MAX_INTERVALS;
pub use problem::{Budget, EllipsePath, Problem, Solution, Trajectory, Weights};
