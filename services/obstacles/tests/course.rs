//! Obstacles beside and on a course that bends.

mod scene;

use std::f64::consts::{FRAC_PI_2, PI};

use obstacles::{CoverRule, ObstacleDetector, ObstaclesConfig};
use scene::*;
use shared_types::Obstacle;
use vehicle::Course;
use vehicle::course::{CourseKeys, Waypoint};

/// Along x, a quarter of a circle of 4 m to the left around (6, 4), and along y; 1.5 m wide to both sides.
fn right_angle() -> ObstaclesConfig {
    let points = [[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [10.0, 4.0, FRAC_PI_2], [10.0, 9.0, FRAC_PI_2]];
    let waypoints = points.map(|[x_m, y_m, yaw]| Waypoint::new(x_m, y_m, Some(yaw))).to_vec();
    let course =
        Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).expect("bends are wide enough");
    let track_x_m = [-2.0, course.length_m() + 2.0];
    ObstaclesConfig { course, track_x_m, ..open() }
}

fn described(config: &ObstaclesConfig, bodies: &[Body], robot: &Robot) -> Vec<Obstacle> {
    let mut detector = ObstacleDetector::new(config.clone()).expect("settings are valid");
    let seen = run(&mut detector, &mut Scene::of(bodies), &mut robot.clone(), 8);
    seen.last().map_or_else(Vec::new, |obstacles| obstacles.list().to_vec())
}

#[test]
fn behind_a_right_angle_an_obstacle_has_the_ellipse_that_it_has_on_a_line() {
    for cover in [CoverRule::Tight, CoverRule::Source] {
        for (length, width, yaw) in [(0.1, 0.8, 0.0), (1.6, 0.3, 0.0), (1.8, 0.3, 0.8), (0.4, 0.4, 0.3)] {
            let line = ObstaclesConfig { cover, ..open() };
            let expected = described(&line, &[block(3.0, 0.3, length, width, yaw)], &Robot::default());
            // The same a quarter turn to the left: the robot is at (10, 4.5), forward is along y.
            let body = block(9.7, 7.5, length, width, yaw + FRAC_PI_2);
            let course = ObstaclesConfig { cover, ..right_angle() };
            let found = described(&course, &[body], &Robot::at(10.0, 4.5, FRAC_PI_2));
            assert!(!found.is_empty() && found.len() == expected.len(), "{found:?} {expected:?}");
            for (found, expected) in found.iter().zip(&expected) {
                let offset = [found.y_m - 4.5 - expected.x_m, 10.0 - found.x_m - expected.y_m];
                let sizes = [found.a_m - expected.a_m, found.b_m - expected.b_m];
                // The reaches of a body are kept as f32.
                assert!(offset.iter().chain(&sizes).all(|off| off.abs() < 1e-4), "{found:?} {expected:?}");
            }
        }
    }
}

#[test]
fn a_long_body_along_a_bend_is_covered_in_pieces_that_follow_it() {
    // 2 m long and 1 m inside of the middle of the bend; the straight body next to it bends away by 2^2 / 8 / 4 = 12 cm.
    let at = 3.0 * 0.5_f64.sqrt();
    let body = block(6.0 + at, 4.0 - at, 2.0, 0.3, PI / 4.0);
    let robot = Robot::at(6.0 + at / 0.75, 4.0 - at / 0.75, PI / 4.0);
    let found = described(&right_angle(), &[body], &robot);
    assert!(found.len() > 1, "{found:?}");
    let line = described(&open(), &[block(0.0, 1.0, 2.0, 0.3, 0.0)], &Robot::default());
    assert_eq!(line.len(), 1);
    // Half of the body, what the robot keeps, and a little for the ellipse.
    for item in &found {
        assert!(item.b_m < 0.55 && item.a_m < 1.3, "{item:?}");
    }
}

#[test]
fn what_is_described_is_near_the_course_and_not_near_the_line() {
    // The robot is 45 deg around the bend.
    let at = 4.0 * 0.5_f64.sqrt();
    let robot = Robot::at(6.0 + at, 4.0 - at, PI / 4.0);
    let config = right_angle();
    // In the middle of the way behind the bend, 5 m beside the line.
    let found = described(&config, &[block(10.0, 5.0, 0.4, 0.4, 0.0)], &robot);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!((found[0].box_x_m - 10.0).abs() < 0.1 && (found[0].box_y_m - 5.0).abs() < 0.2, "{found:?}");
    // Ahead of the robot on the line, 4.5 m to the right of the way behind the bend.
    assert_eq!(described(&config, &[block(12.5, 4.0, 0.4, 0.4, 0.0)], &robot), []);
    assert_eq!(described(&config, &[block(11.9, 4.0, 0.4, 0.4, 0.0)], &robot).len(), 1);
}

#[test]
fn a_detector_continues_on_the_course_where_the_one_before_was() {
    let config = right_angle();
    let mut scene = Scene::of(&[block(10.0, 5.0, 0.4, 0.4, 0.0)]).noisy(3);
    let at = 4.0 * 0.5_f64.sqrt();
    let mut robot = Robot { speed: 0.3, ..Robot::at(6.0 + at, 4.0 - at, PI / 4.0) };
    let mut detector = ObstacleDetector::new(config.clone()).unwrap();
    run(&mut detector, &mut scene, &mut robot, 5);
    assert!((detector.state().along_m - 6.0 - PI).abs() < 0.2, "{}", detector.state().along_m);
    let mut next = ObstacleDetector::new(config).unwrap();
    next.resume(&detector.state()).unwrap();
    for _ in 0..5 {
        let (scan, pose) = scene.scan(&robot);
        robot = robot.after(0.1);
        assert_eq!(next.step(&scan, &pose), detector.step(&scan, &pose));
    }
    let lost = obstacles::ObstaclesState { along_m: f64::NAN, ..detector.state() };
    assert!(next.resume(&lost).is_err());
}
