//! From one pose to another with turns of one radius: forwards, or after a turn in three that is backwards in its middle.
//!
//! Forwards the way is the shortest of an arc, a line and an arc (L. E. Dubins, American Journal of Mathematics 79, 1957,
//! DOI 10.2307/2372560). Where it leads to a place behind the robot, it is a circle of two radii across; the turn in three
//! ends where it began, in the opposite direction, within half a radius to each side.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector2;

use super::Waypoint;
use crate::frame::{heading, wrap_angle};

/// What a change of the direction of travel costs, as a length [m].
const REVERSAL_M: f64 = 1.0;
/// Directions that are tried at a goal that has none.
const DIRECTIONS: u32 = 24;
/// The three parts of a turn in three [rad].
const THIRD_RAD: f64 = PI / 3.0;
/// Waypoints are no nearer to each other [m].
const APART_M: f64 = 0.06;
/// A part that is shorter than that is left out, which bends its neighbours a little: others are preferred [m].
const LEFT_OUT_M: f64 = 0.5;

/// A place and a direction.
#[derive(Debug, Clone, Copy)]
struct Place {
    point: Vector2<f64>,
    yaw: f64,
}

/// The way as waypoints, with its length and what its reversals cost [m].
#[derive(Debug, Clone)]
struct Way {
    waypoints: Vec<Waypoint>,
    place: Place,
    radius_m: f64,
    cost_m: f64,
}

impl Way {
    fn from(place: Place, radius_m: f64) -> Self {
        Self { waypoints: Vec::new(), place, radius_m, cost_m: 0.0 }
    }

    /// Turns by an angle to a side, 1 for the left, and forwards or backwards.
    fn turn(&mut self, side: f64, angle: f64, reverse: bool) {
        // Backwards the direction turns to the left about a point on the right.
        let arm = if reverse { -side * self.radius_m } else { side * self.radius_m };
        let parts = (angle / FRAC_PI_2).ceil().max(1.0);
        for _ in 0..parts as u32 {
            let centre = self.place.point + left(self.place.yaw) * arm;
            self.place.yaw += side * angle / parts;
            self.place.point = centre - left(self.place.yaw) * arm;
            self.reach(self.radius_m * angle / parts, reverse);
        }
    }

    fn straight(&mut self, way_m: f64) {
        self.place.point += heading(self.place.yaw) * way_m;
        self.reach(way_m, false);
    }

    /// Adds a waypoint where the robot is, unless it is near the last one.
    fn reach(&mut self, way_m: f64, reverse: bool) {
        self.cost_m += way_m + if (1e-6..APART_M).contains(&way_m) { LEFT_OUT_M } else { 0.0 };
        if way_m >= APART_M {
            let Place { point, yaw } = self.place;
            self.waypoints
                .push(Waypoint { reverse, ..Waypoint::new(point.x, point.y, Some(wrap_angle(yaw))) });
        }
    }

    /// Turns round where the robot is.
    fn turn_round(mut self, side: f64) -> Self {
        for reverse in [false, true, false] {
            self.turn(side, THIRD_RAD, reverse);
        }
        self.cost_m += 2.0 * REVERSAL_M;
        self
    }

    /// Continues to a place by an arc, a line and an arc; nothing where these arcs do not meet.
    fn forwards(mut self, to: Place, [first, last]: [f64; 2]) -> Option<Self> {
        let from = self.place;
        let way = to.point + left(to.yaw) * (last * self.radius_m)
            - from.point
            - left(from.yaw) * (first * self.radius_m);
        let sine = self.radius_m * (last - first) / way.norm();
        if way.norm() < 1e-9 || sine.abs() > 1.0 {
            return None;
        }
        let yaw = way.y.atan2(way.x) - sine.asin();
        // Rounding of no turn at all is none, and not a whole circle.
        let turn = |side: f64, angle: f64| {
            let angle = (side * angle).rem_euclid(TAU);
            if angle > TAU - 1e-6 { 0.0 } else { angle }
        };
        self.turn(first, turn(first, yaw - from.yaw), false);
        self.straight(way.dot(&heading(yaw)));
        self.turn(last, turn(last, to.yaw - yaw), false);
        Some(self)
    }
}

