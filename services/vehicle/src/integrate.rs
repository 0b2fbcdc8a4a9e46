//! Explicit integration of the model with steps small enough for its stiff part.

use nalgebra::SVector;

use crate::model::derivative;
use crate::{Control, Parameters, State};

/// Largest step [s]. RK4 is stable below 7.9 ms at 0.1 m/s and below 3.9 ms at 0.05 m/s.
pub const MAX_STEP_S: f64 = 0.002;

/// The state after `duration` seconds under a constant control, by RK4 in equal steps of at most [`MAX_STEP_S`].
#[must_use]
pub fn integrate(parameters: &Parameters, state: &State, control: &Control, duration: f64) -> State {
    if duration <= 0.0 {
        return *state;
    }
    let steps = (duration / MAX_STEP_S).ceil();
    let step = duration / steps;
    (0..steps as usize).fold(*state, |state, _| rk4(parameters, &state, control, step))
}

/// One step of the classical Runge-Kutta method on the model.
#[must_use]
pub fn rk4(parameters: &Parameters, state: &State, control: &Control, step: f64) -> State {
    runge_kutta(state, step, |state| derivative(parameters, state, control))
}

/// One step of the classical Runge-Kutta method for any time derivative of the state.
#[must_use]
pub fn runge_kutta(state: &State, step: f64, derivative: impl Fn(&State) -> SVector<f64, 5>) -> State {
    let end = runge_kutta_vector(state.to_vector(), step, |vector| derivative(&State::from_vector(&vector)));
    State::from_vector(&end)
}

/// One step of the classical Runge-Kutta method.
#[must_use]
pub fn runge_kutta_vector<const N: usize>(
    start: SVector<f64, N>,
    step: f64,
    slope: impl Fn(SVector<f64, N>) -> SVector<f64, N>,
) -> SVector<f64, N> {
    let k1 = slope(start);
    let k2 = slope(start + k1 * (step / 2.0));
    let k3 = slope(start + k2 * (step / 2.0));
    let k4 = slope(start + k3 * step);
    start + (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (step / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::steady_turn;

    #[test]
    fn driving_straight_covers_velocity_times_time() {
        let control = Control { velocity: 0.8, steering: 0.0 };
        let end = integrate(&Parameters::default(), &State::default(), &control, 2.5);
        assert!((end.x - 2.0).abs() < 1e-12 && end.y == 0.0);
    }

    #[test]
    fn the_stiff_part_settles_in_the_steady_turn_at_the_lowest_velocity() {
        let parameters = Parameters::default();
        let control = Control { velocity: 0.1, steering: 0.06 };
        let end = integrate(&parameters, &State::default(), &control, 1.0);
        let (sideslip, yaw_rate) = steady_turn(&parameters, &control);
        assert!((end.yaw_rate - yaw_rate).abs() < 1e-6);
        assert!((end.sideslip - sideslip).abs() < 1e-6);
    }
}
