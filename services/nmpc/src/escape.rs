//! Out of the way of a body that comes: blocked wheels are no safe end where a moving body will be.
//!
//! A stop is refused by nothing else in the controller. Where the robot would come to rest in the way of a body that moves,
//! and no plan keeps the whole margin, a plan is driven that keeps the clearance that holds in any case. Most of the
//! margin is for what is uncertain; the contact is not.
//!
//! Assumed: the body keeps its velocity. Where nothing comes, a stop stays a stop.

use vehicle::geometry::Rectangle;
use vehicle::{Control, State};

use crate::braking::Stopping;
use crate::rollout::Rollout;
use crate::scene::{Baseline, Scene};
use crate::verify::{VERIFIED_S, verify};

/// How long the robot is thought to rest [s]: about the horizon.
const REST_S: f64 = 5.0;
/// How long a robot that has turned out of the way must be clear there [s].
const CLEAR_S: f64 = 2.0;
/// From the decision to drive back to driving [s].
const TURNS_S: f64 = 0.7;
/// From one place that is tried on the way back to the next [m].
const BACK_M: f64 = 0.1;
/// Step of the comparison [s]: 5 cm of a body with 0.5 m/s.
const STEP_S: f64 = 0.1;

/// Turns that are tried, as shares of the largest steering angle: first one, then another.
const TURNS: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// Speeds that are tried, as shares of the fastest.
const SPEEDS: [f64; 4] = [1.0, 0.5, 0.25, 0.1];
/// How much more clearance than a stop an escape must have [m].
const GAIN_M: f64 = 0.02;
/// More clearance than this is not looked for [m].
const ENOUGH_M: f64 = 0.2;
/// Every third sample of a rollout is compared: the plan that is chosen is verified as any other.
const EVERY: usize = 3;

/// Smallest distance to a body that moves when the robot blocks its wheels now and stays, if it comes nearer than the base
/// clearance [m].
pub(crate) fn struck_at_rest(scene: &Scene, stopping: &Stopping) -> Option<f64> {
    let State { x, y, yaw, sideslip, .. } = scene.initial;
    let (sin, cos) = (yaw + sideslip).sin_cos();
    let slide = stopping.slide(scene.speed);
    let rest = scene.body_at(&State { x: x + slide * cos, y: y + slide * sin, ..scene.initial });
    let moving = || scene.predicted.iter().filter(|obstacle| obstacle.moves());
    let now = moving()
        .map(|obstacle| rest.distance_to_rectangle(&scene.in_plane(obstacle, 0.0)))
        .fold(f64::INFINITY, f64::min);
    let nearest = resting(scene, &rest, [0.0, REST_S]);
    // One that is near already comes only if it comes nearer.
    (nearest < scene.margin.base().min(now) - 1e-3).then_some(nearest)
}

/// How far a robot that rests has to drive back, to `place`, to be out of the way of a body that would strike it; `None` when
/// nothing comes, or the robot does not get out of its way [m].
pub(crate) fn back_away(
    scene: &Scene,
    stopping: &Stopping,
    speed_mps: f64,
    place: impl Fn(f64) -> Option<State>,
) -> Option<f64> {
    struck_at_rest(scene, stopping)?;
    let least = scene.margin.base() + GAIN_M;
    let mut here = scene.body_at(&scene.initial);
    let mut since_s = 0.0;
    for step in 1.. {
        let way_m = f64::from(step) * BACK_M;
        let then_s = TURNS_S + way_m / speed_mps;
        if resting(scene, &here, [since_s, then_s]) < least {
            return None;
        }
        (here, since_s) = (scene.body_at(&place(way_m)?), then_s);
        if resting(scene, &here, [then_s, REST_S.max(then_s + CLEAR_S)]) > least {
            return Some(way_m);
        }
    }
    None
}

/// Smallest distance of a body at rest to the bodies that move, from one time to another [m].
fn resting(scene: &Scene, rest: &Rectangle, [from_s, until_s]: [f64; 2]) -> f64 {
    let distance = |t: f64| {
        let moving = scene.predicted.iter().filter(|obstacle| obstacle.moves());
        moving
            .map(|obstacle| rest.distance_to_rectangle(&scene.in_plane(obstacle, t)))
            .fold(f64::INFINITY, f64::min)
    };
    let steps = ((until_s - from_s) / STEP_S).max(0.0) as usize;
    (0..=steps).map(|step| distance(from_s + step as f64 * STEP_S)).fold(f64::INFINITY, f64::min)
}

