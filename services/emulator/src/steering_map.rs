//! How the steering angle of the wheels follows the angle sent, before backlash.
//!
//! The curve is that of a plausible, invented linkage: more angle than sent near the middle, less towards the stops,
//! and not quite the same to both sides. It stays within +-30 % of the identity (ratio 0.85 to 1.21) and rises
//! strictly, so it has an inverse, which the shipped correction network is trained for.

use serde::{Deserialize, Serialize};

/// The angle sent at which the linkage reaches its stops [rad].
const STOP_RAD: f64 = 0.12;

/// The steering map of the emulated robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SteeringMap {
    /// The curve of [`nonlinear`].
    #[default]
    Nonlinear,
    /// The wheels take the angle sent.
    Identity,
}

impl vehicle::Setting for SteeringMap {}

impl SteeringMap {
    /// Angle of the shaft that the angle `sent` gives [rad].
    pub fn realised(self, sent: f64) -> f64 {
        match self {
            Self::Nonlinear => nonlinear(sent),
            Self::Identity => sent,
        }
    }
}

/// Realised angle for the angle sent [rad]: s (1.2 + 0.05 z - 0.3 z^2) with z = s / 0.12 limited to [-1, 1].
pub fn nonlinear(sent: f64) -> f64 {
    let share = (sent / STOP_RAD).clamp(-1.0, 1.0);
    sent * (1.2 + 0.05 * share - 0.3 * share * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_has_the_values_of_a_hand_calculation() {
        assert_eq!(nonlinear(0.0), 0.0);
        // z = 1/2: 0.06 (1.2 + 0.025 - 0.075) = 0.069; z = -1/2: -0.06 (1.2 - 0.025 - 0.075) = -0.066.
        assert!((nonlinear(0.06) - 0.069).abs() < 1e-15);
        assert!((nonlinear(-0.06) + 0.066).abs() < 1e-15);
        assert!((nonlinear(0.12) - 0.114).abs() < 1e-15);
        assert!((nonlinear(-0.12) + 0.102).abs() < 1e-15);
    }

    #[test]
    fn the_curve_rises_strictly_and_stays_within_30_percent() {
        let angles: Vec<f64> = (-120..=120).map(|step| f64::from(step) * 1e-3).collect();
        for pair in angles.windows(2) {
            assert!(nonlinear(pair[1]) > nonlinear(pair[0]));
        }
        for angle in angles.into_iter().filter(|angle| *angle != 0.0) {
            let ratio = nonlinear(angle) / angle;
            assert!((0.85 - 1e-12..1.21).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn nan_stays_nan_and_never_panics() {
        assert!(nonlinear(f64::NAN).is_nan());
    }
}
