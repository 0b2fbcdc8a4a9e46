//! The trajectory of the robot under a sequence of controls, integrated independently of the solver.
//!
//! Under a constant control (sideslip, yaw rate) are a linear system, except for the cosine of the sideslip, which is taken
//! at the equilibrium of the control. So their motion is known in closed form at every velocity, however stiff it is; yaw
//! is its integral, and the position follows by Simpson's rule. The error of a steering jump from lock to lock is below
//! 1 mm over the horizon (test), a tenth of what verification allows.
//!
//! Over the vehicles that may be described, that form cancels where the eigenvalues are far apart or nearly zero, and grows
//! where the robot is unstable. There [`vehicle::integrate::stiff_step`] takes over, which is the same solution computed
//! without a cancellation.

use std::ops::RangeInclusive;

use vehicle::integrate::stiff_step;
use vehicle::lateral::Lateral;
use vehicle::{Control, Parameters, State, VehicleModel};

use crate::sampled::Sampled;
use crate::scene::Scene;

/// Samples per interval: 5 cm apart at 1 m/s and 0.45 s.
pub(crate) const PIECES: usize = 9;

/// Longest step [s]: within it the course at three points is enough for the position.
const MAX_STEP_S: f64 = 0.06;

/// Eigenvalues for which the closed form here keeps ten digits over a step [1/s].
const USUAL_RATES: RangeInclusive<f64> = 1.0..=1e5;

/// Share of the faster eigenvalue that the slower one has at least, for the same digits.
const USUAL_SPREAD: f64 = 1e-4;

/// Largest sideslip of an equilibrium whose cosine is that of the motion towards it [rad].
const USUAL_SIDESLIP_RAD: f64 = 0.5;

/// The state after `duration` seconds under a constant control.
#[must_use]
pub(crate) fn advance(parameters: &Parameters, state: &State, control: &Control, duration: f64) -> State {
    let mut direction = direction(state);
    Motion::new(parameters, control, duration).advance(state, &mut direction)
}

/// The same of a state on the course of a scene.
#[must_use]
pub(crate) fn advance_on_course(scene: &Scene, state: &State, control: &Control, duration: f64) -> State {
    let (course, parameters) = (&scene.config.course, scene.config.vehicle.parameters());
    course.on_course(&advance(&parameters, &course.in_plane(state), control, duration), state.x)
}

/// The motion under a constant control, in steps of equal length.
#[derive(Debug, Clone, Copy)]
struct Motion {
    /// How many steps one piece takes.
    steps: usize,
    /// Half the length of a step [s].
    half: f64,
    velocity: f64,
    /// (sideslip, yaw rate) at which they do not change.
    equilibrium: [f64; 2],
    /// How much of the distance to the equilibrium is left after half a step.
    decay: [[f64; 2]; 2],
    /// Yaw over half a step by the distance to the equilibrium at its start.
    turn: [f64; 2],
    /// The robot and its control, where the form above is not exact.
    unusual: Option<(Parameters, Control)>,
}

impl Motion {
    /// The motion over pieces of `duration` seconds.
    fn new(parameters: &Parameters, control: &Control, duration: f64) -> Self {
        let steps = (duration / MAX_STEP_S).ceil().clamp(1.0, 1e5);
        let half = duration / steps / 2.0;
        // The sideslip of the equilibrium for a cosine of 1 is exact enough for its cosine.
        let (first, _) = lateral(parameters, control, 1.0);
        let (equilibrium, matrix) = lateral(parameters, control, first[0].cos());
        let decay = exponential(&matrix, half);
        // The integral of exp(A t) is A^-1 (exp(A t) - I); only the row of the yaw rate is needed.
        let determinant = determinant(&matrix);
        let row = [-matrix[1][0] / determinant, matrix[0][0] / determinant];
        let turn = [
            row[0] * (decay[0][0] - 1.0) + row[1] * decay[1][0],
            row[0] * decay[0][1] + row[1] * (decay[1][1] - 1.0),
        ];
        let is_usual = first[0].abs() <= USUAL_SIDESLIP_RAD && is_usual(parameters, control);
        let unusual = (!is_usual).then_some((*parameters, *control));
        Self { steps: steps as usize, half, velocity: control.velocity, equilibrium, decay, turn, unusual }
    }

