//! The lateral motion of any vehicle with two axles, and its derivatives.
//!
//! An axle at the distance a ahead of the centre of mass, which turns by s u2, has the slip angle s u2 - x1 - a x3 / u1 and the
//! force c cos(s u2) times it. The sum of both forces over m u1 cos(x1), less x3, is the rate of the sideslip, and the sum of
//! their moments over J is the yaw acceleration. With s = 1 in front and -1 behind these are (7.27) and (7.29).
//!
//! Variables are ordered (sideslip, yaw rate, velocity, steering).

use crate::{Control, Parameters};

/// A number with its first and second derivatives.
#[derive(Debug, Clone, Copy, Default)]
struct Jet {
    value: f64,
    by: [f64; 4],
    twice: [[f64; 4]; 4],
}

impl Jet {
    fn times(&self, other: &Self) -> Self {
        let mut product = Self { value: self.value * other.value, ..Self::default() };
        for row in 0..4 {
            product.by[row] = self.by[row] * other.value + self.value * other.by[row];
            for column in 0..4 {
                product.twice[row][column] = self.twice[row][column] * other.value
                    + self.by[row] * other.by[column]
                    + self.by[column] * other.by[row]
                    + self.value * other.twice[row][column];
            }
        }
        product
    }

    fn plus(&self, other: &Self, share: f64) -> Self {
        let mut sum = *self;
        sum.value += share * other.value;
        for row in 0..4 {
            sum.by[row] += share * other.by[row];
            for column in 0..4 {
                sum.twice[row][column] += share * other.twice[row][column];
            }
        }
        sum
    }
}

/// Rates of sideslip and yaw rate, by value alone.
pub(crate) fn lateral(
    parameters: &Parameters,
    shares: [f64; 2],
    [sideslip, yaw_rate]: [f64; 2],
    cosine: f64,
    control: &Control,
) -> [f64; 2] {
    let Control { velocity, steering } = *control;
    let (stiffness, curvature) = (parameters.stiffness_at(velocity), yaw_rate / velocity);
    let arms = [parameters.front_m, -parameters.rear_m];
    let force = |axle: usize| {
        let turned = shares[axle] * steering;
        stiffness * turned.cos() * (turned - sideslip - arms[axle] * curvature)
    };
    let [front, rear] = [force(0), force(1)];
    [
        (front + rear) / (parameters.mass_kg * velocity * cosine) - yaw_rate,
        (front * arms[0] + rear * arms[1]) / parameters.inertia_kgm2,
    ]
}

/// Gradients of the rates of sideslip and yaw rate, and the second derivatives of their sum with `weights`.
pub(crate) fn derivatives(
    parameters: &Parameters,
    shares: [f64; 2],
    [sideslip, yaw_rate]: [f64; 2],
    control: &Control,
    weights: [f64; 2],
) -> ([[f64; 4]; 2], [[f64; 4]; 4]) {
    let Control { velocity, steering } = *control;
    let inverse = 1.0 / velocity;
    let axle = |arm: f64, share: f64| {
        let turn = arm * yaw_rate * inverse * inverse;
        let mut slip = Jet {
            value: share * steering - sideslip - turn * velocity,
            by: [-1.0, -arm * inverse, turn, share],
            ..Jet::default()
        };
        slip.twice[1][2] = arm * inverse * inverse;
        slip.twice[2][1] = slip.twice[1][2];
        slip.twice[2][2] = -2.0 * turn * inverse;
        let (sin, cos) = (share * steering).sin_cos();
        let stiffness = parameters.stiffness_at(velocity);
        let mut force = Jet { value: stiffness * cos, ..Jet::default() };
        force.by[3] = -share * stiffness * sin;
        force.twice[3][3] = -share * share * stiffness * cos;
        force.times(&slip)
    };
    let [front, rear] = [axle(parameters.front_m, shares[0]), axle(-parameters.rear_m, shares[1])];
    // 1 / (m u1 cos(x1)).
    let tangent = sideslip.tan();
    let mobility = inverse / (parameters.mass_kg * sideslip.cos());
    let mut yielding = Jet { value: mobility, ..Jet::default() };
    (yielding.by[0], yielding.by[2]) = (mobility * tangent, -mobility * inverse);
    yielding.twice[0][0] = mobility * (1.0 + 2.0 * tangent * tangent);
    yielding.twice[0][2] = -mobility * tangent * inverse;
    yielding.twice[2][0] = yielding.twice[0][2];
    yielding.twice[2][2] = 2.0 * mobility * inverse * inverse;
    let mut sideslip_rate = front.plus(&rear, 1.0).times(&yielding);
    sideslip_rate.by[1] -= 1.0;
    let agility = 1.0 / parameters.inertia_kgm2;
    let acceleration =
        Jet::default().plus(&front, parameters.front_m * agility).plus(&rear, -parameters.rear_m * agility);
    let sum = Jet::default().plus(&sideslip_rate, weights[0]).plus(&acceleration, weights[1]);
    ([sideslip_rate.by, acceleration.by], sum.twice)
}

