//! Lateral forces of tyres that slip: linear for small slip angles as in (7.27) and (7.29), limited by friction.

use nalgebra::SVector;

use crate::model::{cosine_of, derivative_at, lateral_velocity};
use crate::{Control, Parameters, State};

/// Gravity [m/s^2].
pub const GRAVITY_MPS2: f64 = 9.81;

/// Lateral force of an axle [N]: mu Fz tanh(c alpha / (mu Fz)); c is negative backwards, [`Parameters::stiffness_at`].
pub fn axle_force(stiffness_n_per_rad: f64, slip_rad: f64, limit_n: f64) -> f64 {
    limit_n * (stiffness_n_per_rad * slip_rad / limit_n).tanh()
}

/// Largest lateral forces of the front and the rear axle [N], mu Fz.
pub fn axle_limits(parameters: &Parameters, friction: f64) -> [f64; 2] {
    let Parameters { mass_kg, rear_m, front_m, .. } = *parameters;
    let per_metre = friction * mass_kg * GRAVITY_MPS2 / (rear_m + front_m);
    [per_metre * rear_m, per_metre * front_m]
}

/// [`derivative_at`] with tyres of this friction coefficient; with 0 the forces have no limit.
pub fn derivative_with_friction(
    parameters: &Parameters,
    friction: f64,
    state: &State,
    speed: f64,
    steering: f64,
) -> SVector<f64, 5> {
    let mut rates = derivative_at(parameters, state, speed, steering);
    if let Some(shares) = parameters.model.shares().filter(|_| friction > 0.0) {
        [rates[0], rates[2]] =
            lateral(parameters, shares, friction, state, lateral_velocity(speed), steering);
    }
    rates
}

/// Derivatives of sideslip and yaw rate, as (7.27) and (7.29) before the forces are made linear.
fn lateral(
    parameters: &Parameters,
    shares: [f64; 2],
    friction: f64,
    state: &State,
    speed: f64,
    steering: f64,
) -> [f64; 2] {
    let Parameters { mass_kg, rear_m, front_m, inertia_kgm2, .. } = *parameters;
    let State { sideslip, yaw_rate, .. } = *state;
    let stiffness = parameters.stiffness_at(speed);
    let slips = slip_angles(parameters, shares, state, &Control { velocity: speed, steering });
    let limits = axle_limits(parameters, friction);
    let inward = inward(shares, steering);
    let [front, rear] = [0, 1].map(|axle| inward[axle] * axle_force(stiffness, slips[axle], limits[axle]));
    let cos = steering.cos();
    [
        cos * (front + rear) / (mass_kg * speed * cosine_of(sideslip)) - yaw_rate,
        cos * (front * front_m - rear * rear_m) / inertia_kgm2,
    ]
}

/// Shares of the forces of both axles across the body, of cos(u2): 1 for those that steer by u2.
pub(crate) fn inward(shares: [f64; 2], steering: f64) -> [f64; 2] {
    shares.map(|share| (share * steering).cos() / steering.cos())
}

/// Slip angles of the front and the rear axle [rad].
pub(crate) fn slip_angles(
    parameters: &Parameters,
    shares: [f64; 2],
    state: &State,
    control: &Control,
) -> [f64; 2] {
    let State { sideslip, yaw_rate, .. } = *state;
    let Control { velocity, steering } = *control;
    let curvature = yaw_rate / velocity;
    [
        shares[0] * steering - sideslip - parameters.front_m * curvature,
        shares[1] * steering - sideslip + parameters.rear_m * curvature,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::VehicleModel;

    const SUMMIT: Parameters = Parameters {
        mass_kg: 14.695,
        rear_m: 0.1924,
        front_m: 0.1776,
        stiffness_n_per_rad: 250.0,
        inertia_kgm2: 0.5024,
        model: VehicleModel::CounterSteered,
        yaw_lag_s: 0.1,
    };

    #[test]
    fn the_force_is_linear_for_small_slip_and_saturates_at_mu_fz() {
        // tanh z = z - z^3 / 3: at z = 250 * 0.001 / 50 = 0.005 the share that is missing is 8.3e-6.
        assert!((axle_force(250.0, 1e-3, 50.0) - 0.25 * (1.0 - 0.005_f64.powi(2) / 3.0)).abs() < 1e-9);
        assert!((axle_force(250.0, 0.2, 50.0) - 50.0 * 1.0_f64.tanh()).abs() < 1e-12);
        assert!((axle_force(250.0, -3.0, 50.0) + 50.0).abs() < 1e-4);
    }

    #[test]
    fn the_axles_share_the_weight_by_the_distance_of_the_other_one() {
        let [front, rear] = axle_limits(&SUMMIT, 0.8);
        assert!((front + rear - 0.8 * 14.695 * 9.81).abs() < 1e-12);
        assert!((front * 0.1776 - rear * 0.1924).abs() < 1e-12, "no moment about the centre of mass");
    }

    #[test]
    fn for_small_slip_the_model_is_the_linear_one_and_for_large_slip_it_is_not() {
        let rates = |scale: f64| {
            let state = State { sideslip: 0.1 * scale, yaw_rate: 0.3 * scale, yaw: 0.4, ..State::default() };
            let with = derivative_with_friction(&SUMMIT, 0.8, &state, 0.7, 0.06 * scale);
            (with, derivative_at(&SUMMIT, &state, 0.7, 0.06 * scale))
        };
        let (with, without) = rates(1e-3);
        // Slip angles up to 2e-4 rad: z up to 1e-3, the share that is missing up to 4e-7.
        assert!((with - without).amax() < 1e-6 * without.amax(), "{with} {without}");
        let (with, without) = rates(1.0);
        assert!((with - without).amax() > 0.01 * without.amax());
        let (_, unlimited) = rates(1.0);
        let state = State { sideslip: 0.1, yaw_rate: 0.3, yaw: 0.4, ..State::default() };
        assert_eq!(derivative_with_friction(&SUMMIT, 0.0, &state, 0.7, 0.06), unlimited);
    }

    #[test]
    fn a_robot_that_slides_sideways_decelerates_at_mu_g() {
        let state = State { sideslip: -1.0, ..State::default() };
        let [sideslip_rate, _] = lateral(&SUMMIT, [1.0, -1.0], 0.8, &state, 1.0, 0.0);
        // Both axles at their limits: mu g / (v cos(sideslip)).
        assert!((sideslip_rate * 1.0_f64.cos() - 0.8 * 9.81).abs() < 0.05, "{sideslip_rate}");
    }
}
