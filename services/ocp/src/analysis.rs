//! Design analyses: questions about the discretisation that are answered once, before the robot drives.
//!
//! [`correlation`] asks whether velocity and steering act on the state in different directions, which is what the
//! source takes as the licence for a BFGS approximation of the Hessian. [`intervals`] asks how many intervals a
//! horizon needs, or how long a horizon a number of intervals carries, when the error of collocation against the
//! exact motion is to stay within a tolerance for every admissible control. The inner maximum over the controls
//! is found by search, so a figure is a lower bound of the true maximum: another start of the search can only
//! raise it. All of it is deterministic.

pub mod correlation;
mod exact;
pub mod intervals;
mod run;
mod search;