/// Steady sideslip and yaw rate under a constant control, for small angles.
pub(crate) fn steady_turn(parameters: &Parameters, shares: [f64; 2], control: &Control) -> (f64, f64) {
    let Control { velocity, steering } = *control;
    let Parameters { mass_kg, rear_m, front_m, .. } = *parameters;
    let sum = rear_m + front_m;
    let [front, rear] = shares.map(|share| parameters.stiffness_at(velocity) * (share * steering).cos());
    // Slip angles per curvature of axles that carry the centrifugal force m u1^2 without a moment.
    let centrifugal = mass_kg * velocity * velocity / sum;
    let [front_slip, rear_slip] = [centrifugal * rear_m / front, centrifugal * front_m / rear];
    let curvature = (shares[0] - shares[1]) * steering / (sum + front_slip - rear_slip);
    (shares[1] * steering + (rear_m - rear_slip) * curvature, velocity * curvature)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::{integrate, stiff_step};
    use crate::lateral::Lateral;
    use crate::model::{self, lateral_derivatives, lateral_jacobians};
    use crate::tyre::derivative_with_friction;
    use crate::{State, VehicleModel};
    use proptest::prelude::*;

    const SUMMIT: [f64; 2] = [1.0, -1.0];

    fn any_model() -> impl Strategy<Value = Parameters> {
        use VehicleModel::{Bicycle, CounterSteered, Differential, RearSteered};
        prop::sample::select(vec![CounterSteered, Bicycle, RearSteered, Differential])
            .prop_map(|model| Parameters { model, ..Parameters::default() })
    }

    fn any_state() -> impl Strategy<Value = ([f64; 2], Control)> {
        (-0.15..0.15f64, -0.8..0.8f64, 0.2..3.0f64, any::<bool>(), -0.6..0.6f64).prop_map(
            |(sideslip, yaw_rate, speed, is_backwards, steering)| {
                let velocity = if is_backwards { -speed } else { speed };
                ([sideslip, yaw_rate], Control { velocity, steering })
            },
        )
    }

    fn near(one: f64, other: f64, share: f64) -> bool {
        (one - other).abs() <= share * (1.0 + one.abs().max(other.abs()))
    }

    proptest! {
        #[test]
        fn with_axles_that_steer_against_each_other_it_is_the_printed_model((state, control) in any_state()) {
            let parameters = Parameters::default();
            let printed = model::lateral(&parameters, state[0], state[1], &control);
            let ours = lateral(&parameters, SUMMIT, state, state[0].cos(), &control);
            let (by_state, by_control) = lateral_jacobians(&parameters, state[0], state[1], &control);
            let (by, _) = derivatives(&parameters, SUMMIT, state, &control, [0.0; 2]);
            for row in 0..2 {
                prop_assert!(near(ours[row], printed[row], 1e-10));
                for column in 0..2 {
                    prop_assert!(near(by[row][column], by_state[row][column], 1e-10));
                    prop_assert!(near(by[row][2 + column], by_control[row][column], 1e-10));
                }
            }
            let ((sideslip, yaw_rate), printed) =
                (steady_turn(&parameters, SUMMIT, &control), model::steady_turn(&parameters, &control));
            prop_assert!(near(sideslip, printed.0, 1e-10) && near(yaw_rate, printed.1, 1e-10));
        }

        #[test]
        fn derivatives_of_each_model_agree_with_central_differences(
            parameters in any_model(), (state, control) in any_state(), weights in prop::array::uniform2(-2.0..2.0f64),
        ) {
            let at = |variable: usize, step: f64| {
                let mut values = [state[0], state[1], control.velocity, control.steering];
                values[variable] += step;
                let control = Control { velocity: values[2], steering: values[3] };
                let rates = model::lateral(&parameters, values[0], values[1], &control);
                (rates, lateral_derivatives(&parameters, values[0], values[1], &control, weights).0)
            };
            let (by, twice) = lateral_derivatives(&parameters, state[0], state[1], &control, weights);
            let step = 1e-6;
            for variable in 0..4 {
                let ((after, by_after), (before, by_before)) = (at(variable, step), at(variable, -step));
                for row in 0..2 {
                    let slope = (after[row] - before[row]) / (2.0 * step);
                    prop_assert!(near(by[row][variable], slope, 1e-5), "{row} {variable}: {by:?} {slope}");
                }
                for other in 0..4 {
                    let sum = |by: [[f64; 4]; 2]| weights[0] * by[0][other] + weights[1] * by[1][other];
                    let slope = (sum(by_after) - sum(by_before)) / (2.0 * step);
                    prop_assert!(near(twice[other][variable], slope, 1e-5), "{other} {variable}: {slope}");
                }
            }
        }

        /// In a step of 20 ms, over which the slow eigenvalue has decayed by a half at most.
        #[test]
        fn the_closed_form_of_each_model_moves_as_it_is_integrated(
            parameters in any_model(), (state, control) in any_state(),
        ) {
            let start = State { sideslip: state[0], yaw_rate: state[1], ..State::default() };
            let fine = integrate(&parameters, &start, &control, 0.02);
            let stiff = stiff_step(&parameters, 0.0, &start, &control, control.velocity, 0.02);
            // The cosine of the sideslip is constant in parts of the stiff step.
            prop_assert!((fine.to_vector() - stiff.to_vector()).amax() < 2e-3, "{fine:?} {stiff:?}");
            let lateral = Lateral::new(&parameters, [parameters.stiffness_n_per_rad; 2], &control, 1.0);
            let ([sideslip, yaw_rate], _) = lateral.equilibrium();
            let rates = model::lateral(&parameters, sideslip, yaw_rate, &control);
            // 1.0 stands for the cosine of the sideslip.
            let slack = 1e-6 + 2.0 * (1.0 / sideslip.cos().max(0.1) - 1.0) * 250.0;
            prop_assert!(rates[0].abs() <= slack && rates[1].abs() < 1e-6, "{rates:?}");
        }

        #[test]
        fn each_model_turned_round_is_itself_driven_backwards(
            parameters in any_model(), (state, control) in any_state(),
        ) {
            let state = State { sideslip: state[0], yaw: 0.4, yaw_rate: state[1], x: 1.0, y: 2.0 };
            let rates = model::derivative(&parameters, &state, &control);
            let turned = model::derivative(&parameters.mirrored(), &state.mirrored(), &control.mirrored());
            prop_assert!((rates - turned).amax() < 1e-9 * (1.0 + rates.amax()), "{rates} {turned}");
            let slipping = |parameters, state: &State, control: Control| {
                derivative_with_friction(parameters, 0.8, state, control.velocity, control.steering)
            };
            let rates = slipping(&parameters, &state, control);
            let turned = slipping(&parameters.mirrored(), &state.mirrored(), control.mirrored());
            prop_assert!((rates - turned).amax() < 1e-9 * (1.0 + rates.amax()), "{rates} {turned}");
        }
    }

    #[test]
    fn a_slow_car_turns_about_the_point_where_its_axles_meet() {
        let car =
            Parameters { model: VehicleModel::Bicycle, front_m: 1.2, rear_m: 1.3, ..Parameters::default() };
        let control = Control { velocity: 0.05, steering: 0.5 };
        let (sideslip, yaw_rate) = model::steady_turn(&car, &control);
        // 0.5 rad over 2.5 m; the rear axle does not slip: 1.3 m of the radius of 5 m.
        assert!((yaw_rate / 0.05 - 0.2).abs() < 1e-3 && (sideslip - 1.3 * 0.2).abs() < 1e-3);
        assert!((car.curvature_of(0.5) - 0.2).abs() < 1e-12 && (car.steering_of(0.2) - 0.5).abs() < 1e-12);
        let end = integrate(&car, &State::default(), &Control { velocity: 1.0, steering: 0.1 }, 20.0);
        let (sideslip, yaw_rate) = model::steady_turn(&car, &Control { velocity: 1.0, steering: 0.1 });
        assert!((end.yaw_rate - yaw_rate).abs() < 1e-3 && (end.sideslip - sideslip).abs() < 1e-3);
    }

    #[test]
    fn a_differential_drive_follows_its_yaw_rate_with_a_lag_and_does_not_slip() {
        let parameters = Parameters {
            model: VehicleModel::Differential,
            front_m: 0.1,
            rear_m: 0.1,
            yaw_lag_s: 0.2,
            ..Parameters::default()
        };
        let control = Control { velocity: 0.2, steering: 0.5 };
        let end = integrate(&parameters, &State::default(), &control, 0.2);
        // 0.2 m/s * 0.5 rad / 0.2 m = 0.5 rad/s, of which one time constant leaves 1 / e.
        assert!((end.yaw_rate - 0.5 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9 && end.sideslip == 0.0);
        assert_eq!(parameters.mirrored().model, VehicleModel::Differential);
    }
}
