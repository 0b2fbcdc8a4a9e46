//! The trajectory of the robot under a sequence of controls, integrated independently of the solver.
//!
//! The step follows the stiffness: the fast eigenvalues of (7.27), (7.29) grow like 1/u1, so RK4 with a step
//! proportional to u1 has the same accuracy at every velocity and needs 6 steps per decimetre. The error of a
//! steering jump from lock to lock is below 1 mm over the horizon (test), a tenth of what verification allows.

use vehicle::integrate::rk4;
use vehicle::{Control, Parameters, State};

use crate::sampled::Sampled;
use crate::scene::Scene;

/// Samples per interval: 5 cm apart at 1 m/s and N = 6.
pub(crate) const PIECES: usize = 9;

/// Step per velocity [s per m/s]: the fastest motion, 34 1/s at 1 m/s, is resolved with |lambda h| < 0.7.
const STEP_PER_VELOCITY: f64 = 0.02;
/// Smallest velocity from which the step is computed [m/s].
const SLOWEST_MPS: f64 = 0.02;

/// The state after `duration` seconds under a constant control.
#[must_use]
pub(crate) fn advance(parameters: &Parameters, state: &State, control: &Control, duration: f64) -> State {
    let longest = STEP_PER_VELOCITY * control.velocity.clamp(SLOWEST_MPS, 1.0);
    let steps = (duration / longest).ceil().clamp(1.0, 1e5);
    let step = duration / steps;
    (0..steps as usize).fold(*state, |state, _| rk4(parameters, &state, control, step))
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
    /// Drives `controls` from the initial state, unchecked.
    pub(crate) fn drive(&mut self, scene: &Scene, controls: &[Control]) {
        let interval_s = scene.config.interval_s();
        let piece = interval_s / PIECES as f64;
        let slowing = scene.config.vehicle.deceleration_max_mps2;
        let mut state = scene.initial;
        self.nodes.clear();
        self.samples.clear();
        self.nodes.push(state);
        let mut speed = scene.speed;
        self.samples.push(Sampled { t: 0.0, speed, state });
        for (interval, control) in controls.iter().enumerate() {
            for part in 1..=PIECES {
                state = advance(&scene.config.vehicle.parameters(), &state, control, piece);
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
    use crate::config::Config;
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
        let config = Config { horizon_s: 2.4, intervals: 6, ..Config::default() };
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