    /// The state one piece later; `direction` is the cosine and sine of the course.
    fn advance(&self, state: &State, direction: &mut [f64; 2]) -> State {
        let mut state = *state;
        for _ in 0..self.steps {
            if let Some((parameters, control)) = &self.unusual {
                state = stiff_step(parameters, 0.0, &state, control, self.velocity, 2.0 * self.half);
                *direction = self::direction(&state);
                continue;
            }
            let before = *direction;
            let way = self.velocity * self.half / 3.0;
            self.turn(&mut state);
            let middle = self::direction(&state);
            self.turn(&mut state);
            *direction = self::direction(&state);
            state.x += way * (before[0] + 4.0 * middle[0] + direction[0]);
            state.y += way * (before[1] + 4.0 * middle[1] + direction[1]);
        }
        state
    }

    /// Half a step of all but the position.
    #[inline]
    fn turn(&self, state: &mut State) {
        let Self { equilibrium, decay, turn, half, .. } = self;
        let (sideslip, yaw_rate) = (state.sideslip - equilibrium[0], state.yaw_rate - equilibrium[1]);
        state.yaw += equilibrium[1] * half + turn[0] * sideslip + turn[1] * yaw_rate;
        state.sideslip = equilibrium[0] + decay[0][0] * sideslip + decay[0][1] * yaw_rate;
        state.yaw_rate = equilibrium[1] + decay[1][0] * sideslip + decay[1][1] * yaw_rate;
    }
}

/// Whether the eigenvalues are stable and near enough for [`exponential`].
fn is_usual(parameters: &Parameters, control: &Control) -> bool {
    let lateral = Lateral::new(parameters, [parameters.stiffness_n_per_rad; 2], control, 1.0);
    let [fast, slow] = lateral.rates();
    lateral.is_stable() && USUAL_RATES.contains(&fast) && slow >= USUAL_SPREAD * fast
}

/// Cosine and sine of the course.
#[inline]
fn direction(state: &State) -> [f64; 2] {
    let (sin, cos) = (state.yaw + state.sideslip).sin_cos();
    [cos, sin]
}

/// (7.27) and (7.29) as a linear system with this cosine of the sideslip: its equilibrium and its matrix.
fn lateral(parameters: &Parameters, control: &Control, cosine: f64) -> ([f64; 2], [[f64; 2]; 2]) {
    if parameters.model != VehicleModel::CounterSteered {
        return Lateral::new(parameters, [parameters.stiffness_n_per_rad; 2], control, cosine).equilibrium();
    }
    let Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, .. } = *parameters;
    let Control { velocity, steering } = *control;
    let force = stiffness_n_per_rad * steering.cos();
    let (damping, torque) = (force / (mass_kg * velocity * cosine), force / inertia_kgm2);
    let (difference, square) = (rear_m - front_m, rear_m * rear_m + front_m * front_m);
    let matrix = [
        [-2.0 * damping, damping * difference / velocity - 1.0],
        [torque * difference, -torque * square / velocity],
    ];
    // The constant part is a yaw acceleration.
    let acceleration = torque * steering * (rear_m + front_m) / determinant(&matrix);
    ([matrix[0][1] * acceleration, -matrix[0][0] * acceleration], matrix)
}

fn determinant(matrix: &[[f64; 2]; 2]) -> f64 {
    matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]
}

