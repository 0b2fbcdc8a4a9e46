//! Whether two outlines can be of one convex body: what is seen of both lies on the front of their convex hull.
//!
//! A return shows that nothing is between it and the scanner. So where a seen point lies behind the sides of the hull that
//! face the scanner, there is a hollow, and a body with that hull would fill it.

use nalgebra::Vector2;
use vehicle::frame::to_robot;
use vehicle::geometry::{Rectangle, ray_in_box};

use crate::outline::Vertex;
use crate::points::Beams;

/// Hollows up to this depth are filled: a room is that much smaller [m].
pub(crate) const HOLLOW_M: f64 = 0.15;
/// A point is hidden by what is nearer by this share of its distance.
const HIDDEN_SHARE: f64 = 0.002;
/// Places along each side of a box at which its hollow is measured, as shares of the side.
const PLACES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// A convex hull; buffers are kept.
#[derive(Debug, Clone, Default)]
pub(crate) struct Hull {
    points: Vec<Vector2<f64>>,
    /// Its corners, counter-clockwise.
    corners: Vec<Vector2<f64>>,
}

impl Hull {
    /// Buffers large enough for the outlines of any scan.
    pub(crate) fn with_capacity(beams: &Beams) -> Self {
        let capacity = 4 * beams.count() + 4;
        Self { points: Vec::with_capacity(capacity), corners: Vec::with_capacity(capacity + 1) }
    }

    /// Whether one body around a box and an outline that is seen would fill a hollow, seen from `robot`.
    pub(crate) fn is_hollow(&mut self, body: &Rectangle, outline: &[Vertex], robot: Vector2<f64>) -> bool {
        let seen = || outline.iter().map(|vertex| vertex.at);
        self.wrap(body.corners().into_iter().chain(seen()));
        let [Some(first), Some(last)] = [outline.first(), outline.last()] else { return false };
        let [right, left] = [first.at - robot, last.at - robot];
        let is_hidden = |point: &Vector2<f64>| {
            let way = point - robot;
            cross(right, way) > 0.0 && cross(way, left) > 0.0
        };
        self.is_deep(faces(body, robot).filter(|point| !is_hidden(point)), robot)
            || self.is_deep(seen(), robot)
    }

    /// Whether one body around two boxes would fill a hollow, seen from `robot`.
    pub(crate) fn is_hollow_between(
        &mut self,
        one: &Rectangle,
        other: &Rectangle,
        robot: Vector2<f64>,
    ) -> bool {
        self.wrap(one.corners().into_iter().chain(other.corners()));
        let seen = |body: &Rectangle, other: &Rectangle| {
            let is_seen = |point: &Vector2<f64>| !hides(other, *point, robot);
            self.is_deep(faces(body, robot).filter(is_seen), robot)
        };
        seen(one, other) || seen(other, one)
    }

    fn is_deep(&self, mut points: impl Iterator<Item = Vector2<f64>>, robot: Vector2<f64>) -> bool {
        points.any(|point| self.depth_of(point, robot) > HOLLOW_M)
    }

    /// Finds the corners (Andrew's monotone chain).
    fn wrap(&mut self, around: impl Iterator<Item = Vector2<f64>>) {
        let Self { points, corners } = self;
        points.clear();
        points.extend(around);
        points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        corners.clear();
        chain(corners, points.iter());
        let lower = corners.len();
        chain_from(corners, lower, points.iter().rev().skip(1));
        corners.pop();
    }

    /// How far a point is behind the sides of the hull that face the `robot`; all of the way to it when the robot is within
    /// the hull [m].
    fn depth_of(&self, point: Vector2<f64>, robot: Vector2<f64>) -> f64 {
        let mut depth = (point - robot).norm();
        for (index, corner) in self.corners.iter().enumerate() {
            let side = self.corners[(index + 1) % self.corners.len()] - corner;
            let normal = Vector2::new(side.y, -side.x);
            if normal.dot(&(robot - corner)) > 0.0 {
                depth = depth.min(normal.dot(&(corner - point)) / normal.norm().max(1e-9));
            }
        }
        depth
    }
}

/// Appends the points of a chain that turns left.
fn chain<'a>(corners: &mut Vec<Vector2<f64>>, points: impl Iterator<Item = &'a Vector2<f64>>) {
    chain_from(corners, 1, points);
}

