//! The judge of a drive: whether a stop was right, and whether a contact with a moving body can be excused.
//!
//! It knows the true geometry and the true robot, and nothing of the stages. A stop is right where the path search of
//! [`crate::feasible`] finds no way to the goal with a fixed margin and the true turning radius: from the start, or from
//! the true pose at an event that the robot could not foresee. Events are: an obstacle appears or vanishes, a black one
//! comes into the range at which the scanner can see it, a fault of the scanner ends, and, where a moving body has come near, the final stop with all bodies where they are then.
//!
//! A contact with a moving body is excused only if a twin touches it as well: the same robot that is sent the same
//! commands, and brakes fully from the first scan in which a beam can reach the body.

mod twin;

use shared_types::{Actuation, Pose, Truth, named_enum};

use crate::feasible::{PathPose, path_from, start_of};
use emulator::referee::Outcome;
use emulator::scenario::{Preset, Scenario, ScenarioObstacle};
use emulator::scene::Scene;
use nalgebra::Vector2;

pub use crate::feasible::Limits;
pub use twin::Touched;

/// Margin for the preset `ideal` [m].
const IDEAL_MARGIN_M: f64 = 0.1;
/// Margin for all other robots [m].
const MARGIN_M: f64 = 0.25;
/// Share of the turning radius for getting into the turn.
const TURN_IN: f64 = 1.04;
/// Smallest steering angle that counts, for robots with a large offset [rad].
const SMALLEST_STEERING_RAD: f64 = 0.01;
/// The steps of the search resolve the goal no better [m].
const GOAL_MIN_M: f64 = 0.1;
/// Time from an event to the first turn of the wheels: a scan period to see it, and one to answer [s].
const REACTION_S: f64 = 0.2;
/// A moving body that comes nearer than this to the centre of the robot may make it stop [m].
const NEAR_M: f64 = 4.0;
/// A body that already stands nearer than the margin keeps this share of its clearance.
const CLEARANCE_SHARE: f64 = 0.98;

impl Limits {
    /// The margin of a robot, and its true turning radius: that of slow wheels at the largest steering angle to its weaker side,
    /// and 4 % for getting into the turn; 3.2 m by default.
    pub fn of(scenario: &Scenario, steering_max_rad: f64) -> Self {
        let values = scenario.robot_values();
        let lost = values.steering_offset_rad.abs() + values.steering_backlash_rad;
        let steering = (steering_max_rad - lost).max(SMALLEST_STEERING_RAD);
        let margin_m = if scenario.robot.preset == Preset::Ideal { IDEAL_MARGIN_M } else { MARGIN_M };
        let radius_m = TURN_IN / (steering * values.parameters().yaw_rate_gain());
        Self { margin_m, radius_m, goal_m: scenario.goal.last().tolerance_m.max(GOAL_MIN_M) }
    }
}

/// Cause of a contact of a robot that stands.
const STRUCK: &str = "struck";

named_enum! {
    /// What a drive was.
    pub enum Verdict {
        /// Landed within the tolerance of the goal.
        Reached "reached",
        /// Stopped, gave up the goal, or out of time, where no path leads to the goal.
        StoppedRightly "stopped_rightly",
        /// Stopped, or out of time, although a path leads to the goal; or struck where braking in time would have helped.
        StoppedWrongly "stopped_wrongly",
        /// Landed elsewhere, or the goal was passed.
        Missed "missed",
        /// The moving robot touched something.
        Collision "collision",
        /// Touched by a moving body that touches the braking twin as well.
        CollisionExcused "collision_excused",
    }
}

/// The judgement of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// What the drive was.
    pub verdict: Verdict,
    /// Whether the robot ended its drive elsewhere than at the goal by its own estimate.
    pub missed_by_estimate: bool,
    /// Whether a path leads from the start to the goal.
    pub passable: bool,
    /// Drives that failed for the same reason have the same cause; a name for a folder.
    pub cause: String,
}

impl Judgement {
    /// Whether a body that moves has struck the standing robot, and braking in time would have helped.
    pub fn is_struck(&self) -> bool {
        self.verdict == Verdict::StoppedWrongly && self.cause.starts_with(STRUCK)
    }
}

/// Where the robot was when something happened.
#[derive(Debug, Clone, PartialEq)]
struct Event {
    due_s: f64,
    place: Option<PathPose>,
    obstacles: Vec<ScenarioObstacle>,
}