/// Fills `controls` with the turn that keeps the largest distance to all bodies of those that may be driven, and rests behind
/// its end; false when none is better than a stop that comes as near as `stopped_m` to one.
pub(crate) fn turn_away(
    scene: &Scene,
    stopped_m: f64,
    rollout: &mut Rollout,
    controls: &mut Vec<Control>,
) -> bool {
    let (bounds, config) = (scene.bounds(), scene.config);
    let count = ((VERIFIED_S / config.interval_s()).ceil() as usize).clamp(1, config.intervals);
    let fastest = config.cruise_mps.min(bounds.velocity_max_mps);
    let baseline = scene.baseline();
    let mut best: Option<(f64, [Control; 2])> = None;
    let tried = SPEEDS.iter().flat_map(|speed| {
        TURNS.iter().flat_map(move |first| TURNS.iter().map(move |then| (*speed, [*first, *then])))
    });
    let fill = |controls: &mut Vec<Control>, [first, then]: [Control; 2]| {
        controls.clear();
        controls.extend((0..count).map(|index| if index < count.div_ceil(3) { first } else { then }));
    };
    for (speed, turns) in tried {
        let velocity = (speed * fastest).max(bounds.velocity_min_mps);
        let both = turns.map(|turn| Control { velocity, steering: turn * bounds.steering_max_rad });
        fill(controls, both);
        rollout.drive(scene, controls);
        let enough = best.map_or(stopped_m + GAIN_M, |(clearance, _)| clearance);
        let clearance = clearance(scene, &baseline, rollout, enough);
        if clearance > enough && verify(scene, controls, rollout).verified().is_some() {
            best = Some((clearance, both));
        }
    }
    if let Some((_, both)) = best {
        fill(controls, both);
    }
    best.is_some()
}

