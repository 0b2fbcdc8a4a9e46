//! The model (7.27)-(7.31) and its Jacobians.
//!
//! Lateral forces are linear in the slip angles of the two axles, so the model holds for small slip and for
//! velocities other than zero: u1 divides. It is stiff: the eigenvalues of (sideslip, yaw rate) are -34 1/s at
//! 1 m/s and -350 1/s at 0.1 m/s.
//!
//! A robot that drives backwards is one that is turned round and drives forwards: [`Parameters::mirrored`],
//! [`State::mirrored`], [`Control::mirrored`]. Written out, (7.27) and (7.29) stay as they are but for the sign of the
//! stiffness, because the forces of tyres are against their motion to the side: [`Parameters::stiffness_at`].

use nalgebra::SVector;

use crate::state::SIDEWAYS_RAD;
use crate::{Control, Parameters, State, VehicleModel, differential, single_track};

/// Velocity to either side below which the lateral part of the model is not slowed down further [m/s]: RK4 is stable there
/// in steps of up to 3.9 ms.
pub const SLOWEST_MPS: f64 = 0.05;

/// The velocity of the lateral part of the model for a robot at `speed`: at least [`SLOWEST_MPS`], in its direction; forwards
/// at rest [m/s].
pub fn lateral_velocity(speed: f64) -> f64 {
    if speed < 0.0 { speed.min(-SLOWEST_MPS) } else { speed.max(SLOWEST_MPS) }
}

/// Time derivative of the state, (7.27)-(7.31).
///
/// Source note: the extracted text of (7.27) shows a product between 2 x1 and the yaw rate term; with it the
/// sideslip would have no damping. Single-track physics gives the sum used here, and (7.29) as printed.
pub fn derivative(parameters: &Parameters, state: &State, control: &Control) -> SVector<f64, 5> {
    derivative_under(parameters, state, control, control.velocity)
}

/// [`derivative`] of a robot that drives at any speed, with the lateral part of [`lateral_velocity`].
pub fn derivative_at(parameters: &Parameters, state: &State, speed: f64, steering: f64) -> SVector<f64, 5> {
    derivative_under(parameters, state, &Control { velocity: lateral_velocity(speed), steering }, speed)
}

fn derivative_under(
    parameters: &Parameters,
    state: &State,
    lateral_control: &Control,
    speed: f64,
) -> SVector<f64, 5> {
    let State { sideslip, yaw, yaw_rate, .. } = *state;
    let [sideslip_rate, yaw_acceleration] = lateral(parameters, sideslip, yaw_rate, lateral_control);
    let (sin, cos) = (sideslip + yaw).sin_cos();
    SVector::from([sideslip_rate, yaw_rate, yaw_acceleration, speed * cos, speed * sin])
}

/// Derivatives of sideslip (7.27) and yaw rate (7.29): the stiff part, which depends on nothing else.
pub fn lateral(parameters: &Parameters, sideslip: f64, yaw_rate: f64, control: &Control) -> [f64; 2] {
    if parameters.model != VehicleModel::CounterSteered {
        let state = [sideslip, yaw_rate];
        return match parameters.model.shares() {
            Some(shares) => single_track::lateral(parameters, shares, state, cosine_of(sideslip), control),
            None => differential::lateral(parameters, state, control),
        };
    }
    let Parameters { mass_kg, rear_m, front_m, inertia_kgm2, .. } = *parameters;
    let Control { velocity, steering } = *control;
    let force = parameters.stiffness_at(velocity) * steering.cos();
    let curvature = yaw_rate / velocity;
    let sideslip_rate = force * (-2.0 * sideslip + curvature * (rear_m - front_m))
        / (mass_kg * velocity * cosine_of(sideslip))
        - yaw_rate;
    let yaw_acceleration = force
        * (steering * (rear_m + front_m) + sideslip * (rear_m - front_m)
            - curvature * (rear_m * rear_m + front_m * front_m))
        / inertia_kgm2;
    [sideslip_rate, yaw_acceleration]
}