/// Watches a drive and judges it.
#[derive(Debug, Clone)]
pub struct Judge {
    scenario: Scenario,
    period_ns: u64,
    limits: Limits,
    passable: bool,
    scene: Scene,
    /// Obstacles that are there, do not move, and could be seen by now.
    standing: Vec<ScenarioObstacle>,
    fault_ends_s: Option<f64>,
    events: Vec<Event>,
    met_mover: bool,
    sent: Vec<Option<Actuation>>,
    last: Truth,
    estimated_goal_m: f64,
}

impl Judge {
    /// A judge at the start, of a robot that steers at most so far; the course is decided now.
    pub fn new(scenario: &Scenario, steering_max_rad: f64, period_ns: u64) -> Self {
        let (limits, scene) = (Limits::of(scenario, steering_max_rad), Scene::new(scenario));
        Self {
            limits,
            period_ns,
            passable: Self::passable(scenario, &limits),
            standing: Vec::new(),
            scene,
            fault_ends_s: scenario.scanner.to_s,
            events: Vec::new(),
            met_mover: false,
            sent: Vec::new(),
            last: Truth::default(),
            estimated_goal_m: f64::NAN,
            scenario: scenario.clone(),
        }
    }

    /// Whether a path leads from the start to the goal, with all obstacles that do not move.
    pub fn passable(scenario: &Scenario, limits: &Limits) -> bool {
        let fixed = scenario.placed_obstacles().into_iter().filter(|obstacle| !obstacle.moves()).collect();
        path_from(scenario, &start_of(scenario), fixed, limits).is_some()
    }

    /// Takes one scan: the truth, the estimated pose, and what was sent.
    pub fn observe(&mut self, truth: &Truth, pose: Option<&Pose>, sent: Option<&Actuation>) {
        let place = PathPose { x: truth.x_m, y: truth.y_m, yaw: truth.yaw_rad };
        self.scene.trigger(&self.scenario.body(place.x, place.y, place.yaw), truth.time_s);
        let standing = self.standing(&place, truth.time_s);
        let fault_ended = self.fault_ends_s.is_some_and(|end_s| truth.time_s >= end_s);
        if self.sent.is_empty() {
            self.standing = standing;
        } else if fault_ended || standing.len() != self.standing.len() {
            let due_s = truth.time_s + REACTION_S;
            self.events.push(Event { due_s, place: None, obstacles: standing.clone() });
            self.fault_ends_s = self.fault_ends_s.filter(|_| !fault_ended);
            self.standing = standing;
        }
        let due = self.events.iter_mut().filter(|event| event.place.is_none() && truth.time_s >= event.due_s);
        due.for_each(|event| event.place = Some(place));
        let centre = Vector2::new(place.x, place.y);
        let mut movers = self.scene.near(centre, NEAR_M).filter(|near| near.obstacle().moves());
        self.met_mover |= movers.any(|mover| {
            mover.solid(truth.time_s).is_some() && (mover.centre(truth.time_s) - centre).norm() < NEAR_M
        });
        self.sent.push(sent.copied());
        self.last = *truth;
        if let Some(pose) = pose {
            let goal = self.scenario.goal.last();
            self.estimated_goal_m = goal.distance_m(pose.x_m, pose.y_m);
        }
    }

    /// The judgement of the drive that the referee has ended.
    pub fn judge(&self, outcome: Outcome, reason: &str) -> Judgement {
        let gave_up = reason.starts_with("the goal was passed");
        let landed = matches!(outcome, Outcome::Reached | Outcome::Missed);
        // NaN counts as missed.
        let at_goal = self.estimated_goal_m <= self.scenario.goal.last().tolerance_m;
        let missed_by_estimate = landed && !at_goal && (self.passable || !gave_up);
        let (verdict, cause) = match outcome {
            Outcome::Reached => (Verdict::Reached, "reached".to_owned()),
            // What cannot be reached is rightly given up.
            Outcome::Missed if gave_up && !self.passable => {
                (Verdict::StoppedRightly, "stopped-goal-passed".to_owned())
            }
            Outcome::Missed if gave_up => (Verdict::Missed, "missed-goal-passed".to_owned()),
            Outcome::Missed if at_goal => (Verdict::Missed, "missed-by-truth-only".to_owned()),
            Outcome::Missed => (Verdict::Missed, "missed-landed-elsewhere".to_owned()),
            Outcome::Collision => self.contact(false),
            Outcome::Stopped if reason == "struck" => self.contact(true),
            Outcome::Stopped | Outcome::Timeout | Outcome::Interrupted | Outcome::Failed => {
                let why = reason.rsplit(": ").next().filter(|_| outcome == Outcome::Stopped);
                let verdict =
                    if self.stop_is_right() { Verdict::StoppedRightly } else { Verdict::StoppedWrongly };
                (verdict, format!("stopped-{}", why.unwrap_or(outcome.name())))
            }
        };
        Judgement { verdict, missed_by_estimate, passable: self.passable, cause }
    }

