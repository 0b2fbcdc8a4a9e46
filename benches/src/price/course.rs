//! The two courses: a gap that is the only way, and a box that closes the track suddenly. Both may stand in a bend.

use emulator::Scenario;
use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{ScenarioObstacle, Shape};
use vehicle::frame::wrap_angle;
use vehicle::{Goal, State};

/// Where the two boxes stand along the track [m].
const GAP_X_M: f64 = 8.0;
/// Where a bend begins, and where the course with it ends [m].
const BEND_X_M: f64 = 3.0;
const END_M: f64 = 17.0;
/// The goal behind them [m].
const GOAL_X_M: f64 = 16.0;
/// The middle of the gap is at most this far from the line to the goal [m].
const GAP_OFFSET_M: f64 = 0.5;
/// Nearest place of the surface of the sudden box: the robot has its cruising speed long before [m].
const SUDDEN_X_M: f64 = 6.0;
/// Length of all boxes along the track [m].
const LENGTH_M: f64 = 0.2;
/// The boxes reach this far beyond the bounds of the robot's centre, so that there is no other way [m].
const BEYOND_M: f64 = 1.5;
/// A slow robot has time to arrive, too [s].
const TIMEOUT_S: f64 = 120.0;
/// Number of the stream of random numbers, apart from those of campaigns.
const STREAM: u64 = 0x0070_7269_6365;

/// Two boxes that leave a gap of this width; the seed draws its place and all noise.
pub(super) fn gap(base: &Scenario, gap_m: f64, seed: u64) -> Scenario {
    let middle_m = NoiseStream::new(seed, Purpose::Course, STREAM).between(-GAP_OFFSET_M, GAP_OFFSET_M);
    let [low, high] = outer(base);
    let wall = |ends: [f64; 2]| wall(base, GAP_X_M, ends);
    let obstacles = vec![wall([low, middle_m - gap_m / 2.0]), wall([middle_m + gap_m / 2.0, high])];
    course(base, obstacles, seed)
}

/// A box that closes the whole track and appears `ahead_m` in front of the body; its surface is at the second value.
///
/// `shift_m` moves the box, and with it the time within a scan period at which it appears.
pub(super) fn sudden(base: &Scenario, ahead_m: f64, shift_m: f64, seed: u64) -> (Scenario, f64) {
    let surface_m = SUDDEN_X_M + shift_m;
    let closed = wall(base, surface_m + LENGTH_M / 2.0, outer(base));
    let obstacles = vec![ScenarioObstacle { appears_ahead_m: Some(ahead_m), ..closed }];
    (course(base, obstacles, seed), surface_m)
}

fn course(base: &Scenario, obstacles: Vec<ScenarioObstacle>, seed: u64) -> Scenario {
    let State { x, y, .. } = in_plane(base, GOAL_X_M, base.goals_on_course()[0].y_m);
    let goal = Goal { x_m: x, y_m: y, ..base.goal.last() }.into();
    Scenario { name: "price".to_owned(), seed, obstacles, goal, timeout_s: TIMEOUT_S, ..base.clone() }
}

/// Outer ends of the boxes across the track [m].
fn outer(base: &Scenario) -> [f64; 2] {
    let [low, high] = base.track_on_course().y_m;
    [low - BEYOND_M, high + BEYOND_M]
}

/// A box across the track from one lateral position to the other.
fn wall(base: &Scenario, x_m: f64, [low, high]: [f64; 2]) -> ScenarioObstacle {
    let State { x, y, yaw, .. } = in_plane(base, x_m, (low + high) / 2.0);
    let shape = Shape::Box { length_m: LENGTH_M, width_m: high - low, yaw_rad: wrap_angle(yaw) };
    ScenarioObstacle::fixed(shape, x, y)
}

/// A place along and to the left of the track or course.
fn in_plane(base: &Scenario, x: f64, y: f64) -> State {
    let place = State { x, y, ..State::default() };
    base.course.as_ref().map_or(place, |course| course.in_plane(&place))
}

/// The override of a course that bends to the left with this radius, from 3 m after its begin to its end [m].
pub(super) fn bend(radius_m: f64) -> String {
    let turn = |along_m: f64| (along_m - BEND_X_M) / radius_m;
    let waypoint = |along_m: f64| {
        let (sin, cos) = turn(along_m).sin_cos();
        let (x_m, y_m) = (BEND_X_M + radius_m * sin, radius_m * (1.0 - cos));
        format!("{{ x_m = {x_m:?}, y_m = {y_m:?}, yaw_rad = {:?} }}", turn(along_m))
    };
    let arc_m = END_M - BEND_X_M;
    let bend = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| waypoint(BEND_X_M + share * arc_m)).join(", ");
    format!("course.waypoints=[{{ yaw_rad = 0.0 }}, {bend}]")
}

#[cfg(test)]
mod tests {
    use courses::feasible;

    use super::*;

    /// Lateral ends of an obstacle [m].
    fn ends(obstacle: &ScenarioObstacle) -> [f64; 2] {
        let Shape::Box { width_m, .. } = obstacle.shape else { panic!("a box") };
        [obstacle.y_m - width_m / 2.0, obstacle.y_m + width_m / 2.0]
    }

    #[test]
    fn the_gap_has_its_width_near_the_line_and_is_the_only_way() {
        let base = Scenario::default();
        for seed in 1..8 {
            let course = gap(&base, 0.9, seed);
            course.validate().unwrap();
            let [[outer_low, low], [high, outer_high]] =
                [ends(&course.obstacles[0]), ends(&course.obstacles[1])];
            assert!((high - low - 0.9).abs() < 1e-12 && ((high + low) / 2.0).abs() <= 0.5);
            assert!(outer_low <= -2.9 && outer_high >= 2.9);
            assert!(feasible::passable(&course), "seed {seed}");
            assert!(!feasible::passable(&gap(&base, 0.3, seed)), "seed {seed}");
        }
        assert_ne!(gap(&base, 0.9, 1).obstacles, gap(&base, 0.9, 2).obstacles);
    }

    #[test]
    fn the_sudden_box_closes_the_track_at_its_surface() {
        let (course, surface_m) = sudden(&Scenario::default(), 1.2, 0.05, 1);
        course.validate().unwrap();
        assert!((course.obstacles[0].x_m - LENGTH_M / 2.0 - surface_m).abs() < 1e-12);
        assert!((surface_m - 6.05).abs() < 1e-12);
        assert_eq!(course.obstacles[0].appears_ahead_m, Some(1.2));
        assert!(!feasible::passable(&course));
    }
}
