//! Whether a course is passable at all, decided without the controller.
//!
//! A hybrid A* search over arcs of constant curvature: forward only, no tighter than [`RADIUS_M`], with the body
//! [`MARGIN_M`] away from every obstacle and wall, on the true geometry. The search is coarse: of all poses in one
//! cell it keeps the first. So `true` comes with a path, while `false` may be wrong by a few centimetres.
//!
//! A course with a part that is driven backwards is passable where its way itself is free.
//!
//! Obstacles that move are left out; those that appear or vanish count as if they were always there.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use vehicle::bounds::STEERING_MAX_RAD;
use vehicle::frame::wrap_angle;
use vehicle::{Course, State};

use emulator::scenario::{Scenario, ScenarioObstacle};
use emulator::scene::Scene;

/// Smallest radius of a turn [m]: the robot's own at the largest steering angle, (lh + lv) / 2 = 0.185 m by the angle, and
/// 4 % more for getting into the turn; 3.2 m at 0.06 rad.
pub const RADIUS_M: f64 = 0.192 / STEERING_MAX_RAD;

/// Distance that the body keeps [m].
pub const MARGIN_M: f64 = 0.1;

/// What a path keeps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Distance of the body to every obstacle and wall [m].
    pub margin_m: f64,
    /// Smallest radius of a turn [m].
    pub radius_m: f64,
    /// The goal counts as reached within this distance [m].
    pub goal_m: f64,
}

/// Length of one arc of the search [m].
const ARC_M: f64 = 0.3;

/// The body is checked this many times along an arc.
const CHECKS: usize = 4;

/// Curvatures of the arcs, as shares of the largest.
const CURVATURES: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];

/// Size of a cell of the search: x, y [m] and yaw [rad].
const CELL: [f64; 3] = [0.1, 0.05, 0.04];

/// The goal counts as passed within this distance, or the scenario's tolerance if that is larger [m].
const GOAL_M: f64 = 0.15;

/// Poses after which the search gives up; a track of 22 m has fewer cells that can be reached.
const MAX_NODES: usize = 3_000_000;

/// A pose on a path: position [m] and yaw [rad].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPose {
    /// Position along the track [m].
    pub x: f64,
    /// Lateral position [m].
    pub y: f64,
    /// Yaw [rad].
    pub yaw: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    place: PathPose,
    length: f64,
    parent: usize,
}

/// Whether the goal can be reached from the start.
pub fn passable(scenario: &Scenario) -> bool {
    path(scenario).is_some()
}

/// A path from the start to the goal, one pose per arc; `None` when the search finds none.
pub fn path(scenario: &Scenario) -> Option<Vec<PathPose>> {
    let fixed = scenario.placed_obstacles().into_iter().filter(|obstacle| !obstacle.moves()).collect();
    let goal_m = scenario.goal.last().tolerance_m.max(GOAL_M);
    let limits = Limits { margin_m: MARGIN_M, radius_m: RADIUS_M, goal_m };
    path_from(scenario, &start_of(scenario), fixed, &limits)
}

/// A path from a pose to the goal past these obstacles, which stand where they are described.
pub fn path_from(
    scenario: &Scenario,
    from: &PathPose,
    obstacles: Vec<ScenarioObstacle>,
    limits: &Limits,
) -> Option<Vec<PathPose>> {
    let standing =
        |ScenarioObstacle { shape, x_m, y_m, .. }: ScenarioObstacle| ScenarioObstacle::fixed(shape, x_m, y_m);
    let obstacles = obstacles.into_iter().map(standing).collect();
    let scene = Scene::new(&Scenario { obstacles, endless: None, ..scenario.clone() });
    let goal_along_m = scenario.goals_on_course().last().map_or(0.0, |goal| goal.x_m);
    Search { scenario, scene, from: *from, limits: *limits, goal_along_m }.run()
}

/// The pose at the start.
pub fn start_of(scenario: &Scenario) -> PathPose {
    let start = scenario.start;
    PathPose { x: start.x_m, y: start.y_m, yaw: start.yaw_rad }
}

