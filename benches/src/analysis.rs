//! Design analyses: questions about the discretisation that are answered once, before the robot drives.
//!
//! [`correlation`]: do velocity and steering act on the state in different directions? The source takes this as the
//! condition for a BFGS approximation of the Hessian. [`intervals`]: how many intervals does a horizon need, or how
//! long may a horizon be for a number of intervals, so that the error of collocation against the exact motion stays
//! within a tolerance for every admissible control? The maximum over the controls is found by search, so a figure is
//! a lower bound of the true maximum: another start of the search can only raise it. All of it is deterministic.

pub(crate) mod correlation;
mod exact;
pub(crate) mod forms;
pub(crate) mod intervals;
mod run;
mod search;
