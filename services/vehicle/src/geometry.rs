//! Distances between the robot's body, obstacles and walls.

use nalgebra::Vector2;

use crate::frame::{to_robot, to_track};

/// A rectangle with any orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Centre [m].
    pub centre: Vector2<f64>,
    /// Direction of the length axis [rad].
    pub yaw: f64,
    /// Full length [m].
    pub length: f64,
    /// Full width [m].
    pub width: f64,
}

impl Rectangle {
    /// The body of a robot whose reference point is at (x, y), with its middle `ahead` of it [m].
    pub fn of_robot([x, y, yaw]: [f64; 3], ahead: f64, length: f64, width: f64) -> Self {
        Self { centre: Vector2::new(x, y) + to_track(yaw, ahead, 0.0), yaw, length, width }
    }

    /// The corners, counter-clockwise from front left.
    pub fn corners(&self) -> [Vector2<f64>; 4] {
        let (half_length, half_width) = (self.length / 2.0, self.width / 2.0);
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(forward, left)| self.centre + to_track(self.yaw, forward * half_length, left * half_width))
    }

    /// The edges as pairs of corners.
    pub fn edges(&self) -> [(Vector2<f64>, Vector2<f64>); 4] {
        let corners = self.corners();
        [0, 1, 2, 3].map(|index| (corners[index], corners[(index + 1) % 4]))
    }

    /// The point of the rectangle nearest to `point`.
    pub fn nearest_to(&self, point: Vector2<f64>) -> Vector2<f64> {
        let offset = point - self.centre;
        let local = to_robot(self.yaw, offset.x, offset.y);
        let (half_length, half_width) = (self.length / 2.0, self.width / 2.0);
        let (forward, left) =
            (local.x.clamp(-half_length, half_length), local.y.clamp(-half_width, half_width));
        self.centre + to_track(self.yaw, forward, left)
    }

    /// Distance of a point to the surface, negative inside [m].
    pub fn distance_to_point(&self, point: Vector2<f64>) -> f64 {
        let offset = point - self.centre;
        let local = to_robot(self.yaw, offset.x, offset.y);
        let outside = Vector2::new(local.x.abs() - self.length / 2.0, local.y.abs() - self.width / 2.0);
        let beyond = Vector2::new(outside.x.max(0.0), outside.y.max(0.0)).norm();
        beyond + outside.x.max(outside.y).min(0.0)
    }

    /// Distance to a circle, negative when they overlap [m].
    pub fn distance_to_circle(&self, centre: Vector2<f64>, radius: f64) -> f64 {
        self.distance_to_point(centre) - radius
    }

    /// Distance to another rectangle, negative by the depth of overlap [m].
    pub fn distance_to_rectangle(&self, other: &Self) -> f64 {
        let depth = separation(self, other).max(separation(other, self));
        if depth <= 0.0 {
            return depth;
        }
        let mut nearest = f64::INFINITY;
        for corner in other.corners() {
            nearest = nearest.min(self.distance_to_point(corner));
        }
        for corner in self.corners() {
            nearest = nearest.min(other.distance_to_point(corner));
        }
        nearest
    }

    /// Distance to the line y = `wall`, negative when the rectangle reaches beyond it on the far side of `inside_y`
    /// [m].
    pub fn distance_to_wall(&self, wall: f64, inside_y: f64) -> f64 {
        let sign = if inside_y <= wall { 1.0 } else { -1.0 };
        self.corners().iter().map(|corner| sign * (wall - corner.y)).fold(f64::INFINITY, f64::min)
    }
}

/// Distances along a ray at which it enters and leaves a box about the origin; it enters at zero from inside, and
/// `None` is a miss.
///
/// The slab method: the ray is inside the box where it is inside both strips. `half` has half the sizes of the box.
pub fn ray_in_box(origin: Vector2<f64>, direction: Vector2<f64>, half: Vector2<f64>) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for axis in 0..2 {
        if direction[axis].abs() < 1e-12 {
            // Parallel to the strip: always inside or never.
            if origin[axis].abs() > half[axis] {
                return None;
            }
            continue;
        }
        let low = (-half[axis] - origin[axis]) / direction[axis];
        let high = (half[axis] - origin[axis]) / direction[axis];
        enter = enter.max(low.min(high));
        leave = leave.min(low.max(high));
    }
    (enter <= leave).then_some((enter, leave))
}

/// Largest gap between the rectangles along the axes of `frame`; negative when they overlap on both axes.
fn separation(frame: &Rectangle, other: &Rectangle) -> f64 {
    let local = other.corners().map(|corner| {
        let offset = corner - frame.centre;
        to_robot(frame.yaw, offset.x, offset.y)
    });
    let gap = |half: f64, coordinate: fn(&Vector2<f64>) -> f64| {
        let low = local.iter().map(coordinate).fold(f64::INFINITY, f64::min);
        let high = local.iter().map(coordinate).fold(f64::NEG_INFINITY, f64::max);
        (low - half).max(-half - high)
    };
    gap(frame.length / 2.0, |point| point.x).max(gap(frame.width / 2.0, |point| point.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, yaw: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(x, y), yaw, length: 2.0, width: 2.0 }
    }

    #[test]
    fn distances_of_squares_side_by_side_at_a_corner_and_overlapping() {
        assert!((square(0.0, 0.0, 0.0).distance_to_rectangle(&square(3.0, 0.0, 0.0)) - 1.0).abs() < 1e-12);
        let diagonal = square(0.0, 0.0, 0.0).distance_to_rectangle(&square(5.0, 6.0, 0.0));
        assert!((diagonal - 5.0).abs() < 1e-12);
        assert!((square(0.0, 0.0, 0.0).distance_to_rectangle(&square(1.5, 0.0, 0.0)) + 0.5).abs() < 1e-12);
        let turned =
            square(0.0, 0.0, 0.0).distance_to_rectangle(&square(3.0, 0.0, std::f64::consts::FRAC_PI_4));
        assert!((turned - (2.0 - 2.0_f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn the_middle_of_a_body_may_be_ahead_of_its_reference_point() {
        let body = Rectangle::of_robot([1.0, 2.0, std::f64::consts::FRAC_PI_2], 0.5, 3.0, 1.0);
        assert!((body.centre - Vector2::new(1.0, 2.5)).norm() < 1e-12);
        assert!((body.distance_to_point(Vector2::new(1.0, 5.0)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_point_inside_is_as_deep_as_its_nearest_edge() {
        assert!((square(0.0, 0.0, 0.0).distance_to_point(Vector2::new(0.75, 0.2)) + 0.25).abs() < 1e-12);
        assert!((square(0.0, 0.0, 0.0).distance_to_circle(Vector2::new(4.0, 5.0), 1.0) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_wall_is_as_far_as_the_nearest_corner() {
        assert!((square(0.0, 0.0, 0.0).distance_to_wall(1.5, 0.0) - 0.5).abs() < 1e-12);
        assert!((square(0.0, 0.0, 0.0).distance_to_wall(-0.75, 0.0) + 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_ray_enters_and_leaves_a_box_where_it_crosses_its_sides() {
        let (ahead, half) = (Vector2::new(1.0, 0.0), Vector2::new(1.0, 0.5));
        assert_eq!(ray_in_box(Vector2::new(-3.0, 0.2), ahead, half), Some((2.0, 4.0)));
        assert_eq!(ray_in_box(Vector2::new(0.25, 0.2), ahead, half), Some((0.0, 0.75)));
        assert_eq!(ray_in_box(Vector2::new(-3.0, 0.6), ahead, half), None);
    }
}