struct Search<'a> {
    scenario: &'a Scenario,
    scene: Scene,
    from: PathPose,
    limits: Limits,
    /// The goal along the course [m].
    goal_along_m: f64,
}

impl Search<'_> {
    fn run(&self) -> Option<Vec<PathPose>> {
        let place = self.from;
        if !self.is_free(place) {
            return None;
        }
        if let Some(course) = self.scenario.course.as_ref().filter(|course| course.legs().len() > 1) {
            return self.along(course);
        }
        let mut nodes = vec![Node { place, length: 0.0, parent: 0 }];
        let mut seen = HashSet::from([cell(place)]);
        // The node with the smallest cost comes first, the older one of equals.
        let mut open = BinaryHeap::from([Reverse((self.cost(place, 0.0), 0))]);
        while let Some(Reverse((_, node))) = open.pop() {
            let from = nodes[node];
            for share in CURVATURES {
                let Some((place, arrived)) = self.follow(from.place, share / self.limits.radius_m) else {
                    continue;
                };
                if !arrived && !seen.insert(cell(place)) {
                    continue;
                }
                let length = from.length + ARC_M;
                nodes.push(Node { place, length, parent: node });
                if arrived {
                    return Some(trace(&nodes));
                }
                open.push(Reverse((self.cost(place, length), nodes.len() - 1)));
            }
            if nodes.len() > MAX_NODES {
                return None;
            }
        }
        None
    }

    /// The rest of the way of a course, if it is free.
    fn along(&self, course: &Course) -> Option<Vec<PathPose>> {
        let PathPose { x, y, yaw } = self.from;
        let (from_m, step_m) = (course.find(&State { x, y, yaw, ..State::default() }), ARC_M / CHECKS as f64);
        let steps = ((course.length_m() - from_m) / step_m).ceil().max(0.0) as u32;
        let places = (0..=steps).map(|step| {
            let along_m = (from_m + f64::from(step) * step_m).min(course.length_m());
            let point = course.at(along_m).point;
            PathPose { x: point.x, y: point.y, yaw: course.robot_yaw(along_m) }
        });
        let way: Vec<PathPose> = places.collect();
        way.iter().all(|place| self.is_free(*place)).then_some(way)
    }

    /// The end of an arc, and whether it passed the goal; `None` when the body can't follow it.
    fn follow(&self, from: PathPose, curvature: f64) -> Option<(PathPose, bool)> {
        let mut place = from;
        for _ in 0..CHECKS {
            place = arc(place, curvature, ARC_M / CHECKS as f64);
            if !self.is_free(place) {
                return None;
            }
            if self.goal_distance(place) <= self.limits.goal_m {
                return Some((place, true));
            }
        }
        Some((place, false))
    }

    fn is_free(&self, place: PathPose) -> bool {
        let way = self.scenario.track_on_course();
        let on_way = |place: PathPose| self.scenario.on_course(place.x, place.y);
        let ([left, right], [low, high]) = (way.x_m, self.scenario.centre_y_m());
        // A robot that is outside of a bound may come back.
        let ([x, y], from) = (on_way(place), on_way(self.from));
        let (left, right) = (left.min(from[0]), right.max(from[0]));
        let (low, high) = (low.min(from[1]), high.max(from[1]));
        let body = self.scenario.body(place.x, place.y, place.yaw);
        (left..=right).contains(&x)
            && (low..=high).contains(&y)
            && self.scene.clearance_below(&body, 0.0, self.limits.margin_m) >= self.limits.margin_m
    }

    /// Length of the path so far plus twice the distance left: finds some path soon rather than the shortest.
    ///
    /// Returned as bits, which are in the order of the numbers because no cost is negative.
    fn cost(&self, place: PathPose, length: f64) -> u64 {
        let left = match &self.scenario.course {
            Some(_) => self.goal_along_m - self.scenario.on_course(place.x, place.y)[0],
            None => 0.0,
        };
        (length + 2.0 * self.goal_distance(place).max(left)).to_bits()
    }

    fn goal_distance(&self, place: PathPose) -> f64 {
        self.scenario.goal.last().distance_m(place.x, place.y)
    }
}

