//! Whether the path is blocked: a solved optimal control problem is no proof of safety.
//!
//! When an obstacle is first seen at 2.5 m, the solver brakes to 0.1 m/s before the end of its horizon, and so only
//! postpones the collision. So every plan is extended behind its end: straight, at full lock to either side, and at
//! full lock followed by the opposite lock back to the direction of the track; the same from the present place of the
//! robot. If one of these passes all obstacles, the path is not blocked. If none does, the robot stops when the
//! solver already needed slack, or when it is nearer than the distance at which full lock still clears an obstacle
//! of that size.
//!
//! Assumed: a turn of constant radius begins a few centimetres after the command (the yaw rate needs 30 ms).
//! The family of turns is small; the lattice search covers a larger one, and a clear reference path is never blocked.

use vehicle::State;

use crate::sampled::Sampled;
use crate::scene::{Baseline, Scene, Violation};

/// Semi-axis b of a centred obstacle and the last centre distance at which full lock clears it in a corridor
/// of 1.5 m to each side [m].
const LATEST: [(f64, f64); 4] = [(0.6, 2.42), (0.8, 2.64), (1.0, 2.82), (1.2, 3.04)];
/// Obstacles whose centre is further ahead are no reason to stop yet [m].
const SIGHT_M: f64 = 4.5;
/// Step along a turn [m].
const STEP_M: f64 = 0.08;
/// Distance until a turn has begun [m].
const LAG_M: f64 = 0.03;
/// Lengths of the first turn, before the opposite one [m].
const TURNS_M: [f64; 8] = [0.5, 0.9, 1.3, 1.7, 2.1, 2.5, 2.9, 9.0];

/// Last centre distance at which full lock clears a centred obstacle with semi-axis `b` [m].
pub(crate) fn latest_distance(b: f64) -> f64 {
    let right = LATEST.iter().position(|&(table_b, _)| b < table_b).unwrap_or(LATEST.len() - 1).max(1);
    let ((b0, d0), (b1, d1)) = (LATEST[right - 1], LATEST[right]);
    d0 + (b - b0) * (d1 - d0) / (b1 - b0)
}

/// The obstacle to stop for: no continuation of the plan passes the obstacles, and there is no time to wait.
///
/// `plan` is the trajectory of the verified plan, `stop_m` the distance until the robot rests, `slack` what the solver
/// needed beyond what is accepted.
pub(crate) fn blocked_by(scene: &Scene, plan: &[Sampled], stop_m: f64, slack: f64) -> Option<usize> {
    let here = scene.initial;
    let ahead = |x: f64| x > here.x && x < here.x + SIGHT_M;
    let end_x = scene
        .predicted
        .iter()
        .filter(|obstacle| {
            ahead(obstacle.centre[0])
                && obstacle.centre[0] - obstacle.a < scene.config.goal.x_m
                && !scene.is_beyond_goal(obstacle)
        })
        .map(|obstacle| obstacle.centre[0] + obstacle.a / 2.0)
        .reduce(f64::max)?;
    let turns = Turns {
        scene,
        baseline: scene.baseline(),
        end_x: end_x.min(scene.config.goal.x_m),
        curvature: scene.full_lock_curvature(scene.config.vehicle.bounds.velocity_max_mps),
        speed: scene.config.vehicle.bounds.velocity_max_mps,
    };
    let mut best = (f64::NEG_INFINITY, None);
    for start in [plan.last().copied(), Some(Sampled { t: 0.0, speed: scene.speed, state: here })]
        .into_iter()
        .flatten()
    {
        for side in [0.0, 1.0, -1.0] {
            for &length in &TURNS_M[if side == 0.0 { 7 } else { 0 }..] {
                match turns.drive(start, side, length) {
                    Reach::Past => return None,
                    Reach::Hit { x, obstacle } if x > best.0 => best = (x, obstacle),
                    Reach::Hit { .. } => {}
                }
            }
        }
    }
    let nearest = || (0..scene.predicted.len()).filter(|&index| ahead(scene.predicted[index].centre[0]));
    let distance = |index: usize| {
        let [x, y] = scene.predicted[index].centre;
        (x - here.x).hypot(y - here.y)
    };
    let hit = best.1.or_else(|| nearest().min_by(|&a, &b| distance(a).total_cmp(&distance(b))));
    let body = scene.body_at(&here);
    let too_near = |index: usize| {
        let obstacle = &scene.predicted[index];
        distance(index) < latest_distance(obstacle.b)
            || body.distance_to_rectangle(&scene.in_plane(obstacle, 0.0)) < stop_m
    };
    hit.filter(|&index| slack > 0.0 || too_near(index))
}

