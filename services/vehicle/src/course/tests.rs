use std::f64::consts::{FRAC_PI_2, PI};

use proptest::prelude::*;

use super::*;

fn waypoint(x_m: f64, y_m: f64, yaw_rad: Option<f64>) -> Waypoint {
    Waypoint::new(x_m, y_m, yaw_rad)
}

fn through(waypoints: &[Waypoint]) -> Course {
    Course::try_from(CourseKeys { waypoints: waypoints.to_vec(), ..CourseKeys::default() }).unwrap()
}

/// Along x, a quarter of a circle of 4 m to the left, and along y.
fn right_angle() -> Course {
    let left = Some(FRAC_PI_2);
    through(&[
        waypoint(0.0, 0.0, Some(0.0)),
        waypoint(6.0, 0.0, Some(0.0)),
        waypoint(10.0, 4.0, left),
        waypoint(10.0, 9.0, left),
    ])
}

#[test]
fn a_line_has_the_same_numbers_on_the_course_and_in_the_plane() {
    let (line, state) = (Course::default(), State { x: 3.0, y: -0.7, yaw: 4.0, ..State::default() });
    assert!(line.is_line() && line.on_course(&state, 50.0) == state && line.in_plane(&state) == state);
    assert_eq!((line.locate(Vector2::new(3.0, 2.0)), line.curvature(1.0)), ([3.0, 2.0], 0.0));
}

#[test]
fn a_right_angle_is_two_lines_and_a_quarter_of_a_circle() {
    let course = right_angle();
    assert!((course.length_m() - (6.0 + 2.0 * PI + 5.0)).abs() < 1e-9);
    let bend = course.sharpest();
    assert!((bend.radius_m - 4.0).abs() < 1e-9 && bend.waypoint == 1);
    let middle = course.at(6.0 + PI);
    let expected = Vector2::new(6.0 + 4.0 * 0.5_f64.sqrt(), 4.0 - 4.0 * 0.5_f64.sqrt());
    assert!((middle.point - expected).norm() < 1e-9 && (middle.yaw - PI / 4.0).abs() < 1e-9);
    // Half a metre inside of the bend, and beside its end.
    let [along, left] =
        course.locate(Vector2::new(6.0, 4.0) - (Vector2::new(6.0, 4.0) - expected) / 4.0 * 3.5);
    assert!((along - 6.0 - PI).abs() < 1e-9 && (left - 0.5).abs() < 1e-9, "{along} {left}");
    let [along, left] = course.locate(Vector2::new(10.5, 8.0));
    assert!((along - 10.0 - 2.0 * PI).abs() < 1e-9 && (left + 0.5).abs() < 1e-9);
}

