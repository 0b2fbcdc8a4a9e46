//! Random courses that turn round in three: forwards into a bend, backwards out of it, and forwards the other way.

use std::f64::consts::PI;

use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::Scenario;
use vehicle::Course;
use vehicle::course::{CourseKeys, Waypoint};

/// Length of the straight way to the turn [m].
const AHEAD_M: [f64; 2] = [7.5, 11.0];
/// The obstacles stand so far before the turn, from which the way may lead back by 3.8 m [m].
const BEFORE_TURN_M: f64 = 5.0;
/// Radius of the three arcs: backwards over more than 5.4 m the way leads to ground that the scanner did not show [m].
const RADIUS_M: [f64; 2] = [3.8, 4.8];
/// Turns of the first two arcs; the third one is what is left of half a turn [rad].
const TURN_RAD: [f64; 2] = [0.9, 1.1];
/// Free space between an obstacle and the robot in the middle of the way [m].
const BESIDE_M: [f64; 2] = [0.3, 1.0];
/// Half of the width of the robot [m].
const HALF_BODY_M: f64 = 0.2;
/// Length of the way back behind the turn [m].
const BACK_M: [f64; 2] = [1.0, 1.5];

/// The course of a seed: the obstacles of [`super::random`] stand beside the way to the turn.
pub fn reversing(seed: u64) -> Scenario {
    let line = super::random(seed);
    let mut stream = NoiseStream::new(line.seed, Purpose::Course, 4);
    let ahead_m = stream.between(AHEAD_M[0], AHEAD_M[1]);
    let course = way(ahead_m, &mut stream);
    let mut obstacles = line.obstacles.clone();
    for obstacle in &mut obstacles {
        let side = if stream.chance(0.5) { 1.0 } else { -1.0 };
        obstacle.x_m = stream.between(2.0, ahead_m - BEFORE_TURN_M);
        obstacle.y_m = side * (obstacle.reach() + HALF_BODY_M + stream.between(BESIDE_M[0], BESIDE_M[1]));
    }
    let name = format!("reversing-{}", line.seed);
    let bent = Scenario { name, obstacles, timeout_s: 120.0, ..line.clone() }.along(course);
    debug_assert!(bent.is_ok(), "{bent:?}");
    bent.unwrap_or(line)
}

fn way(ahead_m: f64, stream: &mut NoiseStream) -> Course {
    let side = if stream.chance(0.5) { 1.0 } else { -1.0 };
    let (mut place, mut yaw) = ([ahead_m, 0.0], 0.0);
    let mut waypoints = vec![Waypoint::new(0.0, 0.0, Some(0.0)), Waypoint::new(ahead_m, 0.0, Some(0.0))];
    let radius_m = stream.between(RADIUS_M[0], RADIUS_M[1]);
    let turns = [0, 1].map(|_| stream.between(TURN_RAD[0], TURN_RAD[1]));
    for (index, turn) in [turns[0], turns[1], PI - turns[0] - turns[1], 0.0].into_iter().enumerate() {
        let reverse = index == 1;
        let chord_m = if index == 3 {
            stream.between(BACK_M[0], BACK_M[1])
        } else {
            2.0 * radius_m * (turn / 2.0).sin()
        };
        let (sin, cos) = (yaw + turn / 2.0).sin_cos();
        let way_m = if reverse { -chord_m } else { chord_m };
        place = [place[0] + way_m * cos, place[1] + way_m * sin];
        yaw += turn;
        waypoints.push(Waypoint { reverse, ..Waypoint::new(place[0], side * place[1], Some(side * yaw)) });
    }
    Course::try_from(CourseKeys { waypoints, ..CourseKeys::default() }).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feasible::passable;

    #[test]
    fn each_turns_half_round_backwards_in_the_middle_and_its_way_is_free() {
        for seed in 0..300 {
            let scenario = reversing(seed);
            assert_eq!(scenario.validate(), Ok(()), "{seed}");
            let course = scenario.course.as_ref().unwrap();
            let legs = course.legs();
            assert_eq!(
                legs.iter().map(|leg| leg.is_reverse).collect::<Vec<_>>(),
                [false, true, false],
                "{seed}"
            );
            assert!(course.robot_yaw(course.length_m()).cos() < -0.999, "{seed}");
            assert!(course.sharpest().radius_m > RADIUS_M[0] - 1e-6, "{seed}: {:?}", course.sharpest());
            assert!(passable(&scenario), "{seed}");
            assert_eq!(Scenario::parse(&scenario.to_toml(), "reversing").unwrap(), scenario, "{seed}");
            let mut closed = scenario.clone();
            (closed.obstacles[0].x_m, closed.obstacles[0].y_m) = (3.0, 0.0);
            assert!(!passable(&closed), "{seed}: a body stands in the way");
        }
    }
}