fn left(yaw: f64) -> Vector2<f64> {
    let along = heading(yaw);
    Vector2::new(-along.y, along.x)
}

/// The shortest way from a waypoint with a direction to another one, with turns of this radius: the waypoints behind the
/// first, which end with the other.
pub(super) fn between(from: &Waypoint, to: &Waypoint, radius_m: f64) -> Vec<Waypoint> {
    let place =
        |waypoint: &Waypoint, yaw: f64| Place { point: Vector2::new(waypoint.x_m, waypoint.y_m), yaw };
    let start = Way::from(place(from, from.yaw_rad.unwrap_or_default()), radius_m);
    let starts = [start.clone(), start.clone().turn_round(1.0), start.turn_round(-1.0)];
    let yaws: Vec<f64> = match to.yaw_rad {
        Some(yaw) => vec![yaw],
        None => (0..DIRECTIONS).map(|index| TAU * f64::from(index) / f64::from(DIRECTIONS)).collect(),
    };
    let mut best: Option<Way> = None;
    for yaw in yaws {
        for start in &starts {
            for sides in [[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]] {
                let way = start.clone().forwards(place(to, yaw), sides);
                best = way.into_iter().chain(best).min_by(|one, other| one.cost_m.total_cmp(&other.cost_m));
            }
        }
    }
    let Some(best) = best else { return vec![*to] };
    let mut waypoints = best.waypoints;
    // The last one is the goal itself, with its keys.
    let is_goal = |last: &Waypoint| (last.x_m - to.x_m).hypot(last.y_m - to.y_m) < APART_M;
    waypoints.pop_if(|last| is_goal(last));
    waypoints.push(Waypoint { yaw_rad: Some(wrap_angle(best.place.yaw)), ..*to });
    waypoints
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::course::{Course, CourseKeys, Widths};
    use proptest::prelude::*;

    fn course(from: Waypoint, to: Waypoint) -> Course {
        let mut waypoints = vec![from];
        waypoints.extend(between(&from, &to, 4.0));
        Course::try_from(CourseKeys { waypoints, width_m: Widths::All(2.0), ..CourseKeys::default() })
            .unwrap()
    }

    #[test]
    fn ahead_it_is_a_line_and_behind_a_turn_in_three() {
        let start = Waypoint::new(0.0, 0.0, Some(0.0));
        assert!((course(start, Waypoint::new(6.0, 0.0, Some(0.0))).length_m() - 6.0).abs() < 1e-6);
        let behind = course(start, Waypoint::new(-6.0, 0.0, None));
        // Three arcs of 60 degrees with 4 m radius, and 6 m.
        assert!((behind.length_m() - (4.0 * PI + 6.0)).abs() < 1e-6, "{}", behind.length_m());
        assert_eq!(behind.legs().len(), 3);
        // With room to both sides a circle is shorter than two reversals: beside the robot, in the other direction.
        let beside = course(start, Waypoint::new(0.0, 8.0, Some(PI)));
        assert!(beside.legs().len() == 1 && (beside.length_m() - 4.0 * PI).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn the_way_ends_at_the_place_in_its_direction_without_sharper_turns(
            x in -20.0..20.0f64, y in -20.0..20.0f64, yaw in -3.1..3.1f64, from in -3.1..3.1f64,
        ) {
            prop_assume!(x.hypot(y) > 0.5);
            let course = course(Waypoint::new(0.0, 0.0, Some(from)), Waypoint::new(x, y, Some(yaw)));
            let end = course.at(course.length_m());
            prop_assert!((end.point - Vector2::new(x, y)).norm() < 1e-6);
            prop_assert!(wrap_angle(course.robot_yaw(course.length_m()) - yaw).abs() < 1e-6);
            prop_assert!(course.sharpest().radius_m > 3.0, "{:?}", course.sharpest());
        }
    }
}
