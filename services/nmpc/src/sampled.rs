//! One sample of a planned trajectory.

use vehicle::State;

/// A state at a time of the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Sampled {
    /// Time since the start of the plan [s].
    pub(crate) t: f64,
    /// Speed, at most [m/s].
    pub(crate) speed: f64,
    /// The state.
    pub(crate) state: State,
}
