//! The way of a body that moves: where the robot must not come to rest.
//!
//! Blocked wheels are safe only where nothing comes. So a plan must not lead to where the robot would come to rest in the
//! way of a body, unless it leads out of the way again before the body gets there. Until a plan does, the robot slows
//! down and waits before the way.
//!
//! The velocity of a body is wrong at first: as more of it comes into view, its described box grows backwards and to a
//! side, and so its centre moves slower than its front and in another direction. So the body counts as faster, and its
//! way widens with the time until it gets there.
//!
//! A robot that would be struck if it stopped now, by the velocity as it is measured, may drive any plan that keeps clear.
//! So may one that meets a body which moves more along the track than across it: there is no place before such a way, and
//! a robot that waits is struck where one that drives on gets aside.

use nalgebra::Vector2;
use vehicle::State;
use vehicle::geometry::Rectangle;

use crate::braking::Stopping;
use crate::predicted_obstacle::PredictedObstacle;
use crate::sampled::Sampled;
use crate::scene::{Baseline, Scene};

/// A body that gets to the robot later than this does not come [s].
const COMES_S: f64 = 5.0;
/// Distance from the way of a body in addition to the margin of the robot at rest [m].
const ASIDE_M: f64 = 0.05;

/// A robot that rests so much nearer to a way is no nearer [m]: the start of a plan is not exact.
const NEARER_M: f64 = 1e-3;

/// What a body may do.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Doubt {
    /// By how much faster than measured it may be, as a share and in addition [m/s].
    faster: (f64, f64),
    /// How fast it may move to its side [m/s], and how far at most [m].
    sideways: (f64, f64),
}

/// It does what is measured.
const CERTAIN: Doubt = Doubt { faster: (0.0, 0.0), sideways: (0.0, 0.0) };
/// A body that comes into view may be so much faster, and move in another direction.
const UNCERTAIN: Doubt = Doubt { faster: (0.5, 0.1), sideways: (0.2, 0.3) };

/// The body in whose way a robot stands that comes to rest at `rest` after a time: nearer to the way than one that stops
/// now, on a plan that does not lead past it in time.
pub(crate) fn stands_in_it(
    scene: &Scene,
    baseline: &Baseline,
    (rest, t): (&State, f64),
    plan: &[Sampled],
) -> Option<usize> {
    let body = scene.body_at(rest);
    let start = Sampled { t: 0.0, speed: scene.speed, state: scene.initial };
    let is_in_the_way = |index: &usize| {
        let obstacle = &scene.predicted[*index];
        if !crosses(obstacle) {
            return false;
        }
        let there = gap(obstacle, &body, t, UNCERTAIN);
        if there >= aside(scene) {
            return false;
        }
        let stopped = resting(scene, &start);
        let is_struck = gap(obstacle, &stopped, 0.0, CERTAIN) < 0.0;
        let is_nearer = there < gap(obstacle, &stopped, 0.0, UNCERTAIN) - NEARER_M;
        !is_struck && is_nearer && !leads_past(scene, baseline, *index, plan)
    };
    (0..scene.predicted.len().min(shared_types::MAX_OBSTACLES)).find(is_in_the_way)
}

/// Whether a body moves more across the track than along it.
fn crosses(obstacle: &PredictedObstacle) -> bool {
    let [x, y] = obstacle.velocity;
    obstacle.moves() && y.abs() > x.abs()
}

/// Whether a plan leads through the way of a body before it gets there, or does not lead into it.
fn leads_past(scene: &Scene, baseline: &Baseline, index: usize, plan: &[Sampled]) -> bool {
    let obstacle = &scene.predicted[index];
    let (share, clearance) = (share(obstacle, UNCERTAIN), scene.margin.base().min(baseline.gaps[index]));
    let (sideways_mps, sideways_m) = UNCERTAIN.sideways;
    let mut entered = false;
    for sample in plan {
        if sample.state.x > scene.config.goal.x_m {
            return true;
        }
        let body = scene.body_at(&sample.state);
        let needed = clearance + (sideways_mps * sample.t).min(sideways_m);
        if obstacle.body_at(sample.t * share).distance_to_rectangle(&body) < needed {
            return false;
        }
        let is_aside = gap(obstacle, &resting(scene, sample), sample.t, UNCERTAIN) >= aside(scene);
        if entered && is_aside {
            return true;
        }
        entered |= !is_aside;
    }
    let is_aside_at = |end: &Sampled| gap(obstacle, &resting(scene, end), end.t, CERTAIN) >= aside(scene);
    !entered || plan.last().is_some_and(is_aside_at)
}

