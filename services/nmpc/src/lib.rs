//! Nonlinear model predictive control of the robot: from pose and obstacles to one verified command per scan.

pub mod collocation;
mod condense;
mod curvature;
mod config;
mod controller;
mod guide;
mod interval;
mod kkt;
mod landing;
mod lateral;
mod newton;
mod objective;
mod problem;
mod reference;
mod rollout;
mod scene;
mod qp;
mod shooting;
mod side;
mod sqp;
mod state;
mod stop_rule;
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
pub use sqp::{MAX_INTERVALS, Solver, SolverSettings};
pub use problem::{Budget, EllipsePath, Problem, Solution, Trajectory, Weights};
