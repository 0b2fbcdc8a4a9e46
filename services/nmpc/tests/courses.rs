//! The controller in a closed loop with the model, on courses that bend.

mod common;

use std::f64::consts::{FRAC_PI_2, PI};

use common::{Body, Noise, body, print, print_head, run};
use nalgebra::Vector2;
use nmpc::{Budget, Controller, ControllerConfig};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shared_types::{CommandKind, Obstacles, Pose, ScannerHealth};
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::{Course, Goal, State, Track};

fn at(x_m: f64, y_m: f64, yaw_rad: f64) -> Waypoint {
    Waypoint::new(x_m, y_m, Some(yaw_rad))
}

/// The controller on a way of 3 m through these points, with the goal at its end.
fn config(waypoints: Vec<Waypoint>) -> ControllerConfig {
    let course = Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).expect("a course");
    let length = course.length_m();
    ControllerConfig {
        goal: Goal { x_m: length, ..Goal::default() },
        track: Track { x_m: [-2.0, length + 2.0], y_m: [-1.5, 1.5], ..Track::default() },
        course,
        ..ControllerConfig::default()
    }
}

fn right_angle(radius: f64, side: f64) -> ControllerConfig {
    let corner = 4.0 + radius;
    config(vec![
        at(0.0, 0.0, 0.0),
        at(4.0, 0.0, 0.0),
        at(corner, side * radius, side * FRAC_PI_2),
        at(corner, side * (radius + 6.0), side * FRAC_PI_2),
    ])
}

fn s_curve(radius: f64) -> ControllerConfig {
    let (sin, cos) = 1.1_f64.sin_cos();
    let [dx, dy] = [radius * sin, radius * (1.0 - cos)];
    config(vec![
        at(0.0, 0.0, 0.0),
        at(4.0, 0.0, 0.0),
        at(4.0 + dx, dy, 1.1),
        at(4.0 + 2.0 * dx, 2.0 * dy, 0.0),
        at(9.0 + 2.0 * dx, 2.0 * dy, 0.0),
    ])
}

fn round(radius: f64) -> ControllerConfig {
    config(vec![
        at(0.0, 0.0, 0.0),
        at(3.0, 0.0, 0.0),
        at(3.0 + radius, radius, FRAC_PI_2),
        at(3.0, 2.0 * radius, PI),
        at(-2.0, 2.0 * radius, PI),
    ])
}

/// A post beside the course.
fn post(config: &ControllerConfig, along: f64, across: f64) -> Body {
    let place = config.course.in_plane(&State { x: along, y: across, ..State::default() });
    body(place.x, place.y, 0.2, 0.2)
}

fn assert_reached(name: &str, config: &ControllerConfig, bodies: &[Body], largest_y: f64) {
    print_head();
    let noise = Noise { position_m: 0.01, yaw_rad: 0.005, obstacle_m: 0.01, seed: 7 };
    for noise in [Noise::default(), noise] {
        let outcome = run(config, State::default(), bodies, noise);
        print(name, config, &outcome);
        assert!(outcome.reached(config), "{name}: {:?}", outcome.stopped);
        assert!(outcome.min_clearance >= 0.05, "{name}: {} m", outcome.min_clearance);
        assert!(outcome.largest_y < largest_y, "{name}: {} m", outcome.largest_y);
        assert_eq!(outcome.stops, 0, "{name}: stopped on the way");
    }
}

#[test]
fn a_free_course_is_followed() {
    for side in [1.0, -1.0] {
        for radius in [3.6, 4.5, 8.0] {
            assert_reached("right angle", &right_angle(radius, side), &[], 0.15);
        }
    }
    assert_reached("s curve", &s_curve(5.0), &[], 0.15);
    assert_reached("round", &round(4.5), &[], 0.15);
}

#[test]
fn a_post_on_a_bend_is_passed() {
    for across in [0.0, 0.3, -0.3] {
        for along in [4.0, 6.0, 9.0, 13.0] {
            let config = right_angle(5.0, 1.0);
            let bodies = [post(&config, along, across)];
            assert_reached(&format!("post {along} {across}"), &config, &bodies, 1.55);
        }
    }
}