/// The same behind the first `kept` corners.
fn chain_from<'a>(
    corners: &mut Vec<Vector2<f64>>,
    kept: usize,
    points: impl Iterator<Item = &'a Vector2<f64>>,
) {
    for point in points {
        while corners.len() > kept
            && let [.., before, last] = corners[..]
            && cross(last - before, point - last) <= 0.0
        {
            corners.pop();
        }
        corners.push(*point);
    }
}

/// Places along the sides of a box that face the robot.
fn faces(body: &Rectangle, robot: Vector2<f64>) -> impl Iterator<Item = Vector2<f64>> {
    let corners = body.corners();
    let centre = body.centre;
    (0..4).flat_map(move |index| {
        let (from, to) = (corners[index], corners[(index + 1) % 4]);
        let side = to - from;
        let normal = Vector2::new(side.y, -side.x);
        let outward = normal * normal.dot(&(from - centre)).signum();
        let faces = outward.dot(&(robot - from)) > 0.0;
        PLACES.into_iter().filter(move |_| faces).map(move |share| from + side * share)
    })
}

/// Whether a box is before a point, seen from the robot.
fn hides(body: &Rectangle, point: Vector2<f64>, robot: Vector2<f64>) -> bool {
    let (offset, way) = (robot - body.centre, point - robot);
    let start = to_robot(body.yaw, offset.x, offset.y);
    let ray = to_robot(body.yaw, way.x, way.y);
    let half = Vector2::new(body.length, body.width) / 2.0;
    ray_in_box(start, ray, half).is_some_and(|(enter, _)| enter < 1.0 - HIDDEN_SHARE)
}

/// Positive where `b` is to the left of `a`.
pub(crate) fn cross(a: Vector2<f64>, b: Vector2<f64>) -> f64 {
    a.x * b.y - a.y * b.x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::End;

    fn body(x: f64, y: f64, length: f64, width: f64, yaw: f64) -> Rectangle {
        Rectangle { centre: Vector2::new(x, y), yaw, length, width }
    }

    fn is_hollow(one: &Rectangle, other: &Rectangle) -> bool {
        let mut hull = Hull::default();
        let seen = hull.is_hollow_between(one, other, Vector2::zeros());
        assert_eq!(seen, hull.is_hollow_between(other, one, Vector2::zeros()));
        seen
    }

    #[test]
    fn boxes_in_a_row_are_one_body_and_those_around_a_hollow_are_two() {
        let wall = body(5.0, 0.0, 0.1, 2.0, 0.0);
        assert!(!is_hollow(&wall, &body(5.03, 1.5, 0.1, 1.0, 0.02)), "its continuation");
        assert!(!is_hollow(&wall, &body(5.0, 0.3, 0.1, 0.4, 0.0)), "a part of it");
        let beside = body(5.0, 2.0, 0.1, 2.0, 0.0);
        assert!(!is_hollow(&beside, &body(6.0, 1.1, 2.0, 0.2, 0.0)), "its side");
        assert!(is_hollow(&wall, &body(4.0, 1.0, 2.0, 0.1, 0.0)), "a corner of a room");
        assert!(is_hollow(&wall, &body(4.8, 0.0, 0.3, 0.3, 0.0)), "a box before it");
        assert!(is_hollow(&body(5.0, 0.0, 0.4, 0.4, 0.0), &body(5.3, 0.4, 0.4, 0.4, 0.0)));
    }

    #[test]
    fn the_side_of_a_body_whose_front_was_taken_for_wider_is_no_hollow() {
        // The robot sees the side at y = 0.7 almost along it; the front was known from 0.6 on.
        let outline = [[5.2, 0.7], [4.8, 0.7], [4.8, 1.1]].map(|at| Vertex { at: at.into(), end: End::Seen });
        let front = body(4.8, 0.85, 0.05, 0.5, 0.0);
        assert!(!Hull::default().is_hollow(&front, &outline, Vector2::zeros()));
    }

    #[test]
    fn the_depth_within_a_hull_is_measured_from_the_sides_that_face_the_robot() {
        let mut hull = Hull::default();
        // A room of 4 m x 2 m around the robot: all of the way to its wall is inside.
        hull.is_hollow_between(
            &body(4.0, 0.0, 0.1, 2.0, 0.0),
            &body(2.0, -1.0, 4.0, 0.1, 0.0),
            Vector2::zeros(),
        );
        assert!((hull.depth_of(Vector2::new(3.0, -0.4), Vector2::new(2.0, -0.4)) - 1.0).abs() < 1e-12);
        assert!((hull.depth_of(Vector2::new(3.0, -0.95), Vector2::new(3.0, -3.0)) - 0.1).abs() < 1e-9);
    }
}
