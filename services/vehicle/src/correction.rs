//! Corrections of steering angle and velocity: what has to be sent so that the robot does what is desired.
//!
//! Pre-commissioning found that the robot drives slower than it is told by a constant factor, and steers by an
//! angle that is a curve of the angle sent. Sent values undo both. The backlash of the steering has no correction
//! here: its sign is not known from the command.

use serde::{Deserialize, Serialize};

use crate::network::SteeringNetwork;
use crate::{Control, Invalid, require};

/// Largest velocity that may be sent [m/s].
pub const SENT_VELOCITY_MAX_MPS: f64 = 2.0;

/// Largest steering angle that may be sent to either side [rad].
pub const SENT_STEERING_MAX_RAD: f64 = 0.12;

/// Velocity sent per velocity desired, kv, from timed straight runs.
pub const VELOCITY_FACTOR: f64 = 1.4;

/// What undoes the robot's imperfections in velocity and steering.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandCorrection {
    /// Velocity sent per velocity desired, kv.
    pub velocity_factor: f64,
    /// Steering angle sent for the angle desired.
    pub steering: SteeringCorrection,
}

/// Steering angle sent for the angle desired.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SteeringCorrection {
    /// The angle desired.
    Identity,
    /// The angle a network gives for it.
    Network(SteeringNetwork),
}

/// Which correction is used: a named one, or one of its own from `scanloop calibrate`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Calibration {
    /// `"default"`: kv = 1.4 and the shipped network, which undo the default emulated robot.
    #[default]
    Default,
    /// `"identity"`: sent is desired.
    Identity,
    /// `{ custom = { velocity_factor = ..., steering = ... } }`.
    Custom(CommandCorrection),
}

impl Calibration {
    /// The correction behind the name.
    pub fn correction(&self) -> CommandCorrection {
        match self {
            Self::Default => CommandCorrection {
                velocity_factor: VELOCITY_FACTOR,
                steering: SteeringCorrection::Network(SHIPPED_NETWORK),
            },
            Self::Identity => {
                CommandCorrection { velocity_factor: 1.0, steering: SteeringCorrection::Identity }
            }
            Self::Custom(correction) => *correction,
        }
    }

    /// Passes when the correction can be used.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.correction().validate()
    }
}

impl CommandCorrection {
    /// Velocity [m/s] and steering angle [rad] to send for a desired control that is within its limits (7.41).
    ///
    /// Both are limited to what may be sent at all, so that no network, however it was fitted, can exceed it.
    /// NaN comes out only where NaN went in.
    pub fn correct(&self, desired: Control) -> (f64, f64) {
        let steering = match &self.steering {
            SteeringCorrection::Identity => desired.steering,
            SteeringCorrection::Network(network) => network.eval(desired.steering),
        };
        let velocity = self.velocity_factor * desired.velocity;
        (
            velocity.clamp(-SENT_VELOCITY_MAX_MPS, SENT_VELOCITY_MAX_MPS),
            steering.clamp(-SENT_STEERING_MAX_RAD, SENT_STEERING_MAX_RAD),
        )
    }

    /// Passes when factor and network can be used.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("velocity_factor", self.velocity_factor, 0.2..=5.0)?;
        match &self.steering {
            SteeringCorrection::Network(network) if !network.is_usable() => {
                Err(Invalid::new("steering", "a network", "weights within 1e6, scales from 1e-6 to 10 rad"))
            }
            _ => Ok(()),
        }
    }
}

/// The network fitted to circle runs of the default emulated robot: 91 sent angles from -0.065 to 0.065 rad.
///
/// It inverts that robot's map to 2e-6 rad over the desired range of +-0.06 rad.
pub const SHIPPED_NETWORK: SteeringNetwork = SteeringNetwork {
    input_scale_rad: 0.07403906249999999,
    output_scale_rad: 0.065,
    hidden_weights: [
        1.502935494596089,
        1.0513806649083746,
        0.1630656146438491,
        0.163363029398795,
        0.8484905944366268,
        1.1413824132327888,
    ],
    hidden_biases: [
        2.579734618213943,
        0.7042836221618259,
        -0.023973732349410318,
        -0.02443622441453037,
        -0.39478241394325997,
        -2.1482805217417362,
    ],
    output_weights: [
        1.241537225813195,
        0.4499593939657424,
        0.1846492586217057,
        0.18508278092990454,
        0.6495204372285125,
        1.2262635468924175,
    ],
    output_bias: -0.054370902324527536,
};

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_default_calibration_sends_1_4_times_the_velocity_and_less_steering_than_desired() {
        let (velocity, steering) =
            Calibration::Default.correction().correct(Control { velocity: 0.5, steering: 0.03 });
        assert!((velocity - 0.7).abs() < 1e-12);
        // The map realises about 1.2 times the angle sent: 0.0248 * (1.2 - 0.3 * 0.0427 + 0.05 * 0.2067) = 0.0297.
        assert!((steering - 0.0251).abs() < 3e-4, "{steering}");
    }

    #[test]
    fn the_identity_sends_what_is_desired() {
        let desired = Control { velocity: 0.37, steering: -0.041 };
        assert_eq!(Calibration::Identity.correction().correct(desired), (0.37, -0.041));
    }

    #[test]
    fn unusable_corrections_are_refused() {
        let mut correction = Calibration::Default.correction();
        correction.velocity_factor = f64::NAN;
        assert_eq!(Calibration::Custom(correction).validate().unwrap_err().key, "velocity_factor");
        let network = SteeringNetwork { output_bias: f64::INFINITY, ..SHIPPED_NETWORK };
        let correction =
            CommandCorrection { velocity_factor: 1.0, steering: SteeringCorrection::Network(network) };
        assert_eq!(Calibration::Custom(correction).validate().unwrap_err().key, "steering");
        assert_eq!(Calibration::Default.validate(), Ok(()));
    }

    proptest! {
        #[test]
        fn sent_values_stay_within_what_may_be_sent(
            velocity in -1e6..1e6f64, steering in -1e6..1e6f64, factor in 0.2..5.0f64, weight in -1e3..1e3f64,
        ) {
            let network = SteeringNetwork { output_weights: [weight; 6], ..SHIPPED_NETWORK };
            for steering_correction in [SteeringCorrection::Identity, SteeringCorrection::Network(network)] {
                let correction = CommandCorrection { velocity_factor: factor, steering: steering_correction };
                let (sent_velocity, sent_steering) = correction.correct(Control { velocity, steering });
                prop_assert!(sent_velocity.abs() <= SENT_VELOCITY_MAX_MPS);
                prop_assert!(sent_steering.abs() <= SENT_STEERING_MAX_RAD);
            }
        }
    }
}