#[test]
fn posts_on_an_s_are_passed() {
    let config = s_curve(6.0);
    let bodies = [post(&config, 7.0, 0.4), post(&config, 13.0, -0.4)];
    assert_reached("posts", &config, &bodies, 1.55);
}

/// A course of up to six arcs and lines, with posts beside it.
fn random(seed: u64) -> (ControllerConfig, Vec<Body>) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut x, mut y, mut yaw) = (4.0, 0.0, 0.0);
    let mut waypoints = vec![at(0.0, 0.0, 0.0), at(x, y, yaw)];
    for _ in 0..random.random_range(1..=6) {
        let (turn, radius): (f64, f64) = (random.random_range(-1.5..1.5), random.random_range(3.6..9.0));
        // The chord of the arc has its middle direction.
        let chord = 2.0 * radius * (turn.abs() / 2.0).sin().max(0.1);
        (x, y) = (x + chord * (yaw + turn / 2.0_f64).cos(), y + chord * (yaw + turn / 2.0).sin());
        yaw += turn;
        waypoints.push(at(x, y, yaw));
    }
    let config = config(waypoints);
    let mut bodies = Vec::new();
    let mut along = random.random_range(5.0..9.0);
    while along < config.goal.x_m - 3.0 {
        bodies.push(post(&config, along, random.random_range(-0.9..0.9)));
        along += random.random_range(5.5..9.0);
    }
    (config, bodies)
}

#[test]
fn random_courses_with_posts_are_driven_to_their_goal() {
    print_head();
    for seed in 0..40 {
        let (config, bodies) = random(seed);
        let noise = Noise { position_m: 0.01, yaw_rad: 0.005, obstacle_m: 0.01, seed };
        let outcome = run(&config, State::default(), &bodies, noise);
        print(&format!("{seed}: {:.1} m", config.goal.x_m), &config, &outcome);
        assert!(outcome.reached(&config) && outcome.stops == 0, "{seed}: {:?}", outcome.stopped);
        assert!(outcome.min_clearance >= 0.05, "{seed}: {} m", outcome.min_clearance);
        assert!(outcome.largest_y < 1.55, "{seed}: {} m", outcome.largest_y);
    }
}

#[test]
fn a_robot_that_is_put_elsewhere_on_the_course_drives_on_from_there() {
    let config = right_angle(5.0, 1.0);
    let mut controller = Controller::new(config.clone()).expect("a valid configuration");
    for (scan, along) in [(1, 1.0), (2, 1.1), (3, 12.0), (4, 12.1), (5, 3.0)] {
        let place = config.course.in_plane(&State { x: along, y: 0.1, ..State::default() });
        let mut obstacles = Obstacles { scanner: ScannerHealth::healthy(5.0), ..Obstacles::default() };
        (obstacles.header.scan_id, obstacles.header.acquired_ns) = (scan, scan * 100_000_000);
        let pose = Pose {
            header: obstacles.header,
            predicted_ns: obstacles.header.acquired_ns + 33_000_000,
            x_m: place.x,
            y_m: place.y,
            yaw_rad: place.yaw,
            predicted_x_m: place.x,
            predicted_y_m: place.y,
            predicted_yaw_rad: place.yaw,
            ..Pose::default()
        };
        let command = controller.step(&pose, &obstacles, &Budget::Iterations(60));
        assert_eq!(command.kind, CommandKind::Drive.wire(), "scan {scan}: {:?}", command.reason);
        let [first, second] =
            [0, 1].map(|index: usize| Vector2::new(command.plan[index].x_m, command.plan[index].y_m));
        // The plan is in the plane, from where the robot is.
        assert!((first - Vector2::new(place.x, place.y)).norm() < 1e-6, "scan {scan}");
        let tangent = config.course.at(along);
        assert!(tangent.offset(second)[0] > 0.05, "scan {scan}: it leads along the course");
    }
}
