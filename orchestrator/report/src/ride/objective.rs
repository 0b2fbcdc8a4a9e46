//! The objective J of a ride. Its weights are constants: they stay as they are when those of the controller change, so
//! that figures of different builds can be compared.
//!
//! With T the time from the first drive command to [`BEFORE_GOAL_M`] before the goal, t the time since that command,
//! and x0 the position then:
//!
//!   J = integral over T of  STATE (sideslip, yaw, yaw rate, x - x0 - 1 m/s t, y - goal)^2
//!                         + CONTROL (velocity - 1 m/s, steering)^2
//!     + sum over commands of  CHANGE (change of velocity, change of steering)^2, per 0.1 s
//!     + TERMINAL (sideslip, yaw, yaw rate, x - x0 - 1 m/s T, y - goal)^2 at the end.
//!
//! The integral of the states is that of the trapezoidal rule between the moments of the drive. The controls are those
//! that were commanded; each holds until the next one acts.

use vehicle::{Control, State};

/// Integral weights of (sideslip, yaw, yaw rate, x, y).
pub const STATE: [f64; 5] = [0.1, 0.5, 0.1, 1.0, 8.0];
/// Weights of (sideslip, yaw, yaw rate, x, y) at the end.
pub const TERMINAL: [f64; 5] = [0.1, 0.5, 0.1, 5.0, 8.0];
/// Integral weights of (velocity, steering).
pub const CONTROL: [f64; 2] = [0.1, 10.0];
/// Weights of the changes of (velocity, steering) from one command to the next, [`INTERVAL_S`] later.
pub const CHANGE: [f64; 2] = [0.2, 50.0];
/// Velocity of the reference [m/s].
pub const SPEED_MPS: f64 = 1.0;
/// Time between two commands that the weights of the changes hold for [s].
pub const INTERVAL_S: f64 = 0.1;
/// The measured part of a drive ends this far before the goal: what follows is the landing [m].
pub const BEFORE_GOAL_M: f64 = 1.75;

/// The control of the reference.
pub const CRUISE: Control = Control { velocity: SPEED_MPS, steering: 0.0 };

/// Sum of the weighted squares of a state about its reference.
pub(crate) fn of_state(weights: &[f64; 5], state: &State, reference: &State) -> f64 {
    let error = state.to_vector() - reference.to_vector();
    weights.iter().zip(error.iter()).map(|(weight, error)| weight * error * error).sum()
}

/// Sum of the weighted squares of the difference between two controls.
pub(crate) fn of_control(weights: &[f64; 2], one: &Control, other: &Control) -> f64 {
    let (velocity, steering) = (one.velocity - other.velocity, one.steering - other.steering);
    weights[0] * velocity * velocity + weights[1] * steering * steering
}