    /// Whether no path leads to the goal from the start, from an event, or past the bodies that move.
    fn stop_is_right(&self) -> bool {
        let closed =
            |event: &Event| event.place.is_some_and(|place| !self.leads_on(&place, &event.obstacles));
        !self.passable || self.events.iter().any(closed) || (self.met_mover && self.is_held_up())
    }

    /// Whether no path leads on from the last pose, with the bodies that move where they are now.
    fn is_held_up(&self) -> bool {
        let place = PathPose { x: self.last.x_m, y: self.last.y_m, yaw: self.last.yaw_rad };
        let there = self.scene.near(Vector2::new(place.x, place.y), f64::MAX);
        let there = there.filter(|near| near.solid(self.last.time_s).is_some());
        let moved = there.map(|near| {
            let centre = near.centre(self.last.time_s);
            ScenarioObstacle { x_m: centre.x, y_m: centre.y, ..*near.obstacle() }
        });
        !self.leads_on(&place, &moved.collect::<Vec<_>>())
    }

    /// Whether a path leads to the goal from a place that the robot has reached, nearer to bodies than the margin if it is.
    fn leads_on(&self, place: &PathPose, obstacles: &[ScenarioObstacle]) -> bool {
        let at_rest =
            |obstacle: &ScenarioObstacle| ScenarioObstacle::fixed(obstacle.shape, obstacle.x_m, obstacle.y_m);
        let obstacles: Vec<ScenarioObstacle> = obstacles.iter().map(at_rest).collect();
        let scene = Scene::new(&Scenario { obstacles: obstacles.clone(), ..self.scenario.clone() });
        let body = self.scenario.body(place.x, place.y, place.yaw);
        let clearance_m = scene.clearance_below(&body, 0.0, self.limits.margin_m);
        let margin_m = self.limits.margin_m.min(CLEARANCE_SHARE * clearance_m).max(0.0);
        path_from(&self.scenario, place, obstacles, &Limits { margin_m, ..self.limits }).is_some()
    }

    /// Obstacles that are there at a time, do not move, and are or were near enough to be seen if they are black.
    fn standing(&self, place: &PathPose, time_s: f64) -> Vec<ScenarioObstacle> {
        let body = self.scenario.body(place.x, place.y, place.yaw);
        let black_range_m = self.scenario.scanner.black_range_m;
        let all = self.scene.near(Vector2::zeros(), f64::MAX).filter(|near| !near.obstacle().moves());
        let there = all.filter_map(|near| Some((near.obstacle(), near.solid(time_s)?)));
        let shown = there.filter(|(obstacle, solid)| {
            !obstacle.black || self.standing.contains(obstacle) || solid.distance_to(&body) < black_range_m
        });
        shown.map(|(obstacle, _)| *obstacle).collect()
    }

    /// The verdict on a contact of the moving robot, or on one that was struck while it stood: that is a wrong stop.
    fn contact(&self, is_struck: bool) -> (Verdict, String) {
        let (verdict, kind) =
            if is_struck { (Verdict::StoppedWrongly, STRUCK) } else { (Verdict::Collision, "contact") };
        let (verdict, by) = match twin::touched(&self.scenario, self.period_ns, &self.sent) {
            Touched::Moving(mover)
                if twin::twin_is_touched(&self.scenario, self.period_ns, &self.sent, &mover) =>
            {
                (Verdict::CollisionExcused, "moving")
            }
            Touched::Moving(_) => (verdict, "moving"),
            Touched::Fixed => (verdict, "fixed"),
            Touched::Wall => (verdict, "wall"),
        };
        (verdict, format!("{kind}-{by}"))
    }
}

#[cfg(test)]
mod tests;