/// exp(`matrix` `t`) from its eigenvalues `mean` plus and minus the root of `square`.
fn exponential(matrix: &[[f64; 2]; 2], t: f64) -> [[f64; 2]; 2] {
    let mean = f64::midpoint(matrix[0][0], matrix[1][1]);
    let square = mean * mean - determinant(matrix);
    let (common, skew) = if square > 1e-12 * mean * mean {
        let root = square.sqrt();
        let (slow, fast) = (((mean + root) * t).exp(), ((mean - root) * t).exp());
        ((slow + fast) / 2.0, (slow - fast) / (2.0 * root))
    } else if square < -1e-12 * mean * mean {
        let root = (-square).sqrt();
        let ((sin, cos), decay) = ((root * t).sin_cos(), (mean * t).exp());
        (decay * cos, decay * sin / root)
    } else {
        let decay = (mean * t).exp();
        (decay, decay * t)
    };
    [
        [common + skew * (matrix[0][0] - mean), skew * matrix[0][1]],
        [skew * matrix[1][0], common + skew * (matrix[1][1] - mean)],
    ]
}

/// The trajectory of a plan.
#[derive(Debug, Clone, Default)]
pub(crate) struct Rollout {
    /// States at the ends of the intervals, the first is the start.
    pub(crate) nodes: Vec<State>,
    /// [`PIECES`] states per interval, after that of the start.
    pub(crate) samples: Vec<Sampled>,
}

