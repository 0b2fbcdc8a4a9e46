use std::f64::consts::{FRAC_PI_2, PI};

use vehicle::Description;
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::frame::heading;

use super::*;

fn config(waypoints: &[[f64; 3]]) -> ObstaclesConfig {
    let waypoint = |[x_m, y_m, yaw]: &[f64; 3]| Waypoint::new(*x_m, *y_m, Some(*yaw));
    let waypoints = waypoints.iter().map(waypoint).collect();
    let course = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap();
    let track_x_m = [-2.0, course.length_m() + 2.0];
    ObstaclesConfig { course, track_x_m, ..ObstaclesConfig::default() }
}

/// Along x, a quarter of a circle of 4 m to the left around (6, 4), and along y; 1.5 m wide to both sides.
fn right_angle() -> ObstaclesConfig {
    config(&[[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [10.0, 4.0, FRAC_PI_2], [10.0, 9.0, FRAC_PI_2]])
}

/// The way with the robot `along` metres along it.
fn way(config: &ObstaclesConfig, along: f64) -> Way {
    let tangent = config.course.at(along);
    let mut way = Way::new(config);
    way.follow([tangent.point.x, tangent.point.y, tangent.yaw]);
    assert!((way.along_m() - along).abs() < 1e-6, "{} {along}", way.along_m());
    way
}

/// A box tangential to the bend, with its middle 45 deg around it and so far from its centre.
fn on_the_bend(radius: f64, length: f64, width: f64) -> Rectangle {
    let centre = Vector2::new(6.0, 4.0) + heading(-PI / 4.0) * radius;
    Rectangle { centre, yaw: PI / 4.0, length, width }
}

#[test]
fn a_box_beside_a_bend_is_beside_the_way_where_its_nearest_side_is() {
    let way = way(&right_angle(), 6.0 + PI / 2.0);
    // Bodies at rest are described up to 2.1 m from the course, and 5 cm less by noise: 6.05 m from the centre.
    assert!(!way.is_box_beside(&on_the_bend(6.1, 0.2, 0.2)));
    assert!(way.is_box_beside(&on_the_bend(6.2, 0.2, 0.2)));
    // On the inside up to 1.9 m from the centre.
    assert!(!way.is_box_beside(&on_the_bend(1.9, 0.2, 0.2)));
    assert!(way.is_box_beside(&on_the_bend(1.8, 0.2, 0.1)));
    // The corners of a longer one are 6.1 m from the centre, the middle of its side is 6.02 m from it.
    let long = on_the_bend(6.12, 2.0, 0.2);
    assert!(way.is_beside(long.corners()) && !way.is_box_beside(&long));
    assert!(way.is_box_beside(&on_the_bend(6.2, 2.0, 0.2)));
}

#[test]
fn a_return_has_its_place_along_the_way_and_to_the_left_of_it() {
    let mut way = way(&right_angle(), 6.0);
    let bend = |angle: f64, radius: f64| Vector2::new(6.0, 4.0) + heading(angle - FRAC_PI_2) * radius;
    let at =
        [Vector2::new(4.0, -1.0), bend(PI / 4.0, 3.0), bend(PI / 3.0, 5.5), bend(0.5, 7.5), bend(0.5, 0.6)];
    let points: Vec<_> = (7..).zip(at).map(|(beam, at)| Point { at, range: 1.0, beam }).collect();
    way.place(&points);
    let expected = [[4.0, -1.0], [6.0 + PI, 1.0], [6.0 + 4.0 * PI / 3.0, -1.5]];
    for (point, expected) in points.iter().zip(expected) {
        let found = way.of(point);
        assert!((found - Vector2::from(expected)).norm() < 1e-6, "{found:?} {expected:?}");
        assert!((way.locate(point.at) - found).norm() < 1e-9);
    }
    assert!(
        points[3..].iter().all(|point| way.of(point).y == f64::INFINITY),
        "3.4 m from it nothing is described"
    );
    assert!(points[3..].iter().all(|point| way.is_point_beside(point)) && !way.is_point_beside(&points[2]));
}

#[test]
fn at_a_crossing_the_robot_is_on_the_part_that_it_came_along() {
    // Twice through (5, 0): along x, round, and along x again.
    let config = config(&[
        [0.0, 0.0, 0.0],
        [5.0, 0.0, 0.0],
        [9.0, 4.0, FRAC_PI_2],
        [5.0, 8.0, PI],
        [1.0, 4.0, -FRAC_PI_2],
        [5.0, 0.0, 0.0],
        [9.0, 0.0, 0.0],
    ]);
    let round = config.course.length_m() - 4.0;
    for along in [5.0, round] {
        let mut way = Way::new(&config);
        way.resume(along - 0.1);
        way.follow([5.0, 0.1, 0.0]);
        assert!((way.along_m() - along).abs() < 1e-6, "{} {along}", way.along_m());
        // Behind the crossing the first part goes round, and the second straight on.
        let ahead = way.locate(Vector2::new(8.9, 0.1));
        assert!((ahead.y - 0.1).abs() < if along > 6.0 { 1e-6 } else { -1.0 } || ahead.y < -0.8, "{ahead:?}");
        // Far from the way the robot is looked for everywhere.
        way.follow([5.0, 8.0, PI]);
        assert!((way.along_m() - 5.0 - 4.0 * PI).abs() < 0.01, "{}", way.along_m());
    }
}

#[test]
fn the_walls_of_a_hall_follow_the_course() {
    let vehicle = Description { surroundings: Surroundings::Hall, ..Description::default() };
    let config = ObstaclesConfig { vehicle, ..right_angle() };
    let (way, beams) = (way(&config, 6.0), Beams::urg());
    let place = Place::standing(Vector2::new(6.0, 0.0), 0.0);
    // 256 beams are 90 deg: walls 3.5 m to the left and to the right.
    let is_near = |beam: usize| way.is_wall_near(&beams, &place, beam);
    assert!(is_near(340 + 256) && is_near(340 - 256));
    // 45 deg to the left a straight wall would be 4.9 m away; this beam goes past the inside of the bend, half a metre
    // around its centre.
    assert!(!is_near(340 + 128) && is_near(340 - 128));
    let straight = ObstaclesConfig { course: Course::default(), ..config };
    assert!(Way::new(&straight).is_wall_near(&beams, &place, 340 + 128));
    // Where the surroundings are open there is none.
    let open = Description { surroundings: Surroundings::Open, ..Description::default() };
    let open = ObstaclesConfig { vehicle: open, ..right_angle() };
    let mut way = Way::new(&open);
    way.follow([6.0, 0.0, 0.0]);
    assert!((0..beams.count()).all(|beam| !way.is_wall_near(&beams, &place, beam)));
}
