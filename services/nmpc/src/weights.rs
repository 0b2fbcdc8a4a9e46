//! Weights of the objective as settings.

use ocp::Weights;
use vehicle::settings;

/// Time that the weights of changes count for [s].
const CHANGE_S: f64 = 0.1;

settings! {
    /// Weights of the objective; integrals are multiplied by the interval when the problem is built.
    #[derive(Copy)]
    pub struct WeightSettings {
        /// Integral weights of the state: sideslip angle, yaw, yaw rate, x, y.
        pub state: [f64; 5] = [0.1, 0.5, 0.1, 6.0, 8.0], 0.0..=1e6;
        /// Weights of the state at the end of the horizon: sideslip angle, yaw, yaw rate, x, y.
        pub terminal: [f64; 5] = [0.1, 0.5, 0.1, 30.0, 8.0], 0.0..=1e6;
        /// Weight of the lateral distance where the plan passes the goal, in addition.
        pub goal: f64 = 3000.0, 0.0..=1e6;
        /// Integral weights of velocity and steering angle about their reference.
        pub control: [f64; 2] = [0.1, 10.0], 0.0..=1e6;
        /// Weights of the changes of velocity and steering angle in each tenth of a second of a steady change.
        pub change: [f64; 2] = [0.2, 100.0], 0.0..=1e6;
        /// Linear penalty of entering an ellipse.
        pub slack_linear: f64 = 500.0, 0.0..=1e6;
        /// Quadratic penalty of entering an ellipse.
        pub slack_quadratic: f64 = 500.0, 0.0..=1e6;
    }
}

impl WeightSettings {
    /// Weights as a problem with intervals of this length takes them.
    pub(crate) fn over(&self, interval_s: f64) -> Weights {
        Weights {
            node: self.state.map(|weight| weight * interval_s),
            terminal: self.terminal,
            control: self.control.map(|weight| weight * interval_s),
            // A change from interval to interval is one of 0.1 / interval_s of it in each of interval_s / 0.1 parts.
            change: self.change.map(|weight| weight * CHANGE_S / interval_s),
            slack_linear: self.slack_linear,
            slack_quadratic: self.slack_quadratic,
            goal: [(0, 0.0); 2],
        }
    }
}
