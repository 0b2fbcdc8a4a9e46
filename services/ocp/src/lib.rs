//! Optimal control of a planar vehicle over a short horizon: a solver for model predictive control, fast enough for
//! every scan of a sensor.
//!
//! # The problem
//! The horizon has N intervals with a constant control (velocity, steering angle) in each. Wanted are the controls
//! whose motion has the least weighted squares of the distance to a reference trajectory, of the controls about
//! theirs and of their changes. The controls keep hard bounds. The state (sideslip, yaw, yaw rate, x, y) keeps soft
//! bounds, and the position stays outside of ellipses that may move; a soft limit has an exact penalty, so it is kept
//! wherever it can be. All this is one value, [`Problem`].
//!
//! # How to call it
//! A [`Solver`] keeps buffers and nothing else: the solution depends on problem and guess alone, bit by bit, and from
//! the second solve of a size on nothing is allocated.
//!
//! ```
//! use std::sync::Arc;
//!
//! use ocp::{Budget, EllipsePath, Problem, Solver, SolverSettings, Status, Trajectory, Weights};
//! use vehicle::{Bounds, Control, Parameters, State};
//!
//! // Six intervals of 0.45 s along the x axis, past an obstacle a little left of it.
//! let (count, interval) = (6, 0.45);
//! let cruise = Control { velocity: 0.9, steering: 0.0 };
//! let problem = Problem {
//!     model: Arc::new(Parameters::default()),
//!     bounds: Bounds::default(),
//!     x_range: [0.0, 22.0],
//!     y_range: [-1.5, 1.5],
//!     intervals: vec![interval; count],
//!     initial: State { x: 2.2, ..State::default() },
//!     previous: None,
//!     references: (1..=count)
//!         .map(|node| State { x: 2.2 + interval * node as f64, ..State::default() })
//!         .collect(),
//!     control_reference: cruise,
//!     weights: Weights {
//!         node: [0.1, 0.2, 0.1, 1.0, 1.0],
//!         terminal: [0.1, 0.2, 0.1, 5.0, 5.0],
//!         control: [0.5, 5.0],
//!         change: [0.0, 0.0],
//!         slack_linear: 100.0,
//!         slack_quadratic: 100.0,
//!         goal: [(0, 0.0); 2],
//!     },
//!     ellipses: vec![EllipsePath { a: 1.2, b: 0.8, centres: vec![[5.0, 0.1]; count + 1] }],
//!     frames: Vec::new(),
//! };
//! // Controls alone are a guess: they are driven through the model. The next guess is the last solution.
//! let guess = Trajectory { states: Vec::new(), controls: vec![cruise; count] };
//!
//! let mut solver = Solver::new(SolverSettings::default());
//! let solution = solver.solve(&problem, &guess, &Budget::Iterations(60));
//! assert_eq!(solution.status, Status::Converged);
//! // It passes on the right, outside of the ellipse.
//! assert!(solution.trajectory.states[count].y < -0.4 && solution.slack < 1e-6);
//! ```
//!
//! # How it is solved
//! Direct multiple shooting with collocation inside the intervals, sequential quadratic programming with a Newton
//! step on the active set. `problem` says what is solved; `lateral`, `interval` and `shooting` are the model and its
//! sensitivities; `objective` and `kkt` value an iterate; `chain` solves the programs by Riccati recursions, and
//! `condense` with `qp` those of short horizons where that fails; `sqp` is the iteration.
//!
//! # Limits
//! * Another robot is another [`LateralModel`] with its `vehicle::Bounds`: any vehicle whose (sideslip, yaw rate) is
//!   a closed system under (velocity, steering). The five states, the two controls and the kinematics of yaw and
//!   position are fixed; the structure that makes an interval cheap is theirs. A robot that turns on the spot, or one
//!   with a trailer, does not fit.
//! * The velocity is a control and stays positive.
//! * Obstacles are ellipses along the axes of a node's frame, checked at the nodes: not between them.
//! * The solution is local. The guess decides on which side an obstacle is passed.
//! * 200 intervals at most. A solution is not verified: what is driven should be checked by other means.
//!
//! Within this project it depends on `vehicle` only: states, controls, bounds, and the single-track model of the
//! robot.

mod chain;
mod collocation;
mod condense;
mod curvature;
mod dense;
mod hessian;
mod interval;
mod kkt;
mod lateral;
mod model;
mod node_frame;
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
mod trig;
mod usable;
mod walk;

pub use collocation::{Collocation, MAX_STAGES, Scheme};
pub use hessian::Hessian;
pub use interval::{Interval, Linearisation, StageValues};
pub use model::{LateralModel, LateralSlope};
pub use node_frame::NodeFrame;
pub use problem::{ActiveLimit, Budget, EllipsePath, Limit, Problem, Solution, Status, Trajectory, Weights};
pub use propagate::{Propagation, converge, propagate, roll_out};
pub use qp::QpChoice;
pub use settings::SolverSettings;
pub use sqp::Solver;
