//! How far a robot has come along the course: a goal where the course passes more than once is reached in its own lap.

use vehicle::course::LegFollower;
use vehicle::{Course, State};

use crate::scenario::Scenario;

/// A goal may be landed at so much earlier, by its tolerance and by what is cut at bends [m].
const EARLY_M: f64 = 1.5;
/// A robot is at most so far before the place where it was seen last: what was noted is not exact [m].
const BEFORE_M: f64 = 2.0;
/// A robot this far beside the course was put elsewhere [m].
const ASTRAY_M: f64 = 5.0;

/// The place of the robot on the course.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    course: Option<(Course, LegFollower)>,
    along_m: f64,
    /// Where it was when this began, in a drive that another has followed before.
    resumed_m: Option<f64>,
    /// Where the goals are [m].
    goals_m: Vec<f64>,
}

impl Progress {
    /// At the start of a scenario; without a course there is nothing to follow.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let along_m = scenario.start_on_course().x_m;
        Self {
            course: scenario.course.clone().map(|course| {
                let follower = LegFollower::new(&course, along_m);
                (course, follower)
            }),
            along_m,
            resumed_m: None,
            goals_m: scenario.goals_on_course().iter().map(|goal| goal.x_m).collect(),
        }
    }

    /// Continues from a place on the course; meanwhile the robot may have driven further.
    pub(super) fn resume(&mut self, along_m: f64) {
        (self.along_m, self.resumed_m) = (along_m, Some(along_m));
    }

    /// Follows the robot to a position and direction in the plane.
    pub(super) fn follow(&mut self, [x, y, yaw]: [f64; 3]) {
        let Some((course, follower)) = self.course.as_mut().filter(|_| x.is_finite() && y.is_finite()) else {
            return;
        };
        let pose = State { x, y, yaw, ..State::default() };
        if let Some(resumed_m) = self.resumed_m.take() {
            follower.put(course.find_from(&pose, resumed_m - BEFORE_M));
        } else if follower.follow(&pose).y.abs() >= ASTRAY_M {
            follower.put(course.find(&pose));
        }
        self.along_m = follower.along_m();
    }

    /// From now on a goal is elsewhere [m].
    pub(super) fn change_goal(&mut self, index: usize, along_m: f64) {
        self.goals_m.get_mut(index).into_iter().for_each(|place| *place = along_m);
    }

    /// Where the robot is on the course [m].
    pub(super) fn along_m(&self) -> f64 {
        self.along_m
    }

    /// Length of the course before a goal that is not driven yet, zero near the goal [m].
    pub(super) fn left_m(&self, goal: usize) -> f64 {
        let left_m = self.goals_m.get(goal).map_or(0.0, |goal_m| goal_m - self.along_m);
        if self.course.is_some() && left_m > EARLY_M { left_m } else { 0.0 }
    }
}
