//! Nonlinear model predictive control of the robot: from pose and obstacles to one verified command per scan.

mod problem;

pub use problem::{Budget, EllipsePath, Problem, Solution, Trajectory, Weights};