/// The cosine by which (7.27) divides: beyond [`SIDEWAYS_RAD`] that of a robot at this angle.
pub(crate) fn cosine_of(sideslip: f64) -> f64 {
    sideslip.clamp(-SIDEWAYS_RAD, SIDEWAYS_RAD).cos()
}

/// Jacobians of [`lateral`] with respect to (sideslip, yaw rate) and (velocity, steering), row by row.
pub fn lateral_jacobians(
    parameters: &Parameters,
    sideslip: f64,
    yaw_rate: f64,
    control: &Control,
) -> ([[f64; 2]; 2], [[f64; 2]; 2]) {
    let Parameters { mass_kg, rear_m, front_m, inertia_kgm2, .. } = *parameters;
    if parameters.model != VehicleModel::CounterSteered {
        let ([first, last], _) = lateral_derivatives(parameters, sideslip, yaw_rate, control, [0.0; 2]);
        let columns = |from: usize| [first, last].map(|row| [row[from], row[from + 1]]);
        return (columns(0), columns(2));
    }
    let Control { velocity, steering } = *control;
    let stiffness = parameters.stiffness_at(velocity);
    let (sin, cos) = steering.sin_cos();
    let (sum, difference) = (rear_m + front_m, rear_m - front_m);
    let square = rear_m * rear_m + front_m * front_m;
    let curvature = yaw_rate / velocity;

    let scale = stiffness / (mass_kg * velocity * sideslip.cos());
    let slip = -2.0 * sideslip + curvature * difference;
    let moment = steering * sum + sideslip * difference - curvature * square;
    let torque = stiffness / inertia_kgm2;

    let by_state = [
        [cos * scale * (-2.0 + slip * sideslip.tan()), cos * scale * difference / velocity - 1.0],
        [torque * cos * difference, -torque * cos * square / velocity],
    ];
    let by_control = [
        [-cos * scale * (slip + curvature * difference) / velocity, -sin * scale * slip],
        [torque * cos * curvature * square / velocity, torque * (cos * sum - sin * moment)],
    ];
    (by_state, by_control)
}

/// Gradients of [`lateral`] by (sideslip, yaw rate, velocity, steering), and the second derivatives of its sum with `weights`, for
/// any model.
pub fn lateral_derivatives(
    parameters: &Parameters,
    sideslip: f64,
    yaw_rate: f64,
    control: &Control,
    weights: [f64; 2],
) -> ([[f64; 4]; 2], [[f64; 4]; 4]) {
    match parameters.model.shares() {
        Some(shares) => single_track::derivatives(parameters, shares, [sideslip, yaw_rate], control, weights),
        None => differential::derivatives(parameters, control, weights),
    }
}