#[test]
fn before_its_begin_and_behind_its_end_a_course_goes_on_straight() {
    let course = right_angle();
    for (point, expected) in [([-2.0, 0.5], [-2.0, 0.5]), ([9.5, 10.0], [12.0 + 2.0 * PI, 0.5])] {
        let found = course.locate(Vector2::from(point));
        assert!((found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9, "{found:?}");
    }
    assert!((course.at(-2.0).point - Vector2::new(-2.0, 0.0)).norm() < 1e-12);
    assert!((course.at(12.0 + 2.0 * PI).point - Vector2::new(10.0, 10.0)).norm() < 1e-9);
    assert_eq!((course.curvature(-1.0), course.curvature(100.0)), (0.0, 0.0));
}

#[test]
fn waypoints_on_a_circle_give_that_circle() {
    let at = |angle: f64| waypoint(5.0 * angle.sin(), 5.0 - 5.0 * angle.cos(), None);
    let course = through(&[0.0, 0.5, 1.4, 1.9].map(at));
    assert!((course.length_m() - 9.5).abs() < 1e-9 && (course.sharpest().radius_m - 5.0).abs() < 1e-9);
    assert!((course.at(7.0).yaw - 1.4).abs() < 1e-9);
}

#[test]
fn a_course_that_crosses_itself_is_searched_near_the_place_before() {
    // Twice through (5, 0): along x, round, and along y.
    let course = through(&[
        waypoint(0.0, 0.0, Some(0.0)),
        waypoint(5.0, 0.0, Some(0.0)),
        waypoint(9.0, 4.0, Some(FRAC_PI_2)),
        waypoint(5.0, 8.0, Some(PI)),
        waypoint(1.0, 4.0, Some(-FRAC_PI_2)),
        waypoint(5.0, 0.0, Some(0.0)),
        waypoint(9.0, 0.0, Some(0.0)),
    ]);
    let round = course.length_m() - 4.0;
    for near in [5.5, round - 0.5] {
        let state = course.on_course(&State { x: 5.0, y: 0.2, yaw: 0.0, ..State::default() }, near);
        let expected = if near < 10.0 { 5.0 } else { round };
        assert!((state.x - expected).abs() < 1e-6 && (state.y - 0.2).abs() < 1e-6, "{state:?}");
        assert!(state.yaw.abs() < 1e-6, "the yaw on the course counts no rounds: {state:?}");
    }
    // Whether it is the first time tells the direction.
    let along_y = State { x: 9.0, y: 4.1, yaw: FRAC_PI_2, ..State::default() };
    assert!((course.find(&along_y) - (5.0 + 2.0 * PI + 0.1)).abs() < 0.01);
}

#[test]
fn a_closed_course_is_driven_in_laps() {
    let circle = [0.0_f64, 1.5, 3.0, 4.5].map(|angle| waypoint(5.0 * angle.cos(), 5.0 * angle.sin(), None));
    let waypoints: Vec<_> = circle.into_iter().chain([circle[0]]).collect();
    let keys = CourseKeys { waypoints: waypoints.clone(), laps: 3, ..CourseKeys::default() };
    let course = Course::try_from(keys.clone()).unwrap();
    assert!((course.length_m() - 30.0 * PI).abs() < 1e-9 && (course.sharpest().radius_m - 5.0).abs() < 1e-9);
    // A quarter of the third lap: the yaw counts the rounds, the place does not.
    let place = course.at(20.0 * PI + 2.5 * PI);
    assert!((place.point - Vector2::new(0.0, 5.0)).norm() < 1e-9 && (place.yaw - 5.0 * PI).abs() < 1e-9);
    let third = course.on_course(&State { y: 5.2, yaw: PI, ..State::default() }, 22.0 * PI);
    assert!((third.x - 22.5 * PI).abs() < 1e-9 && (third.y + 0.2).abs() < 1e-9 && third.yaw.abs() < 1e-9);
    let open = CourseKeys { waypoints: waypoints[..4].to_vec(), ..keys };
    assert_eq!(
        Course::try_from(open).unwrap_err().to_string(),
        "laps = 3 is not allowed: 1 where the last waypoint is another place than the first one"
    );
}

#[test]
fn a_robot_at_the_start_of_a_closed_course_has_all_laps_before_it() {
    let circle = [0.0_f64, 1.5, 3.0, 4.5].map(|angle| waypoint(5.0 * angle.cos(), 5.0 * angle.sin(), None));
    let waypoints: Vec<_> = circle.into_iter().chain([circle[0]]).collect();
    for laps in [1, 3] {
        let keys = CourseKeys { waypoints: waypoints.clone(), laps, ..CourseKeys::default() };
        let course = Course::try_from(keys).unwrap();
        for (behind_m, left_m) in [(0.0, 0.0), (0.001, 0.0), (0.02, -0.1), (0.5, 0.2), (-0.3, 0.1)] {
            // The first waypoint is at (5, 0), and the course leads along y there.
            let state = State { x: 5.0 - left_m, y: -behind_m, yaw: FRAC_PI_2, ..State::default() };
            let along = course.find(&state);
            assert!((along + behind_m).abs() < 0.05, "{laps} laps, {behind_m} m behind: {along}");
        }
        let half = State { x: -5.0, y: 0.0, yaw: -FRAC_PI_2, ..State::default() };
        assert!((course.find(&half) - 5.0 * PI).abs() < 1e-6);
        if laps > 1 {
            assert!((course.find_from(&half, 10.0 * PI - 1.0) - 15.0 * PI).abs() < 1e-6, "in the second lap");
        }
    }
}

#[test]
fn waypoints_that_make_no_course_are_refused_by_number() {
    let refused = |waypoints: &[Waypoint]| {
        let keys = CourseKeys { waypoints: waypoints.to_vec(), ..CourseKeys::default() };
        Course::try_from(keys).unwrap_err().to_string()
    };
    let here = waypoint(1.0, 1.0, None);
    assert_eq!(refused(&[here]), "waypoints = 1 waypoints is not allowed: 2 to 5000 of them");
    assert_eq!(
        refused(&[waypoint(0.0, 0.0, None), here, here]),
        "waypoints[2] = (1, 1) is not allowed: at least 0.05 m from the one before"
    );
    let back = [waypoint(0.0, 0.0, None), waypoint(10.0, 0.0, None), waypoint(5.0, 0.0, None)];
    assert_eq!(
        refused(&back),
        "waypoints[1] = (10, 0) is not allowed: a place that the way leads to without turning back"
    );
    let sharp =
        [waypoint(0.0, 0.0, Some(0.0)), waypoint(5.0, 0.0, Some(0.0)), waypoint(6.0, 1.0, Some(FRAC_PI_2))];
    assert_eq!(
        refused(&sharp),
        "waypoints[1] = a bend with a radius of 1.00 m is not allowed: above 1.5 m, half of width_m"
    );
}

proptest! {
    /// Whatever the waypoints: the curve is continuous with its direction, and a position on it is found again.
    #[test]
    fn a_position_in_the_plane_and_on_the_course_are_the_same(
        turns in prop::collection::vec((-1.2..1.2f64, 4.0..12.0f64), 2..8),
        along in 0.0..1.0f64,
        left in -1.4..1.4f64,
        yaw in -3.0..3.0f64,
    ) {
        let (mut at, mut direction) = (Vector2::zeros(), 0.0);
        let mut waypoints = vec![waypoint(0.0, 0.0, None)];
        for (turn, length) in turns {
            direction += turn;
            at += heading(direction) * length;
            waypoints.push(waypoint(at.x, at.y, None));
        }
        let Ok(course) = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }) else {
            return Err(TestCaseError::reject("too sharp"));
        };
        for pair in course.pieces.windows(2) {
            let (end, begin) = (pair[0].at(pair[0].length_m), pair[1].at(0.0));
            prop_assert!((end.point - begin.point).norm() < 1e-9 && (end.yaw - begin.yaw).abs() < 1e-9);
        }
        let state = State { x: along * course.length_m(), y: left, yaw, ..State::default() };
        let back = course.on_course(&course.in_plane(&state), state.x + 0.3);
        prop_assert!((back.x - state.x).abs() < 1e-6 && (back.y - left).abs() < 1e-6, "{state:?} {back:?}");
        prop_assert!((back.yaw - yaw).abs() < 1e-9);
    }
}