/// How far a continuation gets.
enum Reach {
    Past,
    Hit { x: f64, obstacle: Option<usize> },
}

struct Turns<'a> {
    scene: &'a Scene<'a>,
    baseline: Baseline,
    end_x: f64,
    curvature: f64,
    speed: f64,
}

impl Turns<'_> {
    /// Follows a turn to `side` of `length`, then the opposite lock until along the track, then straight.
    fn drive(&self, start: Sampled, side: f64, length: f64) -> Reach {
        let Sampled { mut t, mut state, .. } = start;
        let mut course = state.yaw + state.sideslip;
        let mut driven = 0.0;
        // Longest distance: past the furthest obstacle in sight with a detour.
        while driven < 2.0 * SIGHT_M {
            if state.x >= self.end_x {
                return Reach::Past;
            }
            if let Some(violation) =
                self.scene.check(&self.baseline, &Sampled { t, speed: self.speed, state })
            {
                let obstacle = match violation {
                    Violation::Ellipse(index) | Violation::Obstacle(index) => Some(index),
                    _ => None,
                };
                // Before that body the robot lands.
                if obstacle.is_some_and(|index| self.scene.is_beyond_goal(&self.scene.predicted[index])) {
                    return Reach::Past;
                }
                return Reach::Hit { x: state.x, obstacle };
            }
            let turn = if driven < LAG_M {
                0.0
            } else if driven < length {
                side
            } else if course * side > 0.0 {
                -side
            } else {
                0.0
            };
            // Without a turn the robot follows the way.
            let bend = if turn == 0.0 { 0.0 } else { self.scene.config.course.curvature(state.x) };
            course += (turn * self.curvature - bend) * STEP_M;
            if turn == -side && course * side < 0.0 {
                course = 0.0;
            }
            state = State {
                sideslip: 0.0,
                yaw: course,
                x: state.x + STEP_M * course.cos(),
                y: state.y + STEP_M * course.sin(),
                ..state
            };
            driven += STEP_M;
            t += STEP_M / self.speed;
        }
        Reach::Hit { x: state.x, obstacle: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use crate::predicted_obstacle::PredictedObstacle;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;
    use vehicle::{Goal, Track};

    fn blocked_at(distance: f64, y: f64, b: f64, slack: f64) -> bool {
        is_blocked([distance, y], b, 0.1, slack)
    }

    fn is_blocked([distance, y]: [f64; 2], b: f64, stop_m: f64, slack: f64) -> bool {
        let body = Rectangle { centre: Vector2::new(distance, y), yaw: 0.0, length: 0.1, width: b - 0.4 };
        let predicted = [PredictedObstacle {
            id: 1,
            centre: [distance, y],
            velocity: [0.0, 0.0],
            a: 1.2_f64.max(1.15 * b),
            b,
            body,
            in_plane: None,
        }];
        let config = ControllerConfig {
            goal: Goal { x_m: 15.0, ..Goal::default() },
            track: Track { x_m: [-10.0, 22.0], ..Track::default() },
            ..ControllerConfig::default()
        };
        let scene = Scene::new(&config, &predicted, State::default());
        blocked_by(&scene, &[], stop_m, slack - 0.05).is_some()
    }

    #[test]
    fn the_table_is_interpolated_and_continued() {
        assert_eq!(latest_distance(0.8), 2.64);
        assert!((latest_distance(0.9) - 2.73).abs() < 1e-12);
        assert!((latest_distance(0.5) - 2.31).abs() < 1e-12);
        assert!((latest_distance(1.4) - 3.26).abs() < 1e-12);
    }

    #[test]
    fn centred_obstacles_are_passable_a_little_before_the_table_and_blocked_behind_it() {
        for (b, latest) in LATEST {
            assert!(!blocked_at(latest + 0.25, 0.0, b, 0.0), "b = {b}");
            assert!(blocked_at(latest - 0.35, 0.0, b, 0.0), "b = {b}");
        }
    }

    #[test]
    fn an_obstacle_that_closes_the_track_blocks_only_when_near_or_with_slack() {
        assert!(!blocked_at(4.3, 0.0, 1.7, 0.0));
        assert!(blocked_at(4.3, 0.0, 1.7, 0.06));
        assert!(blocked_at(3.3, 0.0, 1.7, 0.0));
    }

    #[test]
    fn a_robot_that_needs_longer_to_stop_is_blocked_earlier() {
        // The body is 0.28 m, the box 0.05 m long to each side: 3.97 m are between them.
        assert!(!is_blocked([4.3, 0.0], 1.7, 3.9, 0.0));
        assert!(is_blocked([4.3, 0.0], 1.7, 4.0, 0.0));
    }

    #[test]
    fn a_turn_begins_a_step_after_the_command() {
        let config = ControllerConfig::default();
        let scene = Scene::new(&config, &[], State::default());
        let speed = 1.0;
        let curvature = scene.full_lock_curvature(speed);
        let turns = Turns { scene: &scene, baseline: scene.baseline(), end_x: 9.0, curvature, speed };
        // A circle of 3.09 m leaves the track, 1.55 m to the left, after 2.68 m; one step of 0.08 m is straight.
        let start = Sampled { t: 0.0, speed, state: State::default() };
        let Reach::Hit { x, obstacle: None } = turns.drive(start, 1.0, 9.0) else {
            panic!("it leaves the track")
        };
        assert!((x - 2.76).abs() < 0.02, "{x}");
    }

    #[test]
    fn an_obstacle_beside_the_path_never_blocks() {
        assert!(!blocked_at(1.5, 1.2, 0.9, 0.1));
    }

    /// What a drive from the origin at 1 m/s meets, in a scene with these bodies.
    fn driven(predicted: &[PredictedObstacle], state: State, side: f64, length: f64, end_x: f64) -> Reach {
        let config =
            ControllerConfig { goal: Goal { x_m: 15.0, ..Goal::default() }, ..ControllerConfig::default() };
        drive_in(&config, predicted, 1.0, state, (side, length), end_x)
    }

    fn drive_in(
        config: &ControllerConfig,
        predicted: &[PredictedObstacle],
        speed: f64,
        state: State,
        (side, length): (f64, f64),
        end_x: f64,
    ) -> Reach {
        let scene = Scene::new(config, predicted, State::default());
        let curvature = scene.full_lock_curvature(1.0);
        let turns = Turns { scene: &scene, baseline: scene.baseline(), end_x, curvature, speed };
        turns.drive(Sampled { t: 0.0, speed, state }, side, length)
    }

    #[test]
    fn a_faster_turn_is_there_earlier_and_its_body_turns_with_it() {
        let config =
            ControllerConfig { goal: Goal { x_m: 15.0, ..Goal::default() }, ..ControllerConfig::default() };
        // At 2 m/s the robot is there after 1.5 s, when the body is in the way, and not after 3 s or later.
        let crossing = [body(3.0, -1.2, 0.5, 0.8)];
        let reach = |speed| drive_in(&config, &crossing, speed, State::default(), (0.0, 0.0), 5.0);
        assert!(matches!((reach(2.0), reach(1.0)), (Reach::Hit { obstacle: Some(0), .. }, Reach::Past)));
        // Its front corner comes to the wall first.
        let track = Track { walls: true, ..config.track };
        let walled = ControllerConfig { track, ..config.clone() };
        let reach = |config| drive_in(config, &[], 1.0, State::default(), (1.0, 9.0), 9.0);
        let [Reach::Hit { x, .. }, Reach::Hit { x: without_walls, .. }] = [reach(&walled), reach(&config)]
        else {
            panic!("it leaves the track")
        };
        assert!((x - 2.45).abs() < 0.02 && (without_walls - 2.76).abs() < 0.02, "{x} {without_walls}");
    }

    fn body(x: f64, y: f64, b: f64, velocity_y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.1, width: 2.0 * b };
        PredictedObstacle {
            id: 1,
            centre: [x, y],
            velocity: [0.0, velocity_y],
            a: b,
            b,
            body,
            in_plane: None,
        }
    }

    #[test]
    fn after_a_turn_the_opposite_lock_leads_back_to_along_the_track() {
        let straight = State::default();
        for side in [1.0, -1.0] {
            // 2 R (1 - cos(l / R)) with a radius of 3.09 m: 0.9 m across for 1.7 m, and 1.7 m for 2.4 m, where 1.55 m are free.
            assert!(matches!(driven(&[], straight, side, 1.7, 8.0), Reach::Past));
            assert!(matches!(driven(&[], straight, side, 2.4, 8.0), Reach::Hit { obstacle: None, .. }));
            let Reach::Hit { x, obstacle: None } = driven(&[], straight, side, 9.0, 12.0) else {
                panic!("it leaves the track")
            };
            assert!((x - 2.76).abs() < 0.02, "{x}");
        }
        // Without a turn it keeps its course, of yaw and sideslip: 1.55 m to the left after 1.55 / tan 0.4.
        for (yaw, sideslip) in [(0.3, 0.1), (0.5, -0.1), (-0.3, -0.1)] {
            let state = State { yaw, sideslip, ..State::default() };
            let Reach::Hit { x, obstacle: None } = driven(&[], state, 0.0, 0.0, 12.0) else {
                panic!("it leaves the track")
            };
            assert!((x - 3.67).abs() < 0.09, "{x}");
        }
        // A turn against its course first has to end that: 1.4 m to the right, 0.15 m are left.
        let outwards = State { y: -1.4, yaw: -0.5, ..straight };
        assert!(matches!(driven(&[], outwards, 1.0, 1.7, 8.0), Reach::Hit { x, .. } if x < 0.5));
        let Reach::Hit { x, .. } = driven(&[], straight, 0.0, 0.0, 21.0) else { panic!("it is too far") };
        assert!((x - 2.0 * SIGHT_M).abs() < 0.1, "{x}");
    }

    #[test]
    fn what_a_turn_meets_is_named_and_is_where_it_will_be() {
        // The second one is in the way; it has left when the robot gets there at 1 m/s.
        let beside = body(2.0, 1.3, 0.1, 0.0);
        let reach = driven(&[beside, body(3.0, 0.0, 0.5, 0.0)], State::default(), 0.0, 0.0, 5.0);
        assert!(matches!(reach, Reach::Hit { x, obstacle: Some(1) } if (2.0..3.0).contains(&x)));
        let reach = driven(&[beside, body(3.0, 0.0, 0.5, 0.8)], State::default(), 0.0, 0.0, 5.0);
        assert!(matches!(reach, Reach::Past));
        let reach = driven(&[beside, body(3.0, -2.4, 0.5, 0.8)], State::default(), 0.0, 0.0, 5.0);
        assert!(matches!(reach, Reach::Hit { obstacle: Some(1), .. }));
    }

    #[test]
    fn the_body_is_named_that_the_best_turn_meets_before_the_goal() {
        let blocked = |bodies: &[PredictedObstacle], goal_x_m: f64| {
            let goal = Goal { x_m: goal_x_m, ..Goal::default() };
            let track = Track { x_m: [-10.0, 22.0], ..Track::default() };
            let config = ControllerConfig { goal, track, ..ControllerConfig::default() };
            blocked_by(&Scene::new(&config, bodies, State::default()), &[], 0.1, 1.0)
        };
        let closed = |x: f64| PredictedObstacle { a: 1.2, ..body(x, 0.0, 1.9, 0.0) };
        assert_eq!(blocked(&[closed(4.4), closed(3.0)], 15.0), Some(1));
        assert_eq!(blocked(&[closed(3.0), closed(4.4)], 15.0), Some(0));
        // What begins behind the goal, and what is behind the robot, blocks nothing.
        assert_eq!(blocked(&[closed(3.0)], 2.7), Some(0));
        // Where the robot lands before the body, only another one blocks.
        assert_eq!(blocked(&[closed(3.0)], 2.5), None);
        assert_eq!(blocked(&[closed(2.0), closed(3.0)], 2.5), Some(0));
        assert_eq!(blocked(&[closed(3.8)], 2.5), None);
        assert_eq!(blocked(&[closed(-0.5)], 15.0), None);
        // Nor does what is level with the robot, what is out of sight, and what begins at the goal.
        assert_eq!([0.0, SIGHT_M, 6.0].map(|x| blocked(&[closed(x)], 15.0)), [None; 3]);
        assert_eq!(blocked(&[PredictedObstacle { a: 1.25, ..closed(3.75) }], 2.5), None);
    }

    /// What blocks a robot at a place, which rests within 0.1 m.
    fn blocking(bodies: &[PredictedObstacle], [x, y]: [f64; 2], slack: f64) -> Option<usize> {
        let goal = Goal { x_m: 15.0, ..Goal::default() };
        let track = Track { x_m: [-10.0, 22.0], ..Track::default() };
        let config = ControllerConfig { goal, track, ..ControllerConfig::default() };
        blocked_by(&Scene::new(&config, bodies, State { x, y, ..State::default() }), &[], 0.1, slack)
    }

    #[test]
    fn the_body_is_named_that_ends_the_longest_way_also_if_another_one_is_nearer() {
        for side in [1.0, -1.0] {
            let bodies = [body(2.4, -0.9 * side, 0.9, 0.0), body(3.6, 0.9 * side, 0.9, 0.0)];
            assert_eq!(blocking(&bodies, [0.0; 2], 1.0), Some(1), "{side}");
        }
    }

    #[test]
    fn the_distance_is_that_from_the_robot() {
        // For b = 1.7 m it is too late within 3.59 m.
        let closed = |x: f64, y: f64| PredictedObstacle { a: 1.2, ..body(x, y, 1.7, 0.0) };
        assert_eq!(blocking(&[closed(4.55, 0.4)], [1.0, 0.4], 0.0), Some(0));
        assert_eq!(blocking(&[closed(4.65, 0.4)], [1.0, 0.4], 0.0), None);
    }

    #[test]
    fn a_turn_has_passed_a_body_half_an_axis_behind_its_centre() {
        let blocked = |bodies: &[PredictedObstacle]| blocking(bodies, [0.0; 2], 1.0);
        let ellipse = |x: f64, y: f64, b: f64| PredictedObstacle { a: 1.2, ..body(x, y, b, 0.0) };
        // One that closes the track out of sight stands 1.3 m behind the first, whose passing ends after 0.6 m.
        let closed = PredictedObstacle { a: 1.0, ..body(4.6, 0.0, 1.9, 0.0) };
        assert_eq!(blocked(&[ellipse(2.7, 0.0, 0.6), closed]), None);
        // At the centre 1.4 m and the margin are more than the 1.55 m that are free; half an axis before they are not.
        assert_eq!(blocked(&[ellipse(4.3, 0.0, 1.4)]), Some(0));
        // To the side where there is room: right of what stands to the left, and left of what stands to the right.
        assert_eq!([0.5, -0.5].map(|y| blocked(&[ellipse(3.4, y, 1.0)])), [None; 2]);
    }
}
