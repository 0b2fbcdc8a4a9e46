//! Bounds of controls and states, (7.41)-(7.46).

use key_table::settings;

use crate::{Control, Invalid, require};

/// Largest steering angle to either side that may be desired, (7.41) [rad]. Turning radii, the range that a calibration
/// has to cover and the defaults of all settings follow from it.
pub const STEERING_MAX_RAD: f64 = 0.06;

/// The least velocity that may be a bound [m/s]: the model divides by the velocity.
const BOUND_MIN_MPS: f64 = 0.02;

/// The largest velocity that a vehicle may be described with, and the largest that one may be sent, which a calibration sends
/// for it [m/s].
pub const ANY_VELOCITY_MAX_MPS: f64 = 10.0;
/// See [`ANY_VELOCITY_MAX_MPS`].
pub const ANY_SENT_VELOCITY_MAX_MPS: f64 = 20.0;

/// The largest steering angle that a vehicle may be described with, and the largest that one may be sent [rad].
pub const ANY_STEERING_MAX_RAD: f64 = 0.6;
/// See [`ANY_STEERING_MAX_RAD`].
pub const ANY_SENT_STEERING_MAX_RAD: f64 = 0.8;

/// How far desired values may be outside of their bounds [m/s, rad]: the rounding of a solver, no more.
pub const ROUNDING: f64 = 1e-6;

settings! {
    /// Bounds (7.41)-(7.44); those of the position, (7.45) and (7.46), belong to the track.
    #[derive(Copy)]
    pub struct Bounds {
        /// Smallest velocity in either direction, (7.41) [m/s]. It is above zero because the model divides by it.
        pub velocity_min_mps: f64 = 0.1, (BOUND_MIN_MPS..=ANY_VELOCITY_MAX_MPS, "at most `velocity_max_mps`");
        /// Largest velocity, (7.41) [m/s].
        pub velocity_max_mps: f64 = 1.0,
            (
                BOUND_MIN_MPS..=ANY_VELOCITY_MAX_MPS,
                "at least `velocity_min_mps`; by the factor of `actuator.calibration` at most `sent_velocity_max_mps`",
            );
        /// Largest velocity backwards, at most `velocity_max_mps`; below `velocity_min_mps`, as 0, the vehicle cannot drive
        /// backwards [m/s].
        pub reverse_max_mps: f64 = 0.3, 0.0..=ANY_VELOCITY_MAX_MPS;
        /// Largest steering angle to either side, (7.41) [rad].
        pub steering_max_rad: f64 = STEERING_MAX_RAD,
            (0.001..=ANY_STEERING_MAX_RAD, "at most `sent_steering_max_rad`");
        /// Largest velocity that may be sent, after `actuator.calibration`, in either direction [m/s].
        pub sent_velocity_max_mps: f64 = 2.0,
            (BOUND_MIN_MPS..=ANY_SENT_VELOCITY_MAX_MPS, "at least `velocity_max_mps` by the factor of `actuator.calibration`");
        /// Largest steering angle that may be sent, after `actuator.calibration`, to either side [rad].
        pub sent_steering_max_rad: f64 = 0.12,
            (0.001..=ANY_SENT_STEERING_MAX_RAD, "at least `steering_max_rad`");
        /// Largest sideslip angle to either side, (7.42) [rad].
        pub sideslip_max_rad: f64 = 0.15, 0.001..=1.5;
        /// Largest yaw to either side, (7.43) [rad].
        pub yaw_max_rad: f64 = std::f64::consts::PI, 0.1..=10.0;
        /// Largest yaw rate to either side, (7.44) [rad/s].
        pub yaw_rate_max_radps: f64 = 0.8, 0.01..=100.0;
    }
}

impl Bounds {
    /// Passes when the smallest velocity is not above the largest one, and no steering angle above what may be sent.
    ///
    /// # Errors
    /// [`Invalid`] with the value, and all that its own range leaves of it.
    pub fn require_order(&self) -> Result<(), Invalid> {
        require("velocity_min_mps", self.velocity_min_mps, BOUND_MIN_MPS..=self.velocity_max_mps)?;
        let (steering_rad, sent_rad) = (self.steering_max_rad, self.sent_steering_max_rad);
        if steering_rad > sent_rad {
            let allowed = format!("0.001 to {sent_rad}, as `sent_steering_max_rad` is {sent_rad}");
            return Err(Invalid::new("steering_max_rad", steering_rad, allowed));
        }
        Ok(())
    }

