use std::f64::consts::{FRAC_PI_2, PI, TAU};

use proptest::prelude::*;
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::frame::heading;

use super::super::hall::Hall;
use super::*;
use crate::scenario::{MAX_RANGE_M, Scenario};

fn course(waypoints: &[[f64; 3]]) -> Course {
    let waypoint = |[x_m, y_m, yaw]: &[f64; 3]| Waypoint::new(*x_m, *y_m, Some(*yaw));
    let waypoints = waypoints.iter().map(waypoint).collect();
    Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap()
}

/// Along x, a quarter of a circle of 4 m to the left around (6, 4), and along y.
fn right_angle() -> Course {
    course(&[[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [10.0, 4.0, FRAC_PI_2], [10.0, 9.0, FRAC_PI_2]])
}

fn ahead(gallery: &Gallery, [x, y]: [f64; 2], yaw: f64) -> f64 {
    gallery.range(Vector2::new(x, y), heading(yaw))
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
}

#[test]
fn beside_a_right_angle_walls_stand_at_half_the_width_and_two_metres() {
    let gallery = Gallery::of(&right_angle(), MAX_RANGE_M).unwrap();
    near(ahead(&gallery, [3.5, 0.0], FRAC_PI_2), 3.5);
    near(ahead(&gallery, [3.5, 0.5], -FRAC_PI_2), 4.0);
    // The pillars at 2.5 m.
    near(ahead(&gallery, [2.5, 0.5], FRAC_PI_2), 2.7);
    near(ahead(&gallery, [2.5, 0.5], -FRAC_PI_2), 3.7);
    // The end walls, 4 m before the begin and behind the end; with 2 m of the track before and behind as in a straight hall.
    near(ahead(&gallery, [1.0, 0.0], PI), 5.0);
    near(ahead(&gallery, [10.0, 8.5], FRAC_PI_2), 4.5);
    // Beside the straight behind the bend.
    near(ahead(&gallery, [10.0, 6.0], PI), 3.5);
    // In the middle of the bend: outwards to a radius of 7.5 m, inwards 3.5 m to half a metre from its centre.
    let middle = Vector2::new(6.0, 4.0) + heading(-PI / 4.0) * 4.0;
    let outwards = gallery.range(middle, heading(-PI / 4.0));
    assert!((outwards - 3.5).abs() < 0.004, "{outwards}");
    let inwards = gallery.range(middle, heading(0.75 * PI));
    assert!((inwards - 3.5).abs() < 0.004, "{inwards}");
}

#[test]
fn pillars_are_equally_spaced_along_the_outer_wall_of_a_bend() {
    let gallery = Gallery::of(&right_angle(), MAX_RANGE_M).unwrap();
    // The outer wall begins to turn after 6 m, with a radius of 7.5 m: its pillar at 10 m is 4 / 7.5 further round.
    let angle = 4.0 / 7.5 - FRAC_PI_2;
    let seen_from_the_centre = |angle: f64| {
        let from = Vector2::new(6.0, 4.0) + heading(angle) * 3.0;
        3.0 + gallery.range(from, heading(angle))
    };
    assert!((seen_from_the_centre(angle) - 7.2).abs() < 0.01);
    // Its side is 0.15 m from its middle.
    assert!((seen_from_the_centre(angle + 0.019) - 7.2).abs() < 0.01);
    assert!((seen_from_the_centre(angle + 0.024) - 7.5).abs() < 0.01);
}

#[test]
fn no_wall_stands_in_the_way_where_a_course_crosses_itself() {
    // Along x, around to the left through three quarters of a circle of 4 m, and down through (6, 0).
    let course = course(&[
        [-8.0, 0.0, 0.0],
        [10.0, 0.0, 0.0],
        [10.0, 8.0, PI],
        [6.0, 4.0, 1.5 * PI],
        [6.0, -8.0, 1.5 * PI],
    ]);
    let gallery = Gallery::of(&course, MAX_RANGE_M).unwrap();
    // At the crossing nothing is within the 5.6 m of the scanner along either way.
    for yaw in [0.0, FRAC_PI_2, PI, -FRAC_PI_2] {
        let range = ahead(&gallery, [6.0, 0.0], yaw);
        assert_eq!(range, f64::INFINITY, "{yaw}");
    }
    // The walls below the first straight and beside the last one meet in (2.5, -3.5), (9.5, -3.5).
    let corner = gallery.range(Vector2::new(6.0, 0.0), Vector2::new(-1.0, -1.0).normalize());
    assert!((corner - 3.5 * 2.0_f64.sqrt()).abs() < 0.01, "{corner}");
    // No beam passes between the two, nor looks at anything that is nearer.
    for index in 1..90 {
        let angle = PI + f64::from(index) * PI / 180.0;
        let (to_wall, to_side) = (3.5 / -angle.sin(), 3.5 / -angle.cos());
        let range = ahead(&gallery, [6.0, 0.0], angle);
        let expected = to_wall.max(to_side);
        assert!(
            expected > 5.6 || range < expected + 0.01 && range > expected - 0.6,
            "{angle}: {range} {expected}"
        );
    }
}

#[test]
fn the_end_of_a_closed_course_does_not_block_its_begin() {
    let circle: Vec<[f64; 3]> = (0..=4)
        .map(|quarter| {
            let angle = f64::from(quarter) * FRAC_PI_2;
            [6.0 * angle.sin(), 6.0 - 6.0 * angle.cos(), angle]
        })
        .collect();
    let gallery = Gallery::of(&course(&circle), MAX_RANGE_M).unwrap();
    for step in 0..200 {
        let angle = f64::from(step) / 200.0 * TAU;
        let at = [6.0 * angle.sin(), 6.0 - 6.0 * angle.cos()];
        let range = ahead(&gallery, at, angle);
        assert!(range > 4.4, "along the way from {at:?}: {range}");
    }
}

#[test]
fn open_surroundings_and_the_line_have_no_gallery() {
    let keys = CourseKeys { surroundings: Surroundings::Open, ..right_angle().keys().clone() };
    assert!(Gallery::of(&Course::try_from(keys).unwrap(), MAX_RANGE_M).is_none());
    assert!(Gallery::of(&Course::default(), MAX_RANGE_M).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4_000, ..ProptestConfig::default() })]

    /// Along a straight course stands the hall of the line.
    #[test]
    fn a_straight_course_has_the_hall_of_the_track(
        x in -3.9..23.9_f64,
        y in -3.15..3.15_f64,
        yaw in -3.2..3.2_f64,
    ) {
        let hall = Hall::of(&Scenario::parse("[track]\nx_m = [-2.0, 22.0]\ny_m = [-1.5, 1.5]", "test").unwrap()).unwrap();
        let gallery = Gallery::of(&course(&[[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]]), MAX_RANGE_M).unwrap();
        let (origin, direction) = (Vector2::new(x, y), heading(yaw));
        let found = gallery.range(origin, direction);
        // A beam that grazes a corner may pass on either side of it.
        let is_as = |shift: f64| {
            let expected = hall.range(origin + shift * Vector2::new(-direction.y, direction.x), direction);
            let expected = if expected > MAX_RANGE_M { f64::INFINITY } else { expected };
            found == expected || (found - expected).abs() < 1e-6
        };
        prop_assert!([0.0, 1e-9, -1e-9].into_iter().any(is_as), "{found} {}", hall.range(origin, direction));
    }

    /// Whatever the course: across it the wall is at its distance, or a pillar before it, or another part of the way is there.
    #[test]
    fn from_any_place_of_a_course_the_wall_is_at_its_distance(
        turns in prop::collection::vec((-0.8..0.8_f64, 6.0..12.0_f64), 2..6),
        share in 0.0..1.0_f64,
        left in -1.4..1.4_f64,
        is_left in any::<bool>(),
    ) {
        let (mut at, mut yaw, mut waypoints) = (Vector2::zeros(), 0.0, vec![[0.0, 0.0, 0.0]]);
        for (turn, length) in turns {
            at += heading(yaw + turn / 2.0) * length;
            yaw += turn;
            waypoints.push([at.x, at.y, yaw]);
        }
        let course = course(&waypoints);
        prop_assume!(course.sharpest().radius_m > 4.0);
        let gallery = Gallery::of(&course, MAX_RANGE_M).unwrap();
        let tangent = course.at(share * course.length_m());
        let side = if is_left { 1.0 } else { -1.0 };
        let range = gallery.range(tangent.point(0.0, left), heading(tangent.yaw + side * FRAC_PI_2));
        let expected = 3.5 - side * left;
        let foot = tangent.point(0.0, 3.5 * side);
        let is_beside_another = course.locate(foot)[1].abs() < 3.45;
        // A chord is at most 15 mm from its arc where a bend begins.
        let is_wall = (-0.31..0.015).contains(&(range - expected));
        prop_assert!(is_wall || is_beside_another, "{range} {expected}");
    }
}
