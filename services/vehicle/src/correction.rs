//! Corrections of steering angle and velocity: the values to send so that the robot does what is desired.
//!
//! Pre-commissioning found that the robot drives slower than commanded by a constant factor, and that its steering
//! angle is a curve of the angle sent. The corrections invert both. They also invert the play between shaft and
//! wheels: the shaft turns beyond the desired angle by the width of the play, in its direction of motion, so that it
//! ends in contact with the wheels. This needs the present position of the wheels ([`Linkage`]), which follows from
//! earlier sent values. Only at the start it is unknown within the play, until the first larger movement. A wrong
//! width of the play leaves the difference as an error.

use key_table::Table;
use serde::{Deserialize, Serialize};

use crate::network::SteeringNetwork;
use crate::{Bounds, Control, Invalid, Setting, require};

/// Velocity sent per velocity desired, kv, from timed straight runs.
const VELOCITY_FACTOR: f64 = 1.4;

/// The inverse of the robot's imperfections in velocity and steering.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandCorrection {
    /// Velocity sent per velocity desired, kv.
    pub velocity_factor: f64,
    /// Steering angle of the shaft sent for the angle desired.
    pub steering: SteeringCorrection,
    /// Half the play between shaft and wheels [rad].
    #[serde(default)]
    pub play_rad: f64,
}

/// Where shaft and wheels stand, both as steering angles of the wheels [rad].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Linkage {
    /// Angle that the wheels would have without play.
    pub shaft: f64,
    /// Angle that the wheels have.
    pub wheels: f64,
}

/// What is sent for a desired control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction {
    /// Velocity to send [m/s].
    pub velocity: f64,
    /// Steering angle to send [rad].
    pub steering: f64,
    /// Where shaft and wheels stand then.
    pub linkage: Linkage,
}

/// Wheels within this of the desired angle are not moved [rad]. Otherwise noise in the command would make the shaft
/// cross the whole play to and fro. At full lock 1 mrad is 5 cm of the turning radius.
const PLAY_TOLERANCE_RAD: f64 = 0.0005;

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

impl Setting for Calibration {
    fn require_all(&self, name: &str) -> Result<(), Invalid> {
        self.correction().validate().map_err(|error| error.within(name))
    }

    fn allowed() -> String {
        "`\"default\"`, `\"identity\"`, `{ custom = { ... } }` from `scanloop calibrate`".to_owned()
    }

    fn schema() -> Table {
        let text = "anyOf = [{ enum = ['default', 'identity'] }, { type = 'object', required = ['custom'] }]";
        text.parse().unwrap_or_default()
    }
}

impl Calibration {
    /// The correction behind the name.
    pub fn correction(&self) -> CommandCorrection {
        match self {
            Self::Default => CommandCorrection {
                velocity_factor: VELOCITY_FACTOR,
                steering: SteeringCorrection::Network(SHIPPED_NETWORK),
                play_rad: 0.0,
            },
            Self::Identity => CommandCorrection {
                velocity_factor: 1.0,
                steering: SteeringCorrection::Identity,
                play_rad: 0.0,
            },
            Self::Custom(correction) => *correction,
        }
    }
}

impl CommandCorrection {
    /// What to send for a desired control that is within its limits (7.41), when shaft and wheels stand at `linkage`.
    ///
    /// Both values are limited to what `bounds` allow to be sent at all, so that no network, however it was fitted, can exceed
    /// it. NaN comes out only where NaN went in.
    pub fn correct(&self, bounds: &Bounds, desired: Control, linkage: Linkage) -> Correction {
        let linkage = linkage.towards(desired.steering, self.play_rad);
        let steering = match &self.steering {
            SteeringCorrection::Identity => linkage.shaft,
            SteeringCorrection::Network(network) => network.eval(linkage.shaft),
        };
        let velocity = self.velocity_factor * desired.velocity;
        Correction {
            velocity: velocity.clamp(-bounds.sent_velocity_max_mps, bounds.sent_velocity_max_mps),
            steering: steering.clamp(-bounds.sent_steering_max_rad, bounds.sent_steering_max_rad),
            linkage,
        }
    }

    /// Passes when factor and network can be used.
    ///
    /// # Errors
    /// [`Invalid`] with the key, the value and what is allowed.
    pub fn validate(&self) -> Result<(), Invalid> {
        require("velocity_factor", self.velocity_factor, 0.2..=5.0)?;
        require("play_rad", self.play_rad, 0.0..=0.05)?;
        match &self.steering {
            SteeringCorrection::Network(network) if !network.is_usable() => {
                Err(Invalid::new("steering", "a network", "weights within 1e6, scales from 1e-6 to 10 rad"))
            }
            _ => Ok(()),
        }
    }
}

