//! The model that the solver needs of a vehicle: its lateral motion under a constant control.
//!
//! (sideslip, yaw rate) has to be a closed system of its own under (velocity, steering). Yaw as the integral of the
//! yaw rate, and the position as that of the course, are the solver's own part of the model.

use std::fmt::Debug;

/// The lateral motion of a vehicle with its parameters. States are (sideslip, yaw rate), controls (velocity,
/// steering).
pub trait LateralModel: Debug + Send + Sync {
    /// Whether all parameters are valid; otherwise a problem is not solved.
    fn is_sound(&self) -> bool;

    /// Fills `slopes` with the derivatives at `states` under one control.
    fn slopes(&self, control: [f64; 2], states: &[[f64; 2]], slopes: &mut [LateralSlope]);

    /// Second derivatives of the sum of (sideslip rate, yaw acceleration) with `weights` by (sideslip, yaw rate,
    /// velocity, steering).
    fn curvature(&self, control: [f64; 2], state: [f64; 2], weights: [f64; 2]) -> [[f64; 4]; 4];
}

/// Derivatives of (sideslip, yaw rate) with their Jacobians.
#[derive(Debug, Clone, Copy, Default)]
pub struct LateralSlope {
    /// Derivatives of (sideslip, yaw rate).
    pub value: [f64; 2],
    /// By (sideslip, yaw rate), row by row.
    pub by_state: [[f64; 2]; 2],
    /// By (velocity, steering), row by row.
    pub by_control: [[f64; 2]; 2],
}