/// Distance that a robot at rest keeps from the way of a body [m].
fn aside(scene: &Scene) -> f64 {
    scene.margin.sum(0.0, 0.0) + ASIDE_M
}

/// The body of the robot after a straight slide from a sample.
fn resting(scene: &Scene, from: &Sampled) -> Rectangle {
    let stopping = Stopping::new(scene.config, scene.config.period_s, scene.margin.age_s());
    let slide = stopping.slide(from.speed);
    let State { x, y, yaw, sideslip, .. } = from.state;
    let (sin, cos) = (yaw + sideslip).sin_cos();
    scene.body_at(&State { x: x + slide * cos, y: y + slide * sin, ..from.state })
}

/// How many times its velocity a body may be fast.
fn share(obstacle: &PredictedObstacle, doubt: Doubt) -> f64 {
    let speed = obstacle.velocity[0].hypot(obstacle.velocity[1]);
    1.0 + doubt.faster.0 + doubt.faster.1 / speed.max(1e-3)
}

/// Distance of a robot that rests from `t` on from the strip that a body covers [m]; negative inside of it.
///
/// The strip is as wide as the box and widens. A robot that the box has passed by then, or gets to later than a body that
/// comes, is infinitely far away.
fn gap(obstacle: &PredictedObstacle, rest: &Rectangle, t: f64, doubt: Doubt) -> f64 {
    let [x, y] = obstacle.velocity;
    let speed = x.hypot(y);
    if speed <= 0.0 {
        return f64::INFINITY;
    }
    let (along, across) = (Vector2::new(x, y) / speed, Vector2::new(-y, x) / speed);
    let offset = rest.centre - obstacle.body.centre;
    let reach = |axis: &Vector2<f64>| half_extent(rest, axis) + half_extent(&obstacle.body, axis);
    let (ahead, both) = (offset.dot(&along), reach(&along));
    let has_passed = ahead + both < speed * t;
    if has_passed || ahead - both > share(obstacle, doubt) * speed * (t + COMES_S) {
        return f64::INFINITY;
    }
    let until_there_s = (ahead - both).max(0.0) / speed;
    let (sideways_mps, sideways_m) = doubt.sideways;
    offset.dot(&across).abs() - reach(&across) - (sideways_mps * until_there_s).min(sideways_m)
}

