//! Weights of the objective as settings.

use ocp::Weights;
use serde::{Deserialize, Serialize};
use vehicle::{Invalid, require};

/// Weights of the objective; integrals are multiplied by the interval when the problem is built.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WeightSettings {
    /// Integral weights of (sideslip, yaw, yaw rate, x, y).
    pub state: [f64; 5],
    /// Weights of (sideslip, yaw, yaw rate, x, y) at the end of the horizon.
    pub terminal: [f64; 5],
    /// Integral weights of (velocity, steering) about their reference.
    pub control: [f64; 2],
    /// Weights of the differences of (velocity, steering) from interval to interval.
    pub change: [f64; 2],
    /// Linear weight of the slack of an ellipse.
    pub slack_linear: f64,
    /// Quadratic weight of the slack of an ellipse.
    pub slack_quadratic: f64,
}

impl Default for WeightSettings {
    fn default() -> Self {
        Self {
            state: [0.1, 0.5, 0.1, 1.0, 8.0],
            terminal: [0.1, 0.5, 0.1, 5.0, 8.0],
            control: [0.1, 10.0],
            change: [0.2, 50.0],
            slack_linear: 500.0,
            slack_quadratic: 500.0,
        }
    }
}

impl WeightSettings {
    /// Weights as a problem with intervals of this length takes them.
    pub(crate) fn over(&self, interval_s: f64) -> Weights {
        Weights {
            node: self.state.map(|weight| weight * interval_s),
            terminal: self.terminal,
            control: self.control.map(|weight| weight * interval_s),
            change: self.change,
            slack_linear: self.slack_linear,
            slack_quadratic: self.slack_quadratic,
        }
    }

    /// Passes when every weight is within its range; the error names the first that is not.
    pub(crate) fn validate(&self) -> Result<(), Invalid> {
        let WeightSettings { state, terminal, control, change, slack_linear, slack_quadratic } = *self;
        let lists: [(&str, &[f64]); 6] = [
            ("state", &state),
            ("terminal", &terminal),
            ("control", &control),
            ("change", &change),
            ("slack_linear", &[slack_linear]),
            ("slack_quadratic", &[slack_quadratic]),
        ];
        for (key, values) in lists {
            for &value in values {
                require(key, value, 0.0..=1e6)?;
            }
        }
        Ok(())
    }
}
