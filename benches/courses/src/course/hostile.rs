//! Hostile courses: start, goal and heading anywhere, and in each family one thing that makes driving hard.
//!
//! A course need not be passable: [`crate::judge`] decides that. Families with one narrow place state its width.
//! `clutter` and `combined` leave a free lane that bends across the track, so that most of them are passable.

mod bodies;
mod fault;
mod lane;

use shared_types::named_enum;

use self::bodies::{Motion, appear, changing, mover};
use self::lane::Lane;
use super::random_obstacle::obstacle;
use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{Goal, Noise, Scenario, ScenarioObstacle, Shape, Start, Track};

named_enum! {
    /// What makes a course hard.
    pub enum Hostile {
        /// One to three obstacles as in the old campaign, nearer to each other, to the start and to the goal.
        Anywhere "anywhere",
        /// One box, 0.05 to 2.7 m wide.
        Width "width",
        /// Two boxes with a gap between them, from impassable to wide.
        Gap "gap",
        /// Ten obstacles.
        Clutter "clutter",
        /// Walls, with boxes on them that leave a gap to the other wall.
        Walls "walls",
        /// Long boxes at any angle.
        Turned "turned",
        /// A body crosses the track.
        Crossing "crossing",
        /// A body comes along the track.
        HeadOn "head_on",
        /// A slow body moves ahead of the robot.
        Overtaking "overtaking",
        /// Obstacles appear at the described distance `sudden_m` or beyond.
        Appearing "appearing",
        /// The scanner has a fault.
        Scanner "scanner",
        /// A lane between obstacles, a body that moves or appears, and a fault of the scanner.
        Combined "combined",
        /// The track is closed.
        Closed "closed",
        /// A body begins to move, stops, turns back or aside, or gets faster when the robot is near.
        Changing "changing",
    }
}

/// A course of a family.
#[derive(Debug, Clone, PartialEq)]
pub struct HostileCourse {
    /// What is driven.
    pub scenario: Scenario,
    /// Width of the narrowest place that has to be passed, where the family has one [m].
    pub gap_m: Option<f64>,
}

/// Bound of the robot's centre across the track without walls [m].
const BOUND_M: f64 = 1.5;
/// Half the width of the body [m].
const HALF_BODY_M: f64 = 0.2;
/// Start and goal are at most this far from the middle of the track [m].
const ASIDE_M: f64 = 1.2;
/// Largest heading at the start to either side [rad].
const HEADING_RAD: f64 = 0.4;
/// No obstacle stands nearer to the start than this, along the track [m].
const AFTER_START_M: f64 = 2.2;
/// No obstacle stands nearer to the goal than this, along the track [m].
const BEFORE_GOAL_M: f64 = 1.0;
/// Largest distance of the goal along the track, so that the robot can overshoot [m].
const GOAL_MAX_M: f64 = 21.4;
/// A lateral move from one bound to the other takes this way at the turning radius of 3.2 m [m].
const WAY_ACROSS_M: f64 = 5.0;
/// The robot may wait this long for a body that moves [s].
const STOP_FINAL_S: f64 = 20.0;
/// Numbers of the streams of the families.
const STREAM: u64 = 100;

/// The course of a family and a seed; always the same.
pub fn hostile(family: Hostile, seed: u64) -> HostileCourse {
    let seed = seed & i64::MAX as u64;
    let mut stream = NoiseStream::new(seed, Purpose::Course, STREAM + u64::from(family as u32));
    let needs_way = matches!(family, Hostile::Gap | Hostile::Walls | Hostile::Closed);
    let mut scenario = empty(&mut stream, needs_way);
    scenario.name = format!("{family}-{seed}");
    scenario.seed = seed;
    let gap_m = match family {
        Hostile::Anywhere => {
            let count = stream.count(1, 3);
            spread(&mut scenario, &mut stream, count, 2.5, obstacle);
            None
        }
        Hostile::Width => Some(width(&mut scenario, &mut stream)),
        Hostile::Gap => Some(gap(&mut scenario, &mut stream)),
        Hostile::Clutter => {
            let room = room(&scenario);
            Lane::new(&scenario, &mut stream).fill(&mut scenario, &mut stream, room, 10);
            None
        }
        Hostile::Walls => Some(walls(&mut scenario, &mut stream)),
        Hostile::Turned => {
            let count = stream.count(1, 2);
            spread(&mut scenario, &mut stream, count, WAY_ACROSS_M, turned);
            None
        }
        Hostile::Crossing | Hostile::HeadOn | Hostile::Overtaking => {
            let count = stream.count(0, 2);
            spread(&mut scenario, &mut stream, count, 3.0, obstacle);
            let motion = match family {
                Hostile::HeadOn => Motion::HeadOn,
                Hostile::Overtaking => Motion::Overtaking,
                _ => Motion::Crossing,
            };
            let mover = mover(motion, &scenario, &mut stream);
            scenario.obstacles.push(mover);
            scenario.stop_final_s = STOP_FINAL_S;
            None
        }
        Hostile::Changing => {
            let count = stream.count(0, 1);
            spread(&mut scenario, &mut stream, count, 3.0, obstacle);
            let parts = changing(&scenario, &mut stream);
            scenario.obstacles.extend(parts);
            scenario.stop_final_s = STOP_FINAL_S;
            None
        }
        Hostile::Appearing => {
            let count = stream.count(1, 2);
            spread(&mut scenario, &mut stream, count, WAY_ACROSS_M, obstacle);
            appear(&mut scenario, &mut stream);
            None
        }
        Hostile::Scanner => {
            let count = stream.count(1, 3);
            spread(&mut scenario, &mut stream, count, 3.5, obstacle);
            fault::add(&mut scenario, &mut stream);
            None
        }
        Hostile::Combined => {
            combine(&mut scenario, &mut stream);
            None
        }
        Hostile::Closed => {
            close(&mut scenario, &mut stream);
            None
        }
    };
    HostileCourse { scenario, gap_m }
}

