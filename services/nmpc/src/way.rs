//! The way of a body that moves: where the robot must not come to rest.
//!
//! Blocked wheels are safe only where nothing comes. So a plan must not lead to where the robot would come to rest in the
//! way of a body, unless it leads out of the way again before the body gets there. Until a plan does, the robot slows
//! down and waits before the way.
//!
//! The velocity of a body is wrong at first: as more of it comes into view, its described box grows backwards and to a
//! side, and so its centre moves slower than its front and in another direction. So a body counts as faster, and its way
//! widens with the time until it gets there, by as much as its size explains for the time for which it was seen.
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
/// How far a body may get to the side of its way [m].
const SIDEWAYS_M: f64 = 0.3;

/// A body that moves: where to, and how wrong that may be.
#[derive(Debug, Clone, Copy)]
struct Mover<'a> {
    obstacle: &'a PredictedObstacle,
    /// As measured [m/s].
    speed: f64,
    /// Unit vectors along its velocity and to the left of that.
    along: Vector2<f64>,
    across: Vector2<f64>,
    /// By how much faster than measured it may be, and how fast it may move to its side [m/s].
    doubt: [f64; 2],
}

impl<'a> Mover<'a> {
    /// A body that does what is measured; `None` when it stands.
    fn certain(obstacle: &'a PredictedObstacle) -> Option<Self> {
        let [x, y] = obstacle.velocity;
        let speed = Some(x.hypot(y)).filter(|speed| *speed > 0.0)?;
        let (along, across) = (Vector2::new(x, y) / speed, Vector2::new(-y, x) / speed);
        Some(Self { obstacle, speed, along, across, doubt: [0.0; 2] })
    }

    /// The same body, whose box came into view since it was first seen: its centre moved by half of its size because of
    /// that.
    fn doubted(self, period_s: f64) -> Self {
        let seen_s = self.obstacle.sightings.saturating_sub(1).max(1) as f64 * period_s;
        let wrong = |axis: &Vector2<f64>| half_extent(&self.obstacle.body, axis) / seen_s;
        Self { doubt: [wrong(&self.along), wrong(&self.across)], ..self }
    }

    /// Whether it moves more across the track than along it.
    fn crosses(&self) -> bool {
        self.along.y.abs() > self.along.x.abs()
    }

    /// How fast it may be [m/s].
    fn fastest(&self) -> f64 {
        self.speed + self.doubt[0]
    }

    /// How far it may get to its side in a time [m].
    fn sideways(&self, t: f64) -> f64 {
        (self.doubt[1] * t).min(SIDEWAYS_M)
    }

    /// Distance of a robot that rests from `t` on from the strip that the body covers [m]; negative inside of it.
    ///
    /// The strip is as wide as the box and widens. A robot that the box has passed by then, or gets to later than a body
    /// that comes, is infinitely far away.
    fn gap(&self, rest: &Rectangle, t: f64) -> f64 {
        let offset = rest.centre - self.obstacle.body.centre;
        let reach = |axis: &Vector2<f64>| half_extent(rest, axis) + half_extent(&self.obstacle.body, axis);
        let (ahead, both) = (offset.dot(&self.along), reach(&self.along));
        let has_passed = ahead + both < self.speed * t;
        if has_passed || ahead - both > self.fastest() * (t + COMES_S) {
            return f64::INFINITY;
        }
        let until_there_s = (ahead - both).max(0.0) / self.speed;
        offset.dot(&self.across).abs() - reach(&self.across) - self.sideways(until_there_s)
    }

    /// Whether a plan leads through the way before the body gets there, or does not lead into it; `clearance` is kept [m].
    fn is_left_behind(&self, scene: &Scene, clearance: f64, plan: &[Sampled]) -> bool {
        let share = self.fastest() / self.speed;
        let is_aside = |from: &Sampled| self.gap(&resting(scene, from), from.t) >= aside(scene);
        let mut entered = false;
        for sample in plan {
            if sample.state.x > scene.config.goal.x_m {
                return true;
            }
            let body = scene.body_at(&sample.state);
            let distance = self.obstacle.body_at(sample.t * share).distance_to_rectangle(&body);
            if distance < clearance + self.sideways(sample.t) {
                return false;
            }
            if entered && is_aside(sample) {
                return true;
            }
            entered |= !is_aside(sample);
        }
        let certain = Self { doubt: [0.0; 2], ..*self };
        let ends_aside = |end: &Sampled| certain.gap(&resting(scene, end), end.t) >= aside(scene);
        !entered || plan.last().is_some_and(ends_aside)
    }
}