#[test]
fn a_slow_part_limits_the_velocity_before_it_as_far_as_the_brake_needs() {
    let mut points = [[0.0, 0.0], [5.0, 0.0], [8.0, 0.0], [12.0, 0.0]].map(|[x, y]| waypoint(x, y, None));
    points[1].speed_mps = Some(0.5);
    let course =
        Course::try_from(CourseKeys { waypoints: points.to_vec(), ..CourseKeys::default() }).unwrap();
    // With 1 m/s^2: v^2 = 0.25 + 2 s, so 1 m/s is allowed 0.375 m before it.
    assert!((course.speed_mps(4.625, 1.0) - 1.0).abs() < 1e-9);
    assert!(course.speed_mps(4.6, 1.0) > 1.0 && course.speed_mps(5.0, 1.0) == 0.5);
    assert_eq!([course.speed_mps(7.9, 1.0), course.speed_mps(8.0, 1.0)], [0.5, f64::INFINITY]);
    assert_eq!(Course::default().speed_mps(3.0, 1.0), f64::INFINITY);
}

#[test]
fn each_part_of_a_way_has_its_own_width_in_all_laps_and_legs() {
    let read = |width_m: &str, more: &str| {
        let corners = "{ yaw_rad = 0 }, { x_m = 5, yaw_rad = 0 }, { x_m = 10, y_m = 5, yaw_rad = 1.5708 }";
        let table = key_table::parse(&format!("width_m = {width_m}\nwaypoints = [{corners}{more}]")).unwrap();
        Course::from_value("course", table.into())
            .and_then(|course| course.require_all("course").map(|()| course))
    };
    let course = read("[4, 1.5]", "").unwrap();
    assert_eq!([-1.0, 4.9, 5.1, 99.0].map(|along_m| course.half_width_m(along_m)), [2.0, 2.0, 0.75, 0.75]);
    assert_eq!(course.keys().width_m.largest_m(), 4.0);
    let back = course.returned([0.0, 1.0]);
    assert_eq!([0.1, course.length_m()].map(|along_m| back.half_width_m(along_m)), [0.75, 2.0]);
    let reverse = read("[4, 1, 2]", ", { x_m = 10, y_m = 2, reverse = true }").unwrap();
    assert_eq!(reverse.legs()[1].course.half_width_m(reverse.length_m()), 1.0);
    assert_eq!(read("2", "").unwrap().half_width_m(3.0), 1.0);
    assert_eq!(Course::default().half_width_m(3.0), f64::INFINITY);
    for (width_m, refused) in [
        ("[4, 0.4]", "course.width_m[1] = 0.4 is not allowed: 0.5 to 100"),
        ("0.4", "course.width_m = 0.4 is not allowed: 0.5 to 100"),
        (
            "[1, 2, 3]",
            "course.width_m = 3 numbers is not allowed: one number, or 2: one for each way from a waypoint to the next",
        ),
        (
            "[4, 10]",
            "course.waypoints[1] = a bend with a radius of 5.00 m is not allowed: above 5 m, half of width_m",
        ),
    ] {
        assert_eq!(read(width_m, "").unwrap_err().to_string(), refused);
    }
}
