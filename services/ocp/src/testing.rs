//! Problems for the unit tests of the solver.

use std::sync::Arc;

use vehicle::{Bounds, Control, Parameters, State};

use crate::problem::{EllipsePath, Problem, Trajectory, Weights};

/// Six intervals past an ellipse at (3, 0.2), all weights positive, previous control known.
pub(crate) fn problem() -> Problem {
    let interval = 2.72 / 6.0;
    Problem {
        model: Arc::new(Parameters::default()),
        bounds: Bounds::default(),
        x_range: [0.0, 22.0],
        y_range: [-1.5, 1.5],
        intervals: vec![interval; 6],
        initial: State { sideslip: 0.01, yaw: 0.1, yaw_rate: 0.05, x: 1.0, y: -0.1 },
        previous: Some(Control { velocity: 0.7, steering: 0.01 }),
        references: (1..=6)
            .map(|node| State { x: 1.0 + interval * f64::from(node), ..State::default() })
            .collect(),
        control_reference: Control { velocity: 0.9, steering: 0.0 },
        weights: Weights {
            node: [0.1, 0.2, 0.1, 1.0, 2.0],
            terminal: [0.1, 0.2, 0.1, 5.0, 5.0],
            control: [0.5, 5.0],
            change: [0.5, 50.0],
            slack_linear: 100.0,
            slack_quadratic: 100.0,
            goal: [(3, 5.0), (4, 2.0)],
        },
        ellipses: vec![EllipsePath { a: 1.2, b: 0.8, centres: vec![[3.0, 0.2]; 7] }],
        frames: Vec::new(),
    }
}

/// Controls that differ in all intervals, without states.
pub(crate) fn guess() -> Trajectory {
    let controls = (0..6)
        .map(|index| Control {
            velocity: 0.5 + 0.07 * f64::from(index),
            steering: 0.03 - 0.012 * f64::from(index),
        })
        .collect();
    Trajectory { states: Vec::new(), controls }
}
