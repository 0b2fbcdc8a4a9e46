//! Optimal control of a planar vehicle over a receding horizon, solved within milliseconds.

pub mod analysis;
mod chain;
mod collocation;
mod condense;
mod curvature;
mod dense;
mod hessian;
mod interval;
mod kkt;
mod lateral;
mod newton;
mod objective;
mod problem;
mod propagate;
mod qp;
mod rows;
mod settings;
mod shooting;
mod sqp;
#[cfg(test)]
mod testing;
mod usable;
mod walk;

pub use collocation::{Collocation, Scheme};
pub use hessian::Hessian;
pub use problem::{Budget, EllipsePath, Problem, Solution, Status, Trajectory, Weights};
pub use propagate::roll_out;
pub use qp::QpChoice;
pub use settings::SolverSettings;
pub use sqp::Solver;
