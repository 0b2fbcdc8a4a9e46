//! Motion of a body: one Kalman filter with constant velocity, and one for a body at rest.
//!
//! Both use the same measured place of the body's reference point. The place is measured along two axes: the one
//! towards the robot, where the nearest surface shows it, and the one across, where both ends must move the same
//! way. A part that comes into view moves one end only and is no motion; it comes into view at an end that something
//! hides, and then the other end alone shows the motion. The filter at rest has the smaller gain and
//! gives the place of a static body; the other decides whether it moves.
//!
//! Where it fails: errors of the pose are common to all bodies and change slowly, so with a drifting pose static
//! bodies seem to move. So a body counts as moving only when it has also left its place.

use nalgebra::{Matrix2, Matrix2x4, Matrix4, SMatrix, Vector2, Vector4};

/// Accelerations that a body may have, standard deviation [m/s^2].
const ACCELERATION: f64 = 0.25;
/// Standard deviation of the velocity of a body just seen [m/s].
const FIRST_SPEED: f64 = 0.7;
/// How far the place of a body at rest may wander in a second, standard deviation [m].
const WANDER: f64 = 0.01;

/// Place and velocity with covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    /// Place and velocity (x, y, vx, vy) [m, m/s].
    pub(crate) state: Vector4<f64>,
    /// Their covariance.
    pub(crate) covariance: Matrix4<f64>,
}

impl Motion {
    /// A body just seen.
    pub(crate) fn start(at: Vector2<f64>, noise: f64) -> Self {
        let (place, speed) = (noise * noise, FIRST_SPEED * FIRST_SPEED);
        Self {
            state: Vector4::new(at.x, at.y, 0.0, 0.0),
            covariance: Matrix4::from_diagonal(&Vector4::new(place, place, speed, speed)),
        }
    }

    /// Place [m].
    pub(crate) fn place(&self) -> Vector2<f64> {
        self.state.fixed_rows::<2>(0).into()
    }

    /// Velocity [m/s].
    pub(crate) fn velocity(&self) -> Vector2<f64> {
        self.state.fixed_rows::<2>(2).into()
    }

    /// Covariance of the velocity [m^2/s^2].
    pub(crate) fn velocity_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(2, 2).into()
    }

    /// The body `elapsed` seconds later.
    pub(crate) fn predict(&mut self, elapsed: f64) {
        let mut transition = Matrix4::identity();
        transition[(0, 2)] = elapsed;
        transition[(1, 3)] = elapsed;
        self.state = transition * self.state;
        self.covariance = transition * self.covariance * transition.transpose();
        // White acceleration, constant over the time elapsed.
        let power = ACCELERATION * ACCELERATION;
        let (square, half) = (elapsed * elapsed, elapsed * elapsed / 2.0);
        for axis in 0..2 {
            self.covariance[(axis, axis)] += power * half * half;
            self.covariance[(axis, axis + 2)] += power * half * elapsed;
            self.covariance[(axis + 2, axis)] += power * half * elapsed;
            self.covariance[(axis + 2, axis + 2)] += power * square;
        }
    }

    /// Measurement update with a measured place, in the Joseph form.
    pub(crate) fn update(&mut self, measured: Vector2<f64>, noise: &Matrix2<f64>) {
        let observe = Matrix2x4::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
        let cross: SMatrix<f64, 4, 2> = self.covariance.fixed_view::<4, 2>(0, 0).into();
        let innovation = self.covariance.fixed_view::<2, 2>(0, 0) + noise;
        let Some(inverse) = innovation.try_inverse() else { return };
        let gain = cross * inverse;
        self.state += gain * (measured - self.place());
        let keep = Matrix4::identity() - gain * observe;
        let covariance = keep * self.covariance * keep.transpose() + gain * noise * gain.transpose();
        self.covariance = (covariance + covariance.transpose()) * 0.5;
    }

    /// Keeps a body that stands from drifting along an axis on which nothing was measured.
    pub(crate) fn hold(&mut self, axis: Vector2<f64>, rest: Vector2<f64>) {
        let place = self.place() + axis * axis.dot(&(rest - self.place()));
        let velocity = self.velocity() - axis * axis.dot(&self.velocity());
        self.state = Vector4::new(place.x, place.y, velocity.x, velocity.y);
        if self.velocity_covariance().trace() > 2.0 * FIRST_SPEED * FIRST_SPEED {
            *self = Self::start(place, self.covariance[(0, 0)].max(self.covariance[(1, 1)]).sqrt().min(0.3));
        }
    }

    /// Squared distance of the velocity from zero in standard deviations, and the speed [m/s].
    pub(crate) fn significance(&self) -> (f64, f64) {
        let velocity = self.velocity();
        let squared = self
            .velocity_covariance()
            .cholesky()
            .map_or(0.0, |factor| velocity.dot(&factor.solve(&velocity)));
        (squared, velocity.norm())
    }
}

/// Place of a body at rest with covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rest {
    /// Place [m].
    pub(crate) place: Vector2<f64>,
    /// Its covariance [m^2].
    pub(crate) covariance: Matrix2<f64>,
}

impl Rest {
    /// Measurement update with a measured place, `elapsed` seconds after the last.
    pub(crate) fn update(&mut self, measured: Vector2<f64>, noise: &Matrix2<f64>, elapsed: f64) {
        let predicted = self.covariance + Matrix2::identity() * (WANDER * WANDER * elapsed);
        let Some(inverse) = (predicted + noise).try_inverse() else { return };
        let gain = predicted * inverse;
        self.place += gain * (measured - self.place);
        let keep = Matrix2::identity() - gain;
        let covariance = keep * predicted * keep.transpose() + gain * noise * gain.transpose();
        self.covariance = (covariance + covariance.transpose()) * 0.5;
    }
}

/// Covariance of a place measured along `axis` and across it with these standard deviations [m].
pub(crate) fn noise_along(axis: Vector2<f64>, along: f64, across: f64) -> Matrix2<f64> {
    let side = Vector2::new(-axis.y, axis.x);
    axis * axis.transpose() * (along * along) + side * side.transpose() * (across * across)
}

/// The move that both ends agree on: zero when they disagree, else their mean, at most twice the smaller.
pub(crate) fn agreed(one: f64, other: f64) -> f64 {
    if one * other <= 0.0 {
        return 0.0;
    }
    let mean = (one + other) / 2.0;
    mean.abs().min(2.0 * one.abs().min(other.abs())).copysign(mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_end_that_moves_alone_is_no_motion() {
        assert_eq!(agreed(0.3, 0.0), 0.0);
        assert_eq!(agreed(0.3, -0.1), 0.0);
        assert_eq!(agreed(-0.02, -0.04), -0.03);
    }

    #[test]
    fn a_steady_body_is_measured_without_bias() {
        let mut motion = Motion::start(Vector2::zeros(), 0.02);
        let noise = noise_along(Vector2::new(1.0, 0.0), 0.02, 0.02);
        for step in 1..=30 {
            motion.predict(0.1);
            motion.update(Vector2::new(0.04 * f64::from(step), 0.0), &noise);
        }
        // Without noise the filter has forgotten its start after 3 s.
        assert!((motion.velocity() - Vector2::new(0.4, 0.0)).norm() < 2e-3, "{}", motion.velocity());
        assert!(motion.significance().0 > 9.0);
    }
}