/// Start, goal and noise; without obstacles.
fn empty(stream: &mut NoiseStream, needs_way: bool) -> Scenario {
    let yaw_rad = stream.between(-HEADING_RAD, HEADING_RAD);
    // Turning back from this heading takes this much to the side, at 3.2 m.
    let turning_back_m = 3.2 * (1.0 - yaw_rad.cos());
    let y_m = stream.between(-ASIDE_M, ASIDE_M) - turning_back_m.copysign(yaw_rad);
    let x_m = stream.between(0.5, 3.0);
    let shortest_m = if needs_way { 2.0 * WAY_ACROSS_M + 1.0 } else { 7.0 };
    let goal_m = stream.between(x_m + shortest_m, GOAL_MAX_M);
    Scenario {
        timeout_s: 120.0,
        start: Start { x_m, y_m: y_m.clamp(-ASIDE_M, ASIDE_M), yaw_rad },
        goal: Goal { x_m: goal_m, y_m: stream.between(-ASIDE_M, ASIDE_M), ..Goal::default() }.into(),
        noise: Noise {
            range_m: stream.between(0.0, 0.02),
            dropout: stream.between(0.0, 0.05),
            odometry_m: stream.between(0.0, 0.02),
            odometry_rad: stream.between(0.0, 0.01),
            ..Noise::default()
        },
        ..Scenario::default()
    }
}

/// Where the surfaces of obstacles may be along the track [m].
fn room(scenario: &Scenario) -> [f64; 2] {
    [scenario.start.x_m + AFTER_START_M, scenario.goal.last().x_m - BEFORE_GOAL_M]
}

/// Adds up to `count` obstacles, at least `spacing_m` apart along the track.
fn spread(
    scenario: &mut Scenario,
    stream: &mut NoiseStream,
    count: usize,
    spacing_m: f64,
    kind: impl Fn(&mut NoiseStream) -> ScenarioObstacle,
) {
    let [from, to] = room(scenario);
    let most = 1 + ((to - from) / (spacing_m + 1.0)) as usize;
    let count = count.min(most);
    let share = (to - from) / count as f64;
    for index in 0..count {
        let mut obstacle = kind(stream);
        let low = from + share * index as f64 + obstacle.reach();
        let high = (from + share * (index + 1) as f64 - obstacle.reach()).max(low + 1e-3);
        let high = if index + 1 < count {
            (high - (spacing_m - 1.0).min(share / 2.0)).max(low + 1e-3)
        } else {
            high
        };
        obstacle.x_m = stream.between(low, high);
        scenario.obstacles.push(obstacle);
    }
}

/// One box; returns the room on its wider side.
fn width(scenario: &mut Scenario, stream: &mut NoiseStream) -> f64 {
    let [from, to] = room(scenario);
    let width_m = stream.between(0.05, 2.7);
    let shape = Shape::Box { length_m: stream.between(0.05, 0.5), width_m, yaw_rad: 0.0 };
    let y_m = stream.between(-1.3, 1.3);
    scenario.obstacles.push(ScenarioObstacle::fixed(shape, stream.between(from + 0.25, to - 0.25), y_m));
    BOUND_M + HALF_BODY_M - width_m / 2.0 + y_m.abs()
}

