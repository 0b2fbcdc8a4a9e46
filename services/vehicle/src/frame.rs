//! Angles and rotations between the robot's frame and the track's.

use nalgebra::Vector2;
use std::f64::consts::{PI, TAU};

/// The angle in (-pi, pi].
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = angle - TAU * (angle / TAU).round();
    if wrapped <= -PI { wrapped + TAU } else { wrapped }
}

/// Unit vector in the direction of a yaw.
pub fn heading(yaw: f64) -> Vector2<f64> {
    let (sin, cos) = yaw.sin_cos();
    Vector2::new(cos, sin)
}

/// A vector in robot coordinates (forward, left) turned into track coordinates, the rotation of (7.32), (7.33).
///
/// Source note: the text uses xi = -yaw in a frame with y to the right; in ours the form is the same with yaw.
pub fn to_track(yaw: f64, forward: f64, left: f64) -> Vector2<f64> {
    let (sin, cos) = yaw.sin_cos();
    Vector2::new(forward * cos - left * sin, left * cos + forward * sin)
}

/// A vector in track coordinates turned into robot coordinates (forward, left).
pub fn to_robot(yaw: f64, x: f64, y: f64) -> Vector2<f64> {
    to_track(-yaw, x, y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn angles_wrap_into_the_half_open_circle() {
        assert!((wrap_angle(3.0 * PI) - PI).abs() < 1e-12);
        assert!((wrap_angle(-PI) - PI).abs() < 1e-12);
        assert!((wrap_angle(TAU + 0.1) - 0.1).abs() < 1e-12);
        assert_eq!(wrap_angle(0.25), 0.25);
    }

    #[test]
    fn forward_of_a_robot_that_looks_left_is_left() {
        let ahead = to_track(FRAC_PI_2, 2.0, 0.0);
        assert!((ahead - Vector2::new(0.0, 2.0)).norm() < 1e-12);
        let back = to_robot(FRAC_PI_2, ahead.x, ahead.y);
        assert!((back - Vector2::new(2.0, 0.0)).norm() < 1e-12);
    }
}