/// The body in whose way a robot stands that comes to rest at `rest` after a time: nearer to the way than one that stops
/// now, on a plan that does not lead past it in time.
pub(crate) fn stands_in_it(
    scene: &Scene,
    baseline: &Baseline,
    (rest, t): (&State, f64),
    plan: &[Sampled],
) -> Option<usize> {
    let body = scene.body_at(rest);
    let stopped = resting(scene, &Sampled { t: 0.0, speed: scene.speed, state: scene.initial });
    let stands_in = |(index, obstacle): (usize, &PredictedObstacle)| {
        let certain = Mover::certain(obstacle).filter(Mover::crosses)?;
        let mover = certain.doubted(scene.config.period_s);
        let there = mover.gap(&body, t);
        if there >= aside(scene) {
            return None;
        }
        let is_struck = certain.gap(&stopped, 0.0) < 0.0;
        let is_nearer = there < mover.gap(&stopped, 0.0) - NEARER_M;
        let clearance = scene.margin.base().min(baseline.gaps[index]);
        (!is_struck && is_nearer && !mover.is_left_behind(scene, clearance, plan)).then_some(index)
    };
    scene.predicted.iter().take(shared_types::MAX_OBSTACLES).enumerate().find_map(stands_in)
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

    /// A cart, 0.6 m by 1 m, that comes from the right of (3, 0) with 0.5 m/s; its front is at `y` + 0.5 m. Seen for 2 s, it
    /// may be 0.25 m/s faster and move to its side by 0.15 m/s.
    fn cart(y: f64) -> PredictedObstacle {
        let body = Rectangle { centre: Vector2::new(3.0, y), yaw: 0.0, length: 0.6, width: 1.0 };
        let velocity = [0.0, 0.5];
        PredictedObstacle { id: 1, centre: [3.0, y], velocity, a: 0.1, b: 0.1, body, sightings: 21 }
    }

    fn gap_at(x: f64, y: f64, t: f64, is_doubted: bool) -> f64 {
        let rest = Rectangle { centre: Vector2::new(x, y), yaw: 0.0, length: 0.56, width: 0.4 };
        let cart = cart(-2.0);
        let certain = Mover::certain(&cart).unwrap();
        if is_doubted { certain.doubted(0.1).gap(&rest, t) } else { certain.gap(&rest, t) }
    }

    #[test]
    fn the_way_is_a_strip_that_begins_with_the_body() {
        let certain = |x: f64, y: f64, t: f64| gap_at(x, y, t, false);
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
        let doubted = |x: f64, y: f64| gap_at(x, y, 0.0, true);
        // With 0.75 m/s its front moves 3.75 m in 5 s.
        assert!(doubted(3.0, 2.4) < 0.0 && doubted(3.0, 2.5) == f64::INFINITY);
        // Its front is 1.3 m before the robot, which takes 2.6 s: 0.39 m to the side, of which 0.3 m count.
        assert!((doubted(2.0, 0.0) - 0.12).abs() < 1e-12);
        // 0.5 m before it: 0.15 m.
        assert!((doubted(2.0, -0.8) - 0.27).abs() < 1e-12);
    }

    #[test]
    fn a_body_that_was_seen_for_long_or_is_small_is_known_well() {
        let doubt = |sightings: u64, size: f64, period_s: f64| {
            let body = Rectangle { length: size, width: size, ..cart(0.0).body };
            let obstacle = PredictedObstacle { sightings, body, ..cart(0.0) };
            Mover::certain(&obstacle).unwrap().doubted(period_s).doubt
        };
        assert_eq!(doubt(21, 1.0, 0.1), [0.25; 2]);
        assert_eq!(doubt(101, 1.0, 0.02), [0.25; 2], "by time, not by scans");
        assert_eq!(doubt(41, 1.0, 0.1), [0.125; 2]);
        assert_eq!(doubt(21, 0.2, 0.1), [0.05; 2]);
        assert_eq!(doubt(0, 0.2, 0.1), [1.0; 2], "a body just seen");
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
        // It leaves the way of the box after 1.78 s, and the wider one after 2.07 s. A cart with 0.75 m/s has its front at
        // -0.85 m then: 0.65 m beside the robot, and 0.35 m are kept.
        assert_eq!(stands(1.8, -2.9), None);
    }

    #[test]
    fn a_body_that_comes_along_the_track_is_not_waited_for() {
        let crosses = |velocity: [f64; 2]| {
            let obstacle = PredictedObstacle { velocity, ..cart(-2.0) };
            Mover::certain(&obstacle).is_some_and(|mover| mover.crosses())
        };
        // From ahead, from behind, from ahead and aside; across, and across and towards the robot.
        assert_eq!([[-0.5, 0.0], [0.5, 0.1], [-0.4, 0.3]].map(crosses), [false; 3]);
        assert_eq!([[0.0, 0.5], [-0.3, -0.4]].map(crosses), [true; 2]);
        assert!(!crosses([0.0, 0.0]), "it stands");
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
