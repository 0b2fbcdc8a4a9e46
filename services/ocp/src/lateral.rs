//! The lateral motion of the robot, (7.27) and (7.29), in the form that the solver needs.
//!
//! An interval evaluates it at several stages under one control, so the sine and cosine of the steering angle and
//! the divisions by the velocity are shared. The formulas are those of [`vehicle::model`], which is the oracle of
//! the tests here. Other models than the counter-steered one are computed by those.

use vehicle::{Control, Parameters, VehicleModel, model};

use crate::model::{LateralModel, LateralSlope};
use crate::trig::sin_cos;

impl LateralModel for Parameters {
    fn is_sound(&self) -> bool {
        let Self { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, yaw_lag_s, .. } = *self;
        [mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, yaw_lag_s]
            .into_iter()
            .all(|value| value > 0.0 && value.is_finite())
    }

    fn slopes(&self, control: [f64; 2], states: &[[f64; 2]], slopes: &mut [LateralSlope]) {
        if self.model != VehicleModel::CounterSteered {
            let [velocity, steering] = control;
            let control = Control { velocity, steering };
            for (slope, [sideslip, yaw_rate]) in slopes.iter_mut().zip(states) {
                let (by_state, by_control) = model::lateral_jacobians(self, *sideslip, *yaw_rate, &control);
                let value = model::lateral(self, *sideslip, *yaw_rate, &control);
                *slope = LateralSlope { value, by_state, by_control };
            }
            return;
        }
        let lateral = Lateral::new(self, control);
        for (slope, state) in slopes.iter_mut().zip(states) {
            *slope = lateral.slope(*state);
        }
    }

    fn curvature(
        &self,
        [velocity, steering]: [f64; 2],
        [sideslip, yaw_rate]: [f64; 2],
        weights: [f64; 2],
    ) -> [[f64; 4]; 4] {
        if self.model != VehicleModel::CounterSteered {
            let control = Control { velocity, steering };
            return model::lateral_derivatives(self, sideslip, yaw_rate, &control, weights).1;
        }
        let Self { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, .. } = *self;
        let (sin, cos) = steering.sin_cos();
        let (sum, difference) = (rear_m + front_m, rear_m - front_m);
        let square = rear_m * rear_m + front_m * front_m;
        let inverse = 1.0 / velocity;
        let inverse2 = inverse * inverse;

        // (7.27) is force * cos(u2) * slip(x1, x3, u1) * secant(x1) - x3 with slip = -2 x1 / u1 + (lh - lv) x3 / u1^2.
        let secant = 1.0 / sideslip.cos();
        let tangent = sideslip.tan();
        let secant1 = secant * tangent;
        let secant2 = secant * (1.0 + 2.0 * tangent * tangent);
        let turn = difference * yaw_rate * inverse2;
        let slip = -2.0 * sideslip * inverse + turn;
        let slip_sideslip = -2.0 * inverse;
        let slip_rate = difference * inverse2;
        let slip_velocity = (2.0 * sideslip * inverse - 2.0 * turn) * inverse;
        let slip_sideslip_velocity = 2.0 * inverse2;
        let slip_rate_velocity = -2.0 * slip_rate * inverse;
        let slip_velocity2 = (6.0 * turn - 4.0 * sideslip * inverse) * inverse2;
        let force = weights[0] * stiffness_n_per_rad / mass_kg;
        let (force_cos, force_sin) = (force * cos, -force * sin);

        // (7.29) is torque * cos(u2) * (u2 (lh + lv) + x1 (lh - lv) - x3 (lh^2 + lv^2) / u1).
        let torque = weights[1] * stiffness_n_per_rad / inertia_kgm2;
        let spin = square * inverse;
        let moment = steering * sum + sideslip * difference - yaw_rate * spin;

        let sideslip_velocity = force_cos * (slip_sideslip_velocity * secant + slip_velocity * secant1);
        let sideslip_rate = force_cos * slip_rate * secant1;
        let sideslip_steering =
            force_sin * (slip_sideslip * secant + slip * secant1) - torque * sin * difference;
        let rate_velocity = force_cos * slip_rate_velocity * secant + torque * cos * spin * inverse;
        let rate_steering = force_sin * slip_rate * secant + torque * sin * spin;
        let velocity_steering = force_sin * slip_velocity * secant - torque * sin * yaw_rate * spin * inverse;
        [
            [
                force_cos * (2.0 * slip_sideslip * secant1 + slip * secant2),
                sideslip_rate,
                sideslip_velocity,
                sideslip_steering,
            ],
            [sideslip_rate, 0.0, rate_velocity, rate_steering],
            [
                sideslip_velocity,
                rate_velocity,
                force_cos * slip_velocity2 * secant - 2.0 * torque * cos * yaw_rate * spin * inverse2,
                velocity_steering,
            ],
            [
                sideslip_steering,
                rate_steering,
                velocity_steering,
                -force_cos * slip * secant - torque * (cos * moment + 2.0 * sin * sum),
            ],
        ]
    }
}