/// Half the extent of a rectangle along an axis of unit length [m].
fn half_extent(rectangle: &Rectangle, axis: &Vector2<f64>) -> f64 {
    let (sin, cos) = rectangle.yaw.sin_cos();
    let (forward, left) = (axis.x * cos + axis.y * sin, axis.y * cos - axis.x * sin);
    (rectangle.length * forward.abs() + rectangle.width * left.abs()) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    /// A cart, 0.6 m by 1 m, that comes from the right of (3, 0) with 0.5 m/s; its front is at `y` + 0.5 m.
    fn cart(y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(3.0, y), yaw: 0.0, length: 0.6, width: 1.0 };
        PredictedObstacle { id: 1, centre: [3.0, y], velocity: [0.0, 0.5], a: 0.1, b: 0.1, body }
    }

    fn gap_at(x: f64, y: f64, t: f64, doubt: Doubt) -> f64 {
        let rest = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.56, width: 0.4 };
        gap(&cart(-2.0), &rest, t, doubt)
    }

    #[test]
    fn the_way_is_a_strip_that_begins_with_the_body() {
        let certain = |x: f64, y: f64, t: f64| gap_at(x, y, t, CERTAIN);
        // Half of the robot is 0.28 m long, half of the cart 0.3 m.
        assert!((certain(2.0, 0.0, 0.0) - 0.42).abs() < 1e-12);
        assert!((certain(4.0, 0.0, 0.0) - 0.42).abs() < 1e-12);
        assert!((certain(3.1, 0.0, 0.0) + 0.48).abs() < 1e-12);
        assert_eq!(certain(3.0, -3.0, 0.0), f64::INFINITY, "the cart has passed");
        // Its rear is at -2.5 m + 0.5 m/s t, the robot 0.2 m wide to its side.
        assert!(certain(3.0, 0.0, 5.3) < 0.0 && certain(3.0, 0.0, 5.5) == f64::INFINITY);
        // Its front moves 2.5 m in 5 s.
        assert!(certain(3.0, 1.1, 0.0) < 0.0 && certain(3.0, 1.3, 0.0) == f64::INFINITY);
    }

    #[test]
    fn a_body_that_is_not_known_well_comes_from_further_away_and_its_way_widens() {
        let uncertain = |x: f64, y: f64| gap_at(x, y, 0.0, UNCERTAIN);
        // With 0.85 m/s, a half and 0.1 m/s more, its front moves 4.25 m in 5 s.
        assert!(uncertain(3.0, 2.9) < 0.0 && uncertain(3.0, 3.0) == f64::INFINITY);
        // Its front is 1.3 m before the robot, which takes 2.6 s: 0.52 m to the side, of which 0.3 m count.
        assert!((uncertain(2.0, 0.0) - 0.12).abs() < 1e-12);
        // 0.5 m before it: 0.2 m.
        assert!((uncertain(2.0, -0.8) - 0.22).abs() < 1e-12);
    }

    /// The body in whose way a robot comes to rest that blocks its wheels after 0.2 s at 1 m/s, 0.14 m further on.
    fn stands(x: f64, y: f64) -> Option<usize> {
        let (config, predicted) = (Config::default(), [cart(y)]);
        let initial = State { x, ..State::default() };
        let scene = Scene { speed: 1.0, ..Scene::new(&config, &predicted, initial) };
        let at = |t: f64| Sampled { t, speed: 1.0, state: State { x: x + t, ..initial } };
        let plan: Vec<_> = (0..60).map(|step| at(f64::from(step) * 0.05)).collect();
        let rest = State { x: x + 0.34, ..initial };
        stands_in_it(&scene, &scene.baseline(), (&rest, 0.34), &plan)
    }

    #[test]
    fn a_robot_does_not_come_to_rest_in_the_way_unless_it_leads_out_of_it_in_time() {
        // The way begins at 2.7 m and widens by 0.3 m; the robot comes to rest 0.18 m before it, or in it. 0.13 m are kept.
        assert_eq!(stands(1.6, -2.0), None);
        assert_eq!(stands(1.8, -2.0), Some(0));
        // It leaves the way of the box after 1.78 s, and the wider one after 2.07 s. A cart with 0.85 m/s has its front at
        // 0.01 m and 0.26 m then, or at -0.89 m and -0.64 m: 0.44 m beside the robot, and 0.35 m are kept.
        assert_eq!(stands(1.8, -2.9), None);
    }

    #[test]
    fn a_body_that_comes_along_the_track_is_not_waited_for() {
        let moving = |velocity: [f64; 2]| crosses(&PredictedObstacle { velocity, ..cart(-2.0) });
        // From ahead, from behind, from ahead and aside; across, and across and towards the robot.
        assert_eq!([[-0.5, 0.0], [0.5, 0.1], [-0.4, 0.3]].map(moving), [false; 3]);
        assert_eq!([[0.0, 0.5], [-0.3, -0.4]].map(moving), [true; 2]);
        assert!(!moving([0.0, 0.0]), "it stands");
    }

    #[test]
    fn a_robot_that_would_be_struck_if_it_stopped_may_drive_on() {
        assert_eq!(stands(2.6, -2.0), None);
    }

    #[test]
    fn a_robot_does_not_come_nearer_to_the_way_than_one_that_stops_now() {
        let (config, predicted) = (Config::default(), [cart(-2.0)]);
        let scene = Scene::new(&config, &predicted, State { x: 2.36, ..State::default() });
        // It rests 0.06 m before the way of the box, and would creep into it.
        let at = |t: f64| Sampled { t, speed: 0.1, state: State { x: 2.36 + 0.1 * t, ..State::default() } };
        let plan: Vec<_> = (0..60).map(|step| at(f64::from(step) * 0.05)).collect();
        let stands = |x: f64| {
            let rest = State { x, ..State::default() };
            stands_in_it(&scene, &scene.baseline(), (&rest, 0.2), &plan).is_some()
        };
        assert_eq!([2.36, 2.38].map(stands), [false, true]);
    }
}
