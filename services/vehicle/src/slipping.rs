//! The lateral motion on tyres that slip, in steps that are too long for an explicit method.
//!
//! Implicit Euler of the whole step and of its two halves, extrapolated: of second order and L-stable. The forces only ever
//! damp, so Newton's method finds its one solution, with steps that are halved until the residual falls. The cosine of the
//! sideslip is that at the beginning.

use crate::model::cosine_of;
use crate::tyre::{axle_force, axle_limits, inward, slip_angles};
use crate::{Control, Parameters, State};

/// Two are usual; a step that crosses from one limit of the friction to the other takes ten.
const NEWTON_STEPS: usize = 50;

/// Change of sideslip and yaw rate after which the next one is a rounding error: Newton's method squares it.
const TOLERANCE: f64 = 1e-9;

/// Smallest share of a step of Newton's method.
const MIN_SHARE: f64 = 1e-6;

/// The motion under one control.
struct Slipping<'a> {
    parameters: &'a Parameters,
    control: &'a Control,
    limits_n: [f64; 2],
    /// How the axles steer, and the shares of their forces across the body.
    shares: [f64; 2],
    inward: [f64; 2],
    /// Rates of the sideslip and of the yaw rate by a force and a moment.
    mobility: f64,
    agility: f64,
}

/// The state some seconds later, at the same place.
pub(crate) fn slipped(
    parameters: &Parameters,
    shares: [f64; 2],
    friction: f64,
    state: &State,
    control: &Control,
    seconds: f64,
) -> State {
    let cos = control.steering.cos();
    let motion = Slipping {
        parameters,
        control,
        limits_n: axle_limits(parameters, friction),
        shares,
        inward: inward(shares, control.steering),
        mobility: cos / (parameters.mass_kg * control.velocity * cosine_of(state.sideslip)),
        agility: cos / parameters.inertia_kgm2,
    };
    let start = [state.sideslip, state.yaw_rate];
    let whole = motion.implicit(start, seconds);
    let middle = motion.implicit(start, seconds / 2.0);
    let halves = motion.implicit(middle, seconds / 2.0);
    State {
        sideslip: 2.0 * halves[0] - whole[0],
        yaw_rate: 2.0 * halves[1] - whole[1],
        yaw: state.yaw + seconds * (middle[1] + halves[1] - whole[1]),
        ..*state
    }
    .bounded()
}

impl Slipping<'_> {
    /// A step of implicit Euler.
    fn implicit(&self, start: [f64; 2], seconds: f64) -> [f64; 2] {
        let mut at = start;
        let (mut residual, mut change) = self.newton(start, at, seconds);
        for _ in 0..NEWTON_STEPS {
            let mut share = 1.0;
            loop {
                let next = [at[0] + share * change[0], at[1] + share * change[1]];
                let (found, further) = self.newton(start, next, seconds);
                if found <= (1.0 - 1e-4 * share) * residual || share < MIN_SHARE {
                    (at, residual, change) = (next, found, further);
                    break;
                }
                share /= 2.0;
            }
            if change[0].abs().max(change[1].abs()) <= TOLERANCE || !residual.is_finite() {
                break;
            }
        }
        at
    }

    /// Size of the residual at a place, as an angle, and the step of Newton's method from there.
    fn newton(&self, start: [f64; 2], at: [f64; 2], seconds: f64) -> (f64, [f64; 2]) {
        let Self { parameters, control, limits_n, shares, inward, mobility, agility } = self;
        let Parameters { rear_m, front_m, .. } = **parameters;
        let velocity = control.velocity;
        let stiffness = parameters.stiffness_at(velocity);
        let state = State { sideslip: at[0], yaw_rate: at[1], ..State::default() };
        let slips = slip_angles(parameters, *shares, &state, control);
        let forces = [0, 1].map(|axle| axle_force(stiffness, slips[axle], limits_n[axle]));
        let [front, rear] = [0, 1]
            .map(|axle| inward[axle] * stiffness * (1.0 - (forces[axle] / limits_n[axle]).powi(2)).max(0.0));
        let forces = [0, 1].map(|axle| inward[axle] * forces[axle]);
        let (move_s, turn_s) = (mobility * seconds, agility * seconds);
        let residual = [
            at[0] - start[0] - move_s * (forces[0] + forces[1]) + seconds * at[1],
            at[1] - start[1] - turn_s * (forces[0] * front_m - forces[1] * rear_m),
        ];
        let (couple, sum) = (front * front_m - rear * rear_m, front_m + rear_m);
        let damping = (front * front_m * front_m + rear * rear_m * rear_m) / velocity;
        let matrix = [
            [1.0 + move_s * (front + rear), move_s * couple / velocity + seconds],
            [turn_s * couple, 1.0 + turn_s * damping],
        ];
        // Multiplied out: the squares of a stiff axle cancel in the product of the entries.
        let determinant = 1.0
            + move_s * (front + rear)
            + turn_s * damping
            + move_s * turn_s * front * rear * sum * sum / velocity
            - seconds * turn_s * couple;
        let change = [
            (residual[1] * matrix[0][1] - residual[0] * matrix[1][1]) / determinant,
            (residual[0] * matrix[1][0] - residual[1] * matrix[0][0]) / determinant,
        ];
        (residual[0].abs() + residual[1].abs() * rear_m.max(front_m) / velocity.abs(), change)
    }
}
