//! The motion of a differential drive: no sideslip, and a yaw rate that follows its command u1 u2 / (lh + lv) with a lag.
//!
//! Assumption: the wheels neither slip nor saturate; `vehicle.bounds` limit what is asked of them.

use crate::{Control, Parameters};

/// Rates of sideslip and yaw rate.
pub(crate) fn lateral(
    parameters: &Parameters,
    [sideslip, yaw_rate]: [f64; 2],
    control: &Control,
) -> [f64; 2] {
    let (_, command) = steady_turn(parameters, control);
    [-sideslip / parameters.yaw_lag_s, (command - yaw_rate) / parameters.yaw_lag_s]
}

/// Gradients of both by (sideslip, yaw rate, velocity, steering), and the second derivatives of their sum with `weights`.
pub(crate) fn derivatives(
    parameters: &Parameters,
    control: &Control,
    weights: [f64; 2],
) -> ([[f64; 4]; 2], [[f64; 4]; 4]) {
    let (rate, gain) = (1.0 / parameters.yaw_lag_s, parameters.yaw_rate_gain() / parameters.yaw_lag_s);
    let mut twice = [[0.0; 4]; 4];
    twice[2][3] = weights[1] * gain;
    twice[3][2] = twice[2][3];
    let by = [[-rate, 0.0, 0.0, 0.0], [0.0, -rate, gain * control.steering, gain * control.velocity]];
    (by, twice)
}

/// Sideslip and yaw rate that are commanded.
pub(crate) fn steady_turn(parameters: &Parameters, control: &Control) -> (f64, f64) {
    (0.0, control.velocity * control.steering * parameters.yaw_rate_gain())
}
