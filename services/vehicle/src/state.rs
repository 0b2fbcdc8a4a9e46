//! State and control of the model as named values.

use std::f64::consts::PI;

use nalgebra::SVector;

use crate::frame::wrap_angle;

/// Largest sideslip that the model keeps [rad]: it divides by the cosine, and describes no robot that slides sideways. What
/// grows beyond stays there.
pub const SIDEWAYS_RAD: f64 = 1.4;

/// Largest yaw rate that the model keeps [rad/s]: the smallest allowed vehicle turns steadily at 240 rad/s at most.
pub(crate) const SPIN_RADPS: f64 = 1e3;

/// State of (7.27)-(7.31).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Sideslip, x1 [rad].
    pub sideslip: f64,
    /// Yaw, x2 [rad].
    pub yaw: f64,
    /// Yaw rate, x3 [rad/s].
    pub yaw_rate: f64,
    /// Position along the track, x4 [m].
    pub x: f64,
    /// Lateral position, left positive, x5 [m].
    pub y: f64,
}

/// Control of (7.27)-(7.31).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Control {
    /// Velocity, u1; negative backwards [m/s].
    pub velocity: f64,
    /// Steering angle of the front axle, u2 [rad]; the rear axle steers by the opposite angle.
    pub steering: f64,
}

impl State {
    /// The state as (x1, x2, x3, x4, x5).
    pub fn to_vector(self) -> SVector<f64, 5> {
        SVector::from([self.sideslip, self.yaw, self.yaw_rate, self.x, self.y])
    }

    /// The state from (x1, x2, x3, x4, x5).
    pub fn from_vector(vector: &SVector<f64, 5>) -> Self {
        Self { sideslip: vector[0], yaw: vector[1], yaw_rate: vector[2], x: vector[3], y: vector[4] }
    }

    /// The state with sideslip and yaw rate no larger than the model keeps them.
    #[must_use]
    pub fn bounded(self) -> Self {
        Self {
            sideslip: self.sideslip.clamp(-SIDEWAYS_RAD, SIDEWAYS_RAD),
            yaw_rate: self.yaw_rate.clamp(-SPIN_RADPS, SPIN_RADPS),
            ..self
        }
    }

    /// The same motion of the robot turned round: it drives forwards where this one drives backwards.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { yaw: wrap_angle(self.yaw + PI), ..self }
    }

    /// Whether all components are finite.
    pub fn is_finite(&self) -> bool {
        self.to_vector().iter().all(|value| value.is_finite())
    }
}

impl Control {
    /// The same control for the robot turned round, whose front axle is the rear one.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { velocity: -self.velocity, steering: -self.steering }
    }

    /// Whether both components are finite.
    pub fn is_finite(&self) -> bool {
        self.velocity.is_finite() && self.steering.is_finite()
    }
}