/// Derivatives of (sideslip, yaw rate) under one control.
#[derive(Debug, Clone, Copy)]
struct Lateral {
    /// c cos(u2) / (m u1).
    damping: f64,
    /// c cos(u2) / J.
    torque: f64,
    /// (lh - lv) / u1.
    difference_per_velocity: f64,
    /// lh - lv.
    difference: f64,
    /// (lh^2 + lv^2) / u1.
    square_per_velocity: f64,
    /// u2 (lh + lv).
    lever: f64,
    /// lh + lv.
    sum: f64,
    /// tan(u2).
    tangent: f64,
    /// 1 / u1.
    per_velocity: f64,
}

impl Lateral {
    /// The stiff part under a control (velocity, steering).
    fn new(parameters: &Parameters, control: [f64; 2]) -> Self {
        let Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, .. } = *parameters;
        let (sin, cos) = sin_cos(control[1]);
        let per_velocity = 1.0 / control[0];
        let force = stiffness_n_per_rad * cos;
        let (sum, difference) = (rear_m + front_m, rear_m - front_m);
        Self {
            damping: force * per_velocity / mass_kg,
            torque: force / inertia_kgm2,
            difference_per_velocity: difference * per_velocity,
            difference,
            square_per_velocity: (rear_m * rear_m + front_m * front_m) * per_velocity,
            lever: control[1] * sum,
            sum,
            tangent: sin / cos,
            per_velocity,
        }
    }

    /// Derivatives of (sideslip, yaw rate), (7.27) and (7.29), with their Jacobians.
    fn slope(&self, [sideslip, yaw_rate]: [f64; 2]) -> LateralSlope {
        let (sin, cos) = sin_cos(sideslip);
        let damping = self.damping / cos;
        let turn = self.difference_per_velocity * yaw_rate;
        let slip = turn - 2.0 * sideslip;
        let spin = yaw_rate * self.square_per_velocity;
        let moment = self.lever + sideslip * self.difference - spin;
        LateralSlope {
            value: [damping * slip - yaw_rate, self.torque * moment],
            by_state: [
                [damping * (slip * sin / cos - 2.0), damping * self.difference_per_velocity - 1.0],
                [self.torque * self.difference, -self.torque * self.square_per_velocity],
            ],
            by_control: [
                [-damping * (slip + turn) * self.per_velocity, -self.tangent * damping * slip],
                [self.torque * spin * self.per_velocity, self.torque * (self.sum - self.tangent * moment)],
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_model_of_the_vehicle(
            sideslip in -0.4..0.4f64, yaw_rate in -1.0..1.0f64, velocity in 0.1..1.0f64, steering in -0.1..0.1f64,
        ) {
            let parameters = Parameters::default();
            let control = Control { velocity, steering };
            let slope = Lateral::new(&parameters, [velocity, steering]).slope([sideslip, yaw_rate]);
            let expected = model::lateral(&parameters, sideslip, yaw_rate, &control);
            let (by_state, by_control) = model::lateral_jacobians(&parameters, sideslip, yaw_rate, &control);
            // Only the order of the roundings differs; the largest entries are about 4000.
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-12 * (1.0 + a.abs().max(b.abs()));
            for row in 0..2 {
                prop_assert!(near(slope.value[row], expected[row]));
                for column in 0..2 {
                    prop_assert!(near(slope.by_state[row][column], by_state[row][column]));
                    prop_assert!(near(slope.by_control[row][column], by_control[row][column]));
                }
            }
        }
    }
}
