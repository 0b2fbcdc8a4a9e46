//! Random courses with bends: what [`super::random`] places along a line stands along arcs and straight ways.

use std::f64::consts::PI;

use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{Scenario, Shape};
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::frame::wrap_angle;
use vehicle::{Course, State};

/// The way is straight before its first bend for this long [m]; so it is behind the last one, or longer.
const STRAIGHT_M: f64 = 2.5;
/// Radii of the bends [m].
const RADIUS_M: [f64; 2] = [3.8, 9.0];
/// Largest turn of a bend [rad].
const TURN_RAD: f64 = 1.5;
/// The way never turns further from its first direction than this, so that it does not meet itself [rad].
const AWAY_RAD: f64 = 0.8 * PI;
/// Longest straight way between two bends [m].
const BETWEEN_M: f64 = 3.0;

/// The course of a seed.
pub fn curved(seed: u64) -> Scenario {
    let line = super::random(seed);
    let mut stream = NoiseStream::new(line.seed, Purpose::Course, 3);
    let course = way(line.goal.last().x_m, &mut stream);
    let mut obstacles = line.obstacles.clone();
    for obstacle in &mut obstacles {
        let place = course.in_plane(&State { x: obstacle.x_m, y: obstacle.y_m, ..State::default() });
        (obstacle.x_m, obstacle.y_m) = (place.x, place.y);
        if let Shape::Box { yaw_rad, .. } = &mut obstacle.shape {
            *yaw_rad = wrap_angle(*yaw_rad + place.yaw);
        }
    }
    let bent = Scenario { name: format!("curved-{}", line.seed), obstacles, ..line.clone() }.along(course);
    debug_assert!(bent.is_ok(), "{bent:?}");
    bent.unwrap_or(line)
}

/// A way of this length.
fn way(length_m: f64, stream: &mut NoiseStream) -> Course {
    let mut waypoints = vec![Waypoint { yaw_rad: Some(0.0), ..Waypoint::default() }];
    let mut add = |chord_m: f64, turn: f64| {
        let last = waypoints[waypoints.len() - 1];
        let yaw = last.yaw_rad.unwrap_or(0.0);
        let middle = yaw + turn / 2.0;
        let (x_m, y_m) = (last.x_m + chord_m * middle.cos(), last.y_m + chord_m * middle.sin());
        waypoints.push(Waypoint::new(x_m, y_m, Some(yaw + turn)));
        yaw + turn
    };
    let mut yaw = add(STRAIGHT_M, 0.0);
    let mut left_m = length_m - STRAIGHT_M;
    loop {
        let radius = stream.between(RADIUS_M[0], RADIUS_M[1]);
        let turn = stream.between(-TURN_RAD, TURN_RAD);
        let turn = turn.clamp(-AWAY_RAD - yaw, AWAY_RAD - yaw);
        let arc_m = radius * turn.abs();
        if left_m - arc_m < STRAIGHT_M {
            break;
        }
        if arc_m > 0.2 {
            yaw = add(2.0 * radius * (turn.abs() / 2.0).sin(), turn);
            left_m -= arc_m;
        }
        let between_m = stream.between(0.1, BETWEEN_M);
        if left_m - between_m > STRAIGHT_M {
            add(between_m, 0.0);
            left_m -= between_m;
        }
    }
    add(left_m, 0.0);
    let keys = CourseKeys { waypoints, ..CourseKeys::default() };
    Course::try_from(keys).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feasible::passable;

    #[test]
    fn the_obstacles_stand_along_the_way_as_they_stand_along_the_line() {
        let mut bends = 0;
        for seed in 0..500 {
            let (line, scenario) = (crate::course::random(seed), curved(seed));
            assert_eq!(scenario.validate(), Ok(()), "{seed}");
            let course = scenario.course.as_ref().unwrap();
            assert!((course.length_m() - line.goal.last().x_m).abs() < 1e-6, "{seed}");
            assert!(course.sharpest().radius_m > RADIUS_M[0] - 1e-6, "{seed}: {:?}", course.sharpest());
            bends += usize::from(course.sharpest().radius_m < 20.0);
            for (one, other) in line.obstacles.iter().zip(&scenario.obstacles) {
                let [along, across] = scenario.on_course(other.x_m, other.y_m);
                assert!((along - one.x_m).abs() < 1e-6 && (across - one.y_m).abs() < 1e-6, "{seed}");
            }
            // As a file says it.
            let read = Scenario::parse(&scenario.to_toml(), "curved").unwrap();
            assert_eq!(read, scenario, "{seed}");
        }
        assert!(bends > 450, "{bends}");
    }

    #[test]
    fn most_of_them_are_passable() {
        let count = (0..60).filter(|seed| passable(&curved(*seed))).count();
        println!("{count} of 60");
        assert!(count >= 54, "{count}");
    }
}