impl Rollout {
    /// Drives `controls` from the initial state, unchecked; the motion is that in the plane.
    pub(crate) fn drive(&mut self, scene: &Scene, controls: &[Control]) {
        let interval_s = scene.config.interval_s();
        let piece = interval_s / PIECES as f64;
        let slowing = scene.config.vehicle.deceleration_max_mps2;
        let parameters = scene.config.vehicle.parameters();
        let course = &scene.config.course;
        let (mut state, mut driven) = (scene.initial, course.in_plane(&scene.initial));
        let mut direction = direction(&driven);
        self.nodes.clear();
        self.samples.clear();
        self.nodes.push(state);
        let mut speed = scene.speed;
        self.samples.push(Sampled { t: 0.0, speed, state });
        for (interval, control) in controls.iter().enumerate() {
            let motion = Motion::new(&parameters, control, piece);
            for part in 1..=PIECES {
                driven = motion.advance(&driven, &mut direction);
                state = course.on_course(&driven, state.x);
                // A robot that is faster than planned slows down at the rate of its drive.
                speed = control.velocity.max(speed - slowing * piece);
                let t = interval as f64 * interval_s + part as f64 * piece;
                self.samples.push(Sampled { t, speed, state });
            }
            self.nodes.push(state);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use proptest::prelude::*;
    use vehicle::integrate::integrate;

    #[test]
    fn an_exponential_solves_its_differential_equation() {
        // Real, complex and equal eigenvalues.
        for matrix in [[[-3.0, 0.5], [0.2, -1.0]], [[-1.0, 2.0], [-3.0, -0.5]], [[-1.0, 1.0], [0.0, -1.0]]] {
            let small = 1e-5;
            let [ahead, behind] = [small, -small].map(|change| exponential(&matrix, 0.4 + change));
            let middle = exponential(&matrix, 0.4);
            for row in 0..2 {
                for column in 0..2 {
                    let slope = (ahead[row][column] - behind[row][column]) / (2.0 * small);
                    let product: f64 = (0..2).map(|place| matrix[row][place] * middle[place][column]).sum();
                    assert!((slope - product).abs() < 1e-8, "{slope} {product}");
                }
            }
            assert_eq!(exponential(&matrix, 0.0), [[1.0, 0.0], [0.0, 1.0]]);
        }
    }

    #[test]
    fn the_lateral_motion_agrees_with_the_plant_while_it_settles() {
        let parameters = Parameters::default();
        for velocity in [0.1, 0.5, 1.0] {
            let start = State { sideslip: 0.05, yaw_rate: -0.3, ..State::default() };
            let control = Control { velocity, steering: 0.06 };
            for duration in [0.004, 0.02, 0.06] {
                let ours = advance(&parameters, &start, &control, duration);
                let plant = integrate(&parameters, &start, &control, duration);
                // Only the cosine of the sideslip is not exact: 0.1 % of a motion of 0.05 rad and 1 rad/s, at 1 / 3 ms.
                assert!((ours.sideslip - plant.sideslip).abs() < 3e-4, "{ours:?} {plant:?}");
                assert!((ours.yaw_rate - plant.yaw_rate).abs() < 1e-3, "{ours:?} {plant:?}");
                assert!((ours.yaw - plant.yaw).abs() < 1e-4, "{ours:?} {plant:?}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// `integrate` is tested against an L-stable method, over the same vehicles. At the bound of RK4 a transient of the first
        /// 20 ms differs by some mrad.
        #[test]
        fn every_allowed_vehicle_is_predicted_as_it_moves(
            exponents in prop::array::uniform5(-3.0..=6.0f64), exponent in -1.7..=0.3f64, steering in -0.12..=0.12f64,
            sideslip in -0.15..=0.15f64, yaw_rate in -0.8..=0.8f64, duration in 0.02..0.46f64,
        ) {
            let [mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2] =
                exponents.map(|exponent| 10f64.powf(exponent).clamp(1e-3, 1e6));
            let parameters = Parameters { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, ..Parameters::default() };
            let start = State { sideslip, yaw_rate, ..State::default() };
            let control = Control { velocity: 10f64.powf(exponent), steering };
            let ours = advance(&parameters, &start, &control, duration);
            prop_assert!(ours.is_finite(), "{ours:?}");
            let (mut plant, mut widest, mut fastest) = (start, sideslip.abs().max(1e-3), yaw_rate.abs().max(1e-3));
            // Ever longer pieces, the first far shorter than any transient.
            for piece in (0..80).rev() {
                let share = if piece == 79 { 0.5_f64.powi(79) } else { 0.5_f64.powi(piece + 1) };
                plant = integrate(&parameters, &plant, &control, duration * share);
                (widest, fastest) = (widest.max(plant.sideslip.abs()), fastest.max(plant.yaw_rate.abs()));
            }
            // Beyond, the cosine of the sideslip is another at each moment; and a robot that turns round swings.
            if widest < 0.2 && plant.yaw.abs() < 1.0 {
                prop_assert!((ours.sideslip - plant.sideslip).abs() < 0.05 * widest + 0.005, "{ours:?} {plant:?}");
                prop_assert!((ours.yaw_rate - plant.yaw_rate).abs() < 0.05 * fastest + 0.02, "{ours:?} {plant:?}");
                let off = (ours.x - plant.x).hypot(ours.y - plant.y);
                // While the sideslip turns, the direction of the way is taken at few places.
                let turned = (start.sideslip - plant.sideslip).abs();
                let allowed = (0.05 + 0.1 * turned) * control.velocity * duration + 1e-5;
                prop_assert!(off < allowed, "{ours:?} {plant:?}");
            }
        }
    }

    #[test]
    fn positions_agree_with_the_plant_within_a_millimetre_at_every_velocity() {
        let parameters = Parameters::default();
        for velocity in [0.1, 0.3, 1.0] {
            let (mut ours, mut plant) = (State::default(), State::default());
            for steering in [0.06, -0.06, 0.06, -0.06, 0.0, 0.06] {
                let control = Control { velocity, steering };
                ours = advance(&parameters, &ours, &control, 2.72 / 6.0);
                plant = integrate(&parameters, &plant, &control, 2.72 / 6.0);
            }
            let error = (ours.x - plant.x).hypot(ours.y - plant.y);
            assert!(error < 1e-3, "{error} m at {velocity} m/s");
            assert!((ours.yaw - plant.yaw).abs() < 1e-3);
        }
    }

    #[test]
    fn nodes_are_the_ends_of_the_intervals() {
        let config = ControllerConfig { horizon_s: 2.4, intervals: 6, ..ControllerConfig::default() };
        let mut rollout = Rollout::default();
        let controls = [Control { velocity: 0.5, steering: 0.0 }; 3];
        rollout.drive(&Scene::new(&config, &[], State::default()), &controls);
        let Rollout { nodes, samples } = rollout;
        assert_eq!((nodes.len(), samples.len()), (4, 28));
        assert!((nodes[3].x - 0.6).abs() < 1e-12);
        assert_eq!(samples[27].state, nodes[3]);
        assert!((samples[27].t - 1.2).abs() < 1e-12);
    }
}