impl Linkage {
    /// The linkage with the wheels at `desired`, after the shaft has crossed the play where it has to.
    fn towards(self, desired: f64, play: f64) -> Self {
        let moved = desired - self.wheels;
        match play > 0.0 {
            false => Self { shaft: desired, wheels: desired },
            true if moved.abs() <= PLAY_TOLERANCE_RAD => self,
            true => Self { shaft: desired + play.copysign(moved), wheels: desired },
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
        let desired = Control { velocity: 0.5, steering: 0.03 };
        let Correction { velocity, steering, .. } =
            Calibration::Default.correction().correct(&Bounds::default(), desired, Linkage::default());
        assert!((velocity - 0.7).abs() < 1e-12);
        // The map realises about 1.2 times the angle sent: 0.0248 * (1.2 - 0.3 * 0.0427 + 0.05 * 0.2067) = 0.0297.
        assert!((steering - 0.0251).abs() < 3e-4, "{steering}");
    }

    #[test]
    fn the_identity_sends_what_is_desired() {
        let desired = Control { velocity: 0.37, steering: -0.041 };
        let sent =
            Calibration::Identity.correction().correct(&Bounds::default(), desired, Linkage::default());
        assert_eq!((sent.velocity, sent.steering), (0.37, -0.041));
    }

    #[test]
    fn the_shaft_crosses_the_play_where_the_wheels_are_to_turn_back() {
        let correction = CommandCorrection { play_rad: 0.006, ..Calibration::Identity.correction() };
        let mut linkage = Linkage::default();
        // The emulated robot's play: the wheels stay where they are until the shaft has used it up.
        let mut wheels: f64 = 0.0;
        for (desired, shaft) in
            [(0.01, 0.016), (0.02, 0.026), (0.0197, 0.026), (0.015, 0.009), (-0.02, -0.026), (-0.01, -0.004)]
        {
            let sent =
                correction.correct(&Bounds::default(), Control { velocity: 0.5, steering: desired }, linkage);
            linkage = sent.linkage;
            wheels = wheels.clamp(sent.steering - 0.006, sent.steering + 0.006);
            assert!((sent.steering - shaft).abs() < 1e-15, "{desired}: {}", sent.steering);
            assert!((wheels - desired).abs() <= PLAY_TOLERANCE_RAD, "{desired}: {wheels}");
            assert!((wheels - linkage.wheels).abs() < 1e-15);
        }
    }

    #[test]
    fn unusable_corrections_are_refused() {
        let mut correction = Calibration::Default.correction();
        correction.velocity_factor = f64::NAN;
        assert_eq!(correction.validate().unwrap_err().key, "velocity_factor");
        let network = SteeringNetwork { output_bias: f64::INFINITY, ..SHIPPED_NETWORK };
        let correction = CommandCorrection {
            velocity_factor: 1.0,
            steering: SteeringCorrection::Network(network),
            play_rad: 0.0,
        };
        assert_eq!(correction.validate().unwrap_err().key, "steering");
        let correction = CommandCorrection { play_rad: 0.06, ..Calibration::Default.correction() };
        assert_eq!(correction.validate().unwrap_err().key, "play_rad");
        assert_eq!(Calibration::Default.correction().validate(), Ok(()));
    }

    proptest! {
        #[test]
        fn sent_values_stay_within_what_may_be_sent(
            velocity in -1e6..1e6f64, steering in -1e6..1e6f64, factor in 0.2..5.0f64, weight in -1e3..1e3f64,
            play_rad in 0.0..0.05f64, wheels in -0.06..0.06f64,
            sent_velocity_max_mps in 0.1..20.0f64, sent_steering_max_rad in 0.01..0.8f64,
        ) {
            let bounds = Bounds { sent_velocity_max_mps, sent_steering_max_rad, ..Bounds::default() };
            let network = SteeringNetwork { output_weights: [weight; 6], ..SHIPPED_NETWORK };
            for steering_correction in [SteeringCorrection::Identity, SteeringCorrection::Network(network)] {
                let correction =
                    CommandCorrection { velocity_factor: factor, steering: steering_correction, play_rad };
                let linkage = Linkage { shaft: wheels, wheels };
                let sent = correction.correct(&bounds, Control { velocity, steering }, linkage);
                prop_assert!(sent.velocity.abs() <= sent_velocity_max_mps);
                prop_assert!(sent.steering.abs() <= sent_steering_max_rad);
            }
        }
    }
}
