//! Problems like those of the closed loop, for the tests of the solver.

#![allow(dead_code, reason = "each test file uses its part")]

use std::sync::Arc;

use ocp::{Collocation, EllipsePath, Problem, Scheme, Trajectory, Weights, roll_out};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use vehicle::{Bounds, Control, Parameters, State, model};

/// Horizon of the source [s].
pub(crate) const HORIZON_S: f64 = 2.72;
/// Intervals of the source.
pub(crate) const INTERVALS: usize = 6;

/// Weights of the solver table: nodes, terminal, controls about (0.9, 0), slack 100 / 100.
pub(crate) fn bench_weights() -> Weights {
    Weights {
        node: [0.1, 0.2, 0.1, 1.0, 1.0],
        terminal: [0.1, 0.2, 0.1, 5.0, 5.0],
        control: [0.5, 5.0],
        change: [0.0, 0.0],
        slack_linear: 100.0,
        slack_quadratic: 100.0,
        goal: [(0, 0.0); 2],
    }
}

/// Weights of the closed loop: integrals multiplied by the interval.
pub(crate) fn loop_weights() -> Weights {
    let interval = HORIZON_S / INTERVALS as f64;
    Weights {
        node: [0.0, 0.5 * interval, 0.0, interval, 2.0 * interval],
        terminal: [0.0, 0.5 * interval, 0.0, 5.0, 5.0],
        control: [0.0, 10.0 * interval],
        change: [0.5, 50.0],
        slack_linear: 500.0,
        slack_quadratic: 500.0,
        goal: [(0, 0.0); 2],
    }
}

/// A problem from `initial` to a goal at (`goal`, 0), whose reference is clipped to what the horizon can reach.
pub(crate) fn problem(initial: State, goal: f64, weights: Weights, ellipses: Vec<EllipsePath>) -> Problem {
    let interval = HORIZON_S / INTERVALS as f64;
    let references = (1..=INTERVALS)
        .map(|node| State { x: goal.min(initial.x + interval * node as f64), ..State::default() })
        .collect();
    Problem {
        model: Arc::new(Parameters::default()),
        bounds: Bounds::default(),
        x_range: [0.0, 22.0],
        y_range: [-1.5, 1.5],
        intervals: vec![interval; INTERVALS],
        initial,
        previous: None,
        references,
        control_reference: Control { velocity: 0.9, steering: 0.0 },
        weights,
        ellipses,
        frames: Vec::new(),
    }
}

/// An ellipse that does not move.
pub(crate) fn ellipse(x: f64, y: f64, a: f64, b: f64) -> EllipsePath {
    EllipsePath { a, b, centres: vec![[x, y]; INTERVALS + 1] }
}

/// Straight ahead at the reference velocity.
pub(crate) fn cold_guess(problem: &Problem) -> Trajectory {
    rolled(problem, &vec![problem.control_reference; problem.intervals.len()])
}

/// The trajectory under `controls`.
pub(crate) fn rolled(problem: &Problem, controls: &[Control]) -> Trajectory {
    let collocation = Collocation::new(Scheme::Radau3);
    roll_out(problem.model.as_ref(), &collocation, &problem.initial, controls, &problem.intervals)
        .expect("rolls out")
}

/// A random problem like those of the closed loop, with a guess that fixes the side; some starts are hopeless.
pub(crate) fn random(seed: u64) -> (Problem, Trajectory) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let control = Control { velocity: rng.random_range(0.2..1.0), steering: rng.random_range(-0.06..0.06) };
    let (sideslip, yaw_rate) = model::steady_turn(&Parameters::default(), &control);
    let initial = State {
        sideslip: sideslip + normal(&mut rng, 0.002),
        yaw: rng.random_range(-0.35..0.35),
        yaw_rate: yaw_rate + normal(&mut rng, 0.01),
        x: rng.random_range(-0.02..15.0),
        y: rng.random_range(-0.9..0.9),
    };
    let goal = initial.x + rng.random_range(0.3..8.0);
    let count = rng.random_range(0..3usize);
    let ellipses: Vec<_> = (0..count)
        .map(|_| {
            let b = rng.random_range(0.6..0.95);
            let x = initial.x + rng.random_range(0.6..3.8);
            ellipse(x, rng.random_range(-0.8..0.8), 1.2, b)
        })
        .collect();
    let weights = if rng.random_bool(0.5) { loop_weights() } else { bench_weights() };
    // To the side of the nearest ellipse on which the robot is, then back.
    let side =
        ellipses.first().map_or(0.0, |ellipse| if initial.y >= ellipse.centres[0][1] { 1.0 } else { -1.0 });
    let controls: Vec<_> = (0..INTERVALS)
        .map(|index| Control { velocity: 0.9, steering: side * if index < 2 { 0.04 } else { -0.01 } })
        .collect();
    let mut problem = problem(initial, goal, weights, ellipses);
    if rng.random_bool(0.7) {
        problem.previous = Some(control);
    }
    let guess = rolled(&problem, &controls);
    (problem, guess)
}

fn normal(rng: &mut Pcg64, deviation: f64) -> f64 {
    // The sum of twelve uniform numbers has variance 1.
    deviation * ((0..12).map(|_| rng.random_range(0.0..1.0)).sum::<f64>() - 6.0)
}