/// The pose after an arc of some length.
fn arc(from: PathPose, curvature: f64, length: f64) -> PathPose {
    let turn = curvature * length;
    // The chord of a short arc points half the turn aside; sinc(turn / 2) is 1 to 1e-5 here.
    let (sin, cos) = (from.yaw + turn / 2.0).sin_cos();
    PathPose { x: from.x + length * cos, y: from.y + length * sin, yaw: wrap_angle(from.yaw + turn) }
}

fn cell(place: PathPose) -> [i64; 3] {
    [place.x / CELL[0], place.y / CELL[1], place.yaw / CELL[2]].map(|number| number.floor() as i64)
}

/// The poses from the first node to the last one.
fn trace(nodes: &[Node]) -> Vec<PathPose> {
    let mut index = nodes.len() - 1;
    let mut path = vec![nodes[index].place];
    while index > 0 {
        index = nodes[index].parent;
        path.push(nodes[index].place);
    }
    path.reverse();
    path
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::course;

    fn shipped(name: &str) -> Scenario {
        Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap()
    }

    fn with_boxes(boxes: &[[f64; 3]]) -> Scenario {
        let obstacles = boxes.iter().map(|[x, y, width]| {
            let shape = emulator::scenario::Shape::Box { length_m: 0.1, width_m: *width, yaw_rad: 0.0 };
            ScenarioObstacle::fixed(shape, *x, *y)
        });
        Scenario { obstacles: obstacles.collect(), ..Scenario::default() }
    }

    #[test]
    fn all_shipped_courses_but_the_blocked_one_are_passable() {
        // The search is forwards.
        let is_forwards = |name: &&str| {
            let course = shipped(name).course;
            !course.is_some_and(|course| course.keys().waypoints.iter().any(|waypoint| waypoint.reverse))
        };
        for name in Scenario::names().filter(is_forwards) {
            assert_eq!(passable(&shipped(name)), name != "blocked", "{name}");
        }
    }

    #[test]
    fn a_gap_has_to_be_as_wide_as_the_body_and_twice_the_margin() {
        // The centre may use y up to 1.5. A box from -5 to `edge` leaves room where edge + 0.1 + 0.2 <= 1.5; what the
        // robot has not yet turned back when it passes costs a few millimetres.
        assert!(passable(&with_boxes(&[[5.0, (-5.0 + 1.15) / 2.0, 6.15]])));
        assert!(!passable(&with_boxes(&[[5.0, (-5.0 + 1.25) / 2.0, 6.25]])));
    }

    #[test]
    fn a_box_right_ahead_can_not_be_passed_within_the_turning_radius() {
        // At full lock about (0, 3.2) the outer front corner of the body runs on a radius of hypot(3.4, 0.28) = 3.411 m;
        // with the margin, 3.511. The corner of the box at y = 0.2 lies outside of that beyond x = 1.825.
        assert!(!passable(&with_boxes(&[[1.80, 0.0, 0.4]])));
        assert!(passable(&with_boxes(&[[2.00, 0.0, 0.4]])));
    }

    #[test]
    fn a_path_keeps_the_radius_and_the_margin() {
        let scenario = shipped("slalom");
        let path = path(&scenario).unwrap();
        for pair in path.windows(2) {
            let (turn, length) =
                (wrap_angle(pair[1].yaw - pair[0].yaw), (pair[1].x - pair[0].x).hypot(pair[1].y - pair[0].y));
            assert!(turn.abs() <= ARC_M / RADIUS_M + 1e-9 && length <= ARC_M + 1e-9);
        }
        let scene = Scene::new(&scenario);
        for place in &path {
            assert!(scene.clearance(&scenario.body(place.x, place.y, place.yaw), 0.0) >= MARGIN_M);
        }
    }

    #[test]
    fn most_random_courses_are_passable() {
        let start = std::time::Instant::now();
        let count = (0..100).filter(|seed| passable(&course::random(*seed))).count();
        println!("{count} of 100 random courses are passable, {:?} each", start.elapsed() / 100);
        assert!(count >= 90, "{count}");
    }
}
