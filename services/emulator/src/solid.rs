//! The body of an obstacle at one moment: distances and ray casting.

use nalgebra::Vector2;
use vehicle::frame::heading;
use vehicle::geometry::{Rectangle, ray_in_box};

/// An upright body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// A cylinder.
    Circle {
        /// Centre [m].
        centre: Vector2<f64>,
        /// Radius [m].
        radius: f64,
    },
    /// A box.
    Box {
        /// Outline seen from above.
        outline: Rectangle,
        /// Unit vector of its length axis, so that a ray needs no trigonometry.
        axis: Vector2<f64>,
    },
}

impl Solid {
    /// A cylinder.
    pub fn circle(centre: Vector2<f64>, radius: f64) -> Self {
        Self::Circle { centre, radius }
    }

    /// A box.
    pub fn rectangle(outline: Rectangle) -> Self {
        Self::Box { outline, axis: heading(outline.yaw) }
    }

    /// The same body elsewhere.
    #[must_use]
    pub fn moved_by(self, offset: Vector2<f64>) -> Self {
        match self {
            Self::Circle { centre, radius } => Self::Circle { centre: centre + offset, radius },
            Self::Box { outline, axis } => {
                Self::Box { outline: Rectangle { centre: outline.centre + offset, ..outline }, axis }
            }
        }
    }

    /// Distance to the robot's body, negative when they overlap [m].
    pub fn distance_to(&self, body: &Rectangle) -> f64 {
        match self {
            Self::Circle { centre, radius } => body.distance_to_circle(*centre, *radius),
            Self::Box { outline, .. } => body.distance_to_rectangle(outline),
        }
    }

    /// Smallest coordinate of the body along a direction (unit vector), from the origin of the track [m].
    pub fn nearest_along(&self, direction: Vector2<f64>) -> f64 {
        match self {
            Self::Circle { centre, radius } => centre.dot(&direction) - radius,
            Self::Box { outline, .. } => {
                outline.corners().iter().map(|corner| corner.dot(&direction)).fold(f64::INFINITY, f64::min)
            }
        }
    }

    /// Distance along a ray (unit `direction`) to the surface [m]; zero inside, `None` when the ray misses.
    pub fn ray(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> Option<f64> {
        match self {
            Self::Circle { centre, radius } => ray_to_circle(origin - centre, direction, *radius),
            Self::Box { outline, axis } => {
                let offset = origin - outline.centre;
                let half = Vector2::new(outline.length / 2.0, outline.width / 2.0);
                ray_in_box(in_axes(offset, *axis), in_axes(direction, *axis), half).map(|(enter, _)| enter)
            }
        }
    }
}

fn in_axes(vector: Vector2<f64>, axis: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(vector.x * axis.x + vector.y * axis.y, vector.y * axis.x - vector.x * axis.y)
}

/// `offset` is the origin of the ray seen from the centre.
fn ray_to_circle(offset: Vector2<f64>, direction: Vector2<f64>, radius: f64) -> Option<f64> {
    let excess = offset.norm_squared() - radius * radius;
    if excess <= 0.0 {
        return Some(0.0);
    }
    let approach = -offset.dot(&direction);
    let discriminant = approach * approach - excess;
    (approach > 0.0 && discriminant >= 0.0).then(|| approach - discriminant.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_4, SQRT_2};

    fn ray(solid: &Solid, from: [f64; 2], yaw: f64) -> Option<f64> {
        solid.ray(Vector2::from(from), Vector2::new(yaw.cos(), yaw.sin()))
    }

    fn outline(x: f64, y: f64, yaw: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(x, y), yaw, length: 2.0, width: 2.0 }
    }

    #[test]
    fn a_ray_ends_at_the_near_side_of_a_circle() {
        let circle = Solid::circle(Vector2::new(5.0, 0.0), 0.5);
        assert_eq!(ray(&circle, [0.0, 0.0], 0.0), Some(4.5));
        // 3-4-5 triangle: 0.3 to the side of the centre, the surface is 0.4 before it.
        assert!((ray(&circle, [0.0, 0.3], 0.0).unwrap() - 4.6).abs() < 1e-12);
        assert_eq!(ray(&circle, [0.0, 0.6], 0.0), None);
        assert_eq!(ray(&circle, [7.0, 0.0], 0.0), None, "a circle behind is not seen");
        assert_eq!(ray(&circle, [5.1, 0.0], 0.0), Some(0.0), "inside");
    }

    #[test]
    fn a_ray_ends_at_the_near_face_or_corner_of_a_box() {
        let upright = Solid::rectangle(outline(5.0, 0.0, 0.0));
        assert_eq!(ray(&upright, [0.0, 0.9], 0.0), Some(4.0));
        assert_eq!(ray(&upright, [0.0, 1.1], 0.0), None);
        assert_eq!(ray(&upright, [9.0, 0.0], 0.0), None, "a box behind is not seen");
        let turned = Solid::rectangle(outline(5.0, 0.0, FRAC_PI_4));
        assert!((ray(&turned, [0.0, 0.0], 0.0).unwrap() - (5.0 - SQRT_2)).abs() < 1e-9);
        // 45 deg from (0, 0) meets the front left edge of the box at (4, 4) where its corner (4, 5 - 1) is.
        let diagonal = Solid::rectangle(outline(5.0, 5.0, 0.0));
        assert!((ray(&diagonal, [0.0, 0.0], FRAC_PI_4).unwrap() - 4.0 * SQRT_2).abs() < 1e-9);
    }

    #[test]
    fn the_nearest_point_along_a_direction_is_a_corner_or_the_rim() {
        let forward = Vector2::new(1.0, 0.0);
        assert!(
            (Solid::rectangle(outline(5.0, 0.0, FRAC_PI_4)).nearest_along(forward) - 5.0 + SQRT_2).abs()
                < 1e-12
        );
        assert_eq!(Solid::circle(Vector2::new(5.0, 1.0), 0.5).nearest_along(forward), 4.5);
    }
}