/// Steady sideslip and yaw rate under a constant control, for small angles.
pub fn steady_turn(parameters: &Parameters, control: &Control) -> (f64, f64) {
    if parameters.model != VehicleModel::CounterSteered {
        return match parameters.model.shares() {
            Some(shares) => single_track::steady_turn(parameters, shares, control),
            None => differential::steady_turn(parameters, control),
        };
    }
    let Parameters { mass_kg, rear_m, front_m, .. } = *parameters;
    let stiffness = parameters.stiffness_at(control.velocity);
    let difference = rear_m - front_m;
    let square = rear_m * rear_m + front_m * front_m;
    // (7.27) = 0 gives the sideslip per yaw rate, (7.29) = 0 then the yaw rate.
    let slope = (difference / control.velocity
        - mass_kg * control.velocity / (stiffness * control.steering.cos()))
        / 2.0;
    let yaw_rate = control.steering * (rear_m + front_m) / (square / control.velocity - difference * slope);
    (slope * yaw_rate, yaw_rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SMatrix;
    use proptest::prelude::*;

    /// Jacobian of [`derivative`] with respect to the state, 5 x 5.
    fn state_jacobian(parameters: &Parameters, state: &State, control: &Control) -> SMatrix<f64, 5, 5> {
        let (by_state, _) = lateral_jacobians(parameters, state.sideslip, state.yaw_rate, control);
        let (sin, cos) = (state.sideslip + state.yaw).sin_cos();
        let mut jacobian = SMatrix::zeros();
        for (row, source) in [(0, by_state[0]), (2, by_state[1])] {
            jacobian[(row, 0)] = source[0];
            jacobian[(row, 2)] = source[1];
        }
        jacobian[(1, 2)] = 1.0;
        for column in 0..2 {
            jacobian[(3, column)] = -control.velocity * sin;
            jacobian[(4, column)] = control.velocity * cos;
        }
        jacobian
    }

    /// Jacobian of [`derivative`] with respect to the control, 5 x 2.
    fn control_jacobian(parameters: &Parameters, state: &State, control: &Control) -> SMatrix<f64, 5, 2> {
        let (_, by_control) = lateral_jacobians(parameters, state.sideslip, state.yaw_rate, control);
        let (sin, cos) = (state.sideslip + state.yaw).sin_cos();
        let mut jacobian = SMatrix::zeros();
        for (row, source) in [(0, by_control[0]), (2, by_control[1])] {
            jacobian[(row, 0)] = source[0];
            jacobian[(row, 1)] = source[1];
        }
        jacobian[(3, 0)] = cos;
        jacobian[(4, 0)] = sin;
        jacobian
    }

    proptest! {
        #[test]
        fn jacobians_agree_with_central_differences(
            sideslip in -0.15..0.15f64, yaw in -3.0..3.0f64, yaw_rate in -0.8..0.8f64,
            speed in 0.1..1.0f64, is_backwards in any::<bool>(), steering in -0.06..0.06f64,
        ) {
            let velocity = if is_backwards { -speed } else { speed };
            let parameters = Parameters::default();
            let state = State { sideslip, yaw, yaw_rate, x: 1.0, y: 0.2 };
            let control = Control { velocity, steering };
            let step = 1e-6;
            let by_state = state_jacobian(&parameters, &state, &control);
            for column in 0..5 {
                let mut offset = SVector::<f64, 5>::zeros();
                offset[column] = step;
                let ahead = State::from_vector(&(state.to_vector() + offset));
                let behind = State::from_vector(&(state.to_vector() - offset));
                let difference = (derivative(&parameters, &ahead, &control)
                    - derivative(&parameters, &behind, &control)) / (2.0 * step);
                // Largest derivative is about 3500 at 0.1 m/s; central differences keep eight digits.
                prop_assert!((by_state.column(column) - difference).amax() < 1e-5 * (1.0 + difference.amax()));
            }
            let by_control = control_jacobian(&parameters, &state, &control);
            for column in 0..2 {
                let offset = if column == 0 { [step, 0.0] } else { [0.0, step] };
                let shift = |sign: f64| Control {
                    velocity: velocity + sign * offset[0], steering: steering + sign * offset[1],
                };
                let difference = (derivative(&parameters, &state, &shift(1.0))
                    - derivative(&parameters, &state, &shift(-1.0))) / (2.0 * step);
                prop_assert!((by_control.column(column) - difference).amax() < 1e-5 * (1.0 + difference.amax()));
            }
        }
    }

    #[test]
    fn eigenvalues_of_the_lateral_motion_are_those_of_the_analysis() {
        let (jacobian, _) =
            lateral_jacobians(&Parameters::default(), 0.0, 0.0, &Control { velocity: 1.0, steering: 0.0 });
        let trace = jacobian[0][0] + jacobian[1][1];
        assert!((trace / 2.0 + 34.0).abs() < 0.2, "{trace}");
    }

    #[test]
    fn a_steady_turn_has_no_lateral_acceleration_and_the_known_gain() {
        let control = Control { velocity: 1.0, steering: 0.06 };
        let parameters = Parameters::default();
        let (sideslip, yaw_rate) = steady_turn(&parameters, &control);
        let [sideslip_rate, yaw_acceleration] = lateral(&parameters, sideslip, yaw_rate, &control);
        assert!(sideslip_rate.abs() < 1e-3 && yaw_acceleration.abs() < 1e-9);
        assert!((yaw_rate / 0.06 - 5.397).abs() < 0.08, "{}", yaw_rate / 0.06);
        assert!((1.0 / yaw_rate - 3.10).abs() < 0.05);
    }
}