    /// Whether the robot may be sent these values, up to `tolerance`; false for NaN.
    pub fn allow_sent(&self, velocity: f64, steering: f64, tolerance: f64) -> bool {
        velocity.abs() <= self.sent_velocity_max_mps + tolerance
            && steering.abs() <= self.sent_steering_max_rad + tolerance
    }

    /// Those of the vehicle turned round, whose velocities are the ones backwards; `None` where it cannot drive backwards.
    #[must_use]
    pub fn mirrored(&self) -> Option<Self> {
        let velocity_max_mps = self.reverse_max_mps.min(self.velocity_max_mps);
        (velocity_max_mps >= self.velocity_min_mps).then_some(Self { velocity_max_mps, ..*self })
    }

    /// The nearest admissible control forwards.
    #[must_use]
    pub fn clamp(&self, control: Control) -> Control {
        Control {
            velocity: control.velocity.clamp(self.velocity_min_mps, self.velocity_max_mps),
            steering: control.steering.clamp(-self.steering_max_rad, self.steering_max_rad),
        }
    }

    /// Whether the control is admissible forwards up to `tolerance`; false for NaN.
    pub fn contains(&self, control: Control, tolerance: f64) -> bool {
        control.velocity >= self.velocity_min_mps - tolerance
            && control.velocity <= self.velocity_max_mps + tolerance
            && control.steering.abs() <= self.steering_max_rad + tolerance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_of_the_smallest_velocity_is_one_that_its_own_rule_allows() {
        let bounds = |velocity_min_mps| Bounds { velocity_min_mps, ..Bounds::default() };
        let refused = bounds(1.5).require_order().unwrap_err();
        assert_eq!(refused.to_string(), "velocity_min_mps = 1.5 is not allowed: 0.02 to 1");
        for end in [0.02, 1.0] {
            assert_eq!(bounds(end).require_ranges().and_then(|()| bounds(end).require_order()), Ok(()));
        }
    }

    #[test]
    fn what_may_be_desired_is_at_most_what_may_be_sent() {
        let steering = |sent_steering_max_rad| {
            Bounds { steering_max_rad: 0.3, sent_steering_max_rad, ..Bounds::default() }.require_order()
        };
        assert_eq!(steering(0.3), Ok(()));
        assert_eq!(
            steering(0.12).unwrap_err().to_string(),
            "steering_max_rad = 0.3 is not allowed: 0.001 to 0.12, as `sent_steering_max_rad` is 0.12"
        );
        let bounds = Bounds::default();
        assert!(bounds.allow_sent(-2.0, 0.12, 0.0) && bounds.allow_sent(2.0 + 1e-9, 0.0, 1e-6));
        assert!(
            ![(2.1, 0.0), (0.0, -0.13), (f64::NAN, 0.0), (0.0, f64::NAN)]
                .iter()
                .any(|(velocity, steering)| bounds.allow_sent(*velocity, *steering, 1e-6))
        );
    }

    #[test]
    fn a_vehicle_drives_backwards_from_its_smallest_velocity_on() {
        let backwards = |reverse_max_mps| Bounds { reverse_max_mps, ..Bounds::default() }.mirrored();
        assert_eq!(backwards(0.3).map(|bounds| bounds.velocity_max_mps), Some(0.3));
        assert_eq!(backwards(1.5).map(|bounds| bounds.velocity_max_mps), Some(1.0));
        assert_eq!([backwards(0.0), backwards(0.09)], [None; 2]);
    }

    #[test]
    fn nan_is_never_admissible() {
        assert!(!Bounds::default().contains(Control { velocity: f64::NAN, steering: 0.0 }, 1e-9));
        assert!(!Bounds::default().contains(Control { velocity: 0.5, steering: f64::NAN }, 1e-9));
    }
}