/// Two boxes with a gap that is the only way; returns its width.
fn gap(scenario: &mut Scenario, stream: &mut NoiseStream) -> f64 {
    let gap_m = stream.between(0.55, 2.0);
    let length_m = stream.between(0.05, 1.0);
    let [from, to] = [scenario.start.x_m + WAY_ACROSS_M, scenario.goal.last().x_m - WAY_ACROSS_M];
    let x_m = stream.between(from, to);
    let reach_m = BOUND_M + HALF_BODY_M - gap_m / 2.0;
    let middle_m = stream.between(-reach_m, reach_m);
    let outer_m = BOUND_M + 1.5;
    for [low, high] in [[-outer_m, middle_m - gap_m / 2.0], [middle_m + gap_m / 2.0, outer_m]] {
        let shape = Shape::Box { length_m, width_m: high - low, yaw_rad: 0.0 };
        scenario.obstacles.push(ScenarioObstacle::fixed(shape, x_m, (low + high) / 2.0));
    }
    gap_m
}

/// Walls, and one or two boxes on alternate walls; returns the width of the narrowest gap to the other wall.
fn walls(scenario: &mut Scenario, stream: &mut NoiseStream) -> f64 {
    let wall_m = 1.9;
    scenario.track = Track { y_m: [-wall_m, wall_m], walls: true, ..scenario.track };
    let [from, to] = [scenario.start.x_m + WAY_ACROSS_M, scenario.goal.last().x_m - WAY_ACROSS_M];
    let count = if to - from > WAY_ACROSS_M + 3.0 { stream.count(1, 2) } else { 1 };
    let mut side = if stream.chance(0.5) { 1.0 } else { -1.0 };
    let (mut narrowest_m, mut x_m) = (f64::INFINITY, from);
    for index in 0..count {
        let gap_m = stream.between(0.75, 2.2);
        let width_m = 2.0 * wall_m - gap_m;
        let length_m = stream.between(0.1, 3.0);
        let last = to - (count - 1 - index) as f64 * (WAY_ACROSS_M + 3.0);
        let begins_m = stream.between(x_m, (last - length_m).max(x_m + 1e-3));
        let shape = Shape::Box { length_m, width_m, yaw_rad: 0.0 };
        scenario.obstacles.push(ScenarioObstacle::fixed(
            shape,
            begins_m + length_m / 2.0,
            side * (wall_m - width_m / 2.0),
        ));
        x_m = begins_m + length_m + WAY_ACROSS_M;
        side = -side;
        narrowest_m = narrowest_m.min(gap_m);
    }
    narrowest_m
}

/// A long box at any angle.
fn turned(stream: &mut NoiseStream) -> ScenarioObstacle {
    let shape = Shape::Box {
        length_m: stream.between(0.5, 2.5),
        width_m: stream.between(0.05, 0.4),
        yaw_rad: stream.between(-1.57, 1.57),
    };
    ScenarioObstacle::fixed(shape, 0.0, stream.between(-BOUND_M, BOUND_M))
}

/// A lane between three to five obstacles, a body that moves or appears, and sometimes a fault of the scanner.
fn combine(scenario: &mut Scenario, stream: &mut NoiseStream) {
    let count = stream.count(3, 5);
    let room = room(scenario);
    Lane::new(scenario, stream).fill(scenario, stream, room, count);
    match stream.count(0, 3) {
        0 => appear(scenario, stream),
        kind => {
            let motion = [Motion::Crossing, Motion::HeadOn, Motion::Overtaking][kind - 1];
            let mover = mover(motion, scenario, stream);
            scenario.obstacles.push(mover);
            scenario.stop_final_s = STOP_FINAL_S;
        }
    }
    if stream.chance(0.5) {
        fault::add(scenario, stream);
    }
}

/// A box across the whole track, or two with a gap that is narrower than the body.
fn close(scenario: &mut Scenario, stream: &mut NoiseStream) {
    let x_m =
        stream.between(scenario.start.x_m + AFTER_START_M + 0.5, scenario.goal.last().x_m - BEFORE_GOAL_M);
    let (length_m, gap_m) = (stream.between(0.05, 0.5), stream.between(0.0, 0.35));
    let (middle_m, outer_m) = (stream.between(-BOUND_M, BOUND_M), BOUND_M + 1.5);
    let whole = stream.chance(0.5);
    let parts = if whole {
        vec![[-outer_m, outer_m]]
    } else {
        vec![[-outer_m, middle_m - gap_m / 2.0], [middle_m + gap_m / 2.0, outer_m]]
    };
    for [low, high] in parts {
        let shape = Shape::Box { length_m, width_m: high - low, yaw_rad: 0.0 };
        scenario.obstacles.push(ScenarioObstacle::fixed(shape, x_m, (low + high) / 2.0));
    }
}

#[cfg(test)]
mod tests;
