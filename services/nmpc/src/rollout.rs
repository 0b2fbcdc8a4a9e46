//! What the robot does under a sequence of controls: the model, integrated independently of the solver.
//!
//! The step follows the stiffness: the fast eigenvalues of (7.27), (7.29) grow like 1/u1, so RK4 with a step
//! proportional to u1 has the same accuracy at every velocity and needs 6 steps per decimetre. The error of a
//! steering jump from lock to lock is below 1 mm over the horizon (test), a tenth of what verification allows.

use vehicle::integrate::rk4;
use vehicle::{Control, Parameters, State};

/// Step per velocity [s per m/s]: the fastest motion, 34 1/s at 1 m/s, is resolved with |lambda h| < 0.7.
const STEP_PER_VELOCITY: f64 = 0.02;
/// Smallest velocity that a step is made for [m/s].
const SLOWEST_MPS: f64 = 0.02;

/// A state at a time of the plan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Sampled {
    /// Time since the start of the plan [s].
    pub(crate) t: f64,
    /// The state.
    pub(crate) state: State,
}

/// The state after `duration` seconds under a constant control.
#[must_use]
pub(crate) fn advance(parameters: &Parameters, state: &State, control: &Control, duration: f64) -> State {
    let longest = STEP_PER_VELOCITY * control.velocity.clamp(SLOWEST_MPS, 1.0);
    let steps = (duration / longest).ceil().clamp(1.0, 1e5);
    let step = duration / steps;
    (0..steps as usize).fold(*state, |state, _| rk4(parameters, &state, control, step))
}

/// Fills `nodes` with the states at the ends of the intervals and `dense` with `pieces` samples per interval.
///
/// Both start with the initial state. Intervals are `interval_s` long.
pub(crate) fn simulate(
    parameters: &Parameters,
    initial: &State,
    controls: &[Control],
    interval_s: f64,
    pieces: usize,
    nodes: &mut Vec<State>,
    dense: &mut Vec<Sampled>,
) {
    nodes.clear();
    dense.clear();
    nodes.push(*initial);
    dense.push(Sampled { t: 0.0, state: *initial });
    let mut state = *initial;
    let piece = interval_s / pieces as f64;
    for (interval, control) in controls.iter().enumerate() {
        for part in 1..=pieces {
            state = advance(parameters, &state, control, piece);
            dense.push(Sampled { t: interval as f64 * interval_s + part as f64 * piece, state });
        }
        nodes.push(state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::integrate::integrate;

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
        let controls = [Control { velocity: 0.5, steering: 0.0 }; 3];
        let (mut nodes, mut dense) = (Vec::new(), Vec::new());
        simulate(&Parameters::default(), &State::default(), &controls, 0.4, 5, &mut nodes, &mut dense);
        assert_eq!((nodes.len(), dense.len()), (4, 16));
        assert!((nodes[3].x - 0.6).abs() < 1e-12);
        assert_eq!(dense[15].state, nodes[3]);
        assert!((dense[15].t - 1.2).abs() < 1e-12);
    }
}