/// Smallest distance to all bodies along a rollout, and to those that move while the robot rests at its end, at most
/// [`ENOUGH_M`]; minus infinity when it is not above `enough`, or when a limit is violated [m].
fn clearance(scene: &Scene, baseline: &Baseline, rollout: &Rollout, enough: f64) -> f64 {
    let mut smallest = ENOUGH_M;
    for sample in rollout.samples.iter().step_by(EVERY) {
        let body = scene.body_at(&sample.state);
        for obstacle in scene.predicted {
            smallest = smallest.min(body.distance_to_rectangle(&scene.in_plane(obstacle, sample.t)));
        }
        if smallest <= enough || scene.check(baseline, sample).is_some() {
            return f64::NEG_INFINITY;
        }
    }
    let Some(end) = rollout.samples.last() else { return f64::NEG_INFINITY };
    smallest.min(resting(scene, &scene.body_at(&end.state), [end.t, REST_S]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ControllerConfig;
    use crate::predicted_obstacle::PredictedObstacle;
    use nalgebra::Vector2;
    use vehicle::geometry::Rectangle;

    fn comes(y: f64, velocity_y: f64) -> bool {
        let body = Rectangle { centre: Vector2::new(0.5, y), yaw: 0.0, length: 0.4, width: 0.4 };
        let predicted = [PredictedObstacle {
            id: 1,
            centre: [0.5, y],
            velocity: [0.0, velocity_y],
            a: 1.2,
            b: 0.7,
            body,
            in_plane: None,
        }];
        let config = ControllerConfig::default();
        let stopping = Stopping::new(&config, 0.1, 0.1);
        // The body of the robot slides from 0.28 m to 0.42 m ahead, and is 0.2 m wide to each side.
        let scene = Scene { speed: 1.0, ..Scene::new(&config, &predicted, State::default()) };
        struck_at_rest(&scene, &stopping).is_some()
    }

    /// Whether there is a turn away from a body that crosses the place of a robot at rest, and its smallest distance to all
    /// bodies [m].
    fn turns(standing: Option<PredictedObstacle>) -> Option<f64> {
        let body = Rectangle { centre: Vector2::new(0.0, 1.0), yaw: 0.0, length: 0.3, width: 0.3 };
        let crossing = PredictedObstacle {
            id: 1,
            centre: [0.0, 1.0],
            velocity: [0.0, -0.3],
            a: 1.2,
            b: 0.7,
            body,
            in_plane: None,
        };
        let predicted: Vec<_> = standing.into_iter().chain([crossing]).collect();
        let config = ControllerConfig::default();
        let scene = Scene::new(&config, &predicted, State::default());
        let stopped_m = struck_at_rest(&scene, &Stopping::new(&config, 0.1, 0.1)).unwrap();
        let scene = Scene { escapes: true, ..scene.keeping(scene.margin.none(), 0.0) };
        let (mut rollout, mut controls) = (Rollout::default(), Vec::new());
        turn_away(&scene, stopped_m, &mut rollout, &mut controls).then(|| {
            rollout.drive(&scene, &controls);
            clearance(&scene, &scene.baseline(), &rollout, 0.0)
        })
    }

    #[test]
    fn a_robot_drives_out_of_the_way_where_there_is_room() {
        assert!(turns(None).is_some_and(|clearance_m| clearance_m > 0.1));
        let body = Rectangle { centre: Vector2::new(0.4, 0.0), yaw: 0.0, length: 0.1, width: 2.0 };
        let wall = PredictedObstacle {
            id: 2,
            centre: [0.4, 0.0],
            velocity: [0.0; 2],
            a: 1.2,
            b: 1.2,
            body,
            in_plane: None,
        };
        assert_eq!(turns(Some(wall)), None);
    }

    /// How many of the turns that are chosen may be driven, and how many are chosen, beside the left bound with a body that comes
    /// from the right.
    fn driven_turns() -> [usize; 2] {
        let config = ControllerConfig::default();
        let mut counts = [0, 0];
        for (y, yaw, below) in (0..216).map(|index| (index % 6, index / 6 % 6, index / 36)) {
            let [y, yaw, below] =
                [0.7 + 0.1 * f64::from(y), 0.06 * f64::from(yaw), 0.5 + 0.05 * f64::from(below)];
            let body = Rectangle { centre: Vector2::new(4.9, y - below), yaw: 0.0, length: 0.3, width: 0.4 };
            let centre = [4.9, y - below];
            let crossing = [PredictedObstacle {
                id: 1,
                centre,
                velocity: [0.2, 0.5],
                a: 1.2,
                b: 0.7,
                body,
                in_plane: None,
            }];
            let initial = State { x: 5.0, y, yaw, ..State::default() };
            let scene = Scene { speed: 1.0, ..Scene::new(&config, &crossing, initial) };
            let Some(stopped_m) = struck_at_rest(&scene, &Stopping::new(&config, 0.1, 0.1)) else { continue };
            let scene = Scene { escapes: true, ..scene.keeping(scene.margin.none(), 1.0) };
            let (mut rollout, mut controls) = (Rollout::default(), Vec::new());
            if turn_away(&scene, stopped_m, &mut rollout, &mut controls) {
                let may_be_driven = verify(&scene, &controls, &mut rollout).verified().is_some();
                counts = [counts[0] + usize::from(may_be_driven), counts[1] + 1];
            }
        }
        counts
    }

    #[test]
    fn every_turn_that_is_chosen_may_be_driven() {
        let [driven, chosen] = driven_turns();
        assert!(driven == chosen && chosen > 20, "{driven} of {chosen}");
    }

    #[test]
    fn a_robot_at_rest_backs_away_from_what_is_slower_or_crosses_and_not_from_what_is_faster() {
        let config = ControllerConfig::default();
        let back = |centre: [f64; 2], velocity: [f64; 2], room_m: f64| {
            let body = Rectangle { centre: centre.into(), yaw: 0.0, length: 0.4, width: 0.4 };
            let predicted =
                [PredictedObstacle { id: 1, centre, velocity, a: 1.2, b: 0.7, body, in_plane: None }];
            let scene = Scene::new(&config, &predicted, State::default());
            let place = |way: f64| (way <= room_m).then(|| State { x: -way, ..State::default() });
            back_away(&scene, &Stopping::new(&config, 0.1, 0.1), 0.3, place)
        };
        // 0.42 m ahead: after the way w, and 5 s, 0.42 + w - 0.75 m are left, of which 0.07 m are needed.
        let way = back([0.9, 0.0], [-0.15, 0.0], 5.0).unwrap();
        assert!((way - 0.5).abs() < 0.11, "{way}");
        assert_eq!(back([0.9, 0.0], [-0.15, 0.0], 0.3), None, "no room");
        assert_eq!(back([2.0, 0.0], [-0.6, 0.0], 5.0), None, "faster");
        assert!(back([0.3, 1.5], [0.0, -0.25], 5.0).is_some_and(|way| way > 0.2), "it crosses");
        assert_eq!(back([0.9, 0.0], [0.15, 0.0], 5.0), None, "it goes away");
    }

    #[test]
    fn a_body_that_crosses_the_place_of_rest_comes() {
        assert!(comes(1.5, -0.3));
        assert!(!comes(1.5, 0.3), "it goes away");
        assert!(!comes(1.5, 0.0), "it stands");
        assert!(!comes(3.0, -0.3), "it is there later");
        // Nearer than the base clearance of 0.05 m already: 0.03 m beside the robot at rest.
        assert!(!comes(0.43, 0.3), "it is near and goes away");
        assert!(comes(0.43, -0.3), "it is near and comes nearer");
    }
}
