//! A scenario with a course: what a file leaves open, what it may not have, and positions along and across the course.
//!
//! Without a course these positions are those in the plane.

use nalgebra::Vector2;
use toml::{Table, Value};
use vehicle::course::CourseOutline;
use vehicle::frame::wrap_angle;
use vehicle::{Course, Goal, Invalid, State, Surroundings, Track};

use super::{Scenario, Start};

/// How far before its first waypoint and behind its last one a course can be driven [m].
const BEYOND_M: f64 = 2.0;
/// Largest length of a course: what the stages take for a position along it, without the part beyond its ends [m].
const MAX_LENGTH_M: f64 = 9_990.0;
/// Positions that differ by no more are the same [m].
const SAME_M: f64 = 1e-6;

/// Which keys a file has that a course gives without them.
pub(super) struct Given {
    track: bool,
    /// `x_m` and `y_m` of start and goal.
    places: [(&'static str, [bool; 2]); 2],
    yaw: bool,
}

impl Given {
    pub(super) fn of(table: &Table) -> Self {
        let has = |name, key| {
            table.get(name).and_then(Value::as_table).is_some_and(|inner| inner.contains_key(key))
        };
        let place = |name| (name, [has(name, "x_m"), has(name, "y_m")]);
        Self {
            track: table.contains_key("track"),
            places: ["start", "goal"].map(place),
            yaw: has("start", "yaw_rad"),
        }
    }

    /// The scenario with start and goal on its course where the file has none; without a course as it is.
    ///
    /// # Errors
    /// A track beside a course, and half a position.
    pub(super) fn complete(&self, mut scenario: Scenario) -> Result<Scenario, Invalid> {
        let Some(course) = &scenario.course else { return Ok(scenario) };
        let waypoints = &course.keys().waypoints;
        if self.track {
            return Err(Invalid::new("track", "(a table)", "either [track] or [course], not both"));
        }
        for (name, given) in self.places {
            let (missing, other) = match given {
                [true, false] => ("y_m", "x_m"),
                [false, true] => ("x_m", "y_m"),
                _ => continue,
            };
            let allowed = format!("a number [m], as {name}.{other} is given");
            return Err(Invalid::new(missing, "(missing)", allowed).within(name));
        }
        let [(_, [has_start, _]), (_, [has_goal, _])] = self.places;
        if let Some(first) = waypoints.first().filter(|_| !has_start) {
            (scenario.start.x_m, scenario.start.y_m) = (first.x_m, first.y_m);
        }
        if !self.yaw {
            let [along_m, _] = course.locate(Vector2::new(scenario.start.x_m, scenario.start.y_m));
            scenario.start.yaw_rad = wrap_angle(course.at(along_m).yaw);
        }
        if let Some(last) = waypoints.last().filter(|_| !has_goal) {
            (scenario.goal.x_m, scenario.goal.y_m) = (last.x_m, last.y_m);
        }
        Ok(scenario)
    }
}

impl Scenario {
    /// This scenario along a course, from its first waypoint to its last one.
    ///
    /// # Errors
    /// What [`Self::validate`] finds.
    pub fn along(self, course: Course) -> Result<Self, Invalid> {
        let scenario = Self { course: Some(course), track: Track::default(), ..self };
        let scenario = Given::of(&Table::new()).complete(scenario)?;
        scenario.validate()?;
        Ok(scenario)
    }

    /// Length along the course and distance to the left of it of a point in the plane [m]; without a course the point itself.
    pub fn on_course(&self, x_m: f64, y_m: f64) -> [f64; 2] {
        self.course.as_ref().map_or([x_m, y_m], |course| course.locate(Vector2::new(x_m, y_m)))
    }

    /// The start along and across the course, with its yaw relative to it.
    pub fn start_on_course(&self) -> Start {
        let Some(course) = &self.course else { return self.start };
        let Start { x_m, y_m, yaw_rad } = self.start;
        let state = State { x: x_m, y: y_m, yaw: yaw_rad, ..State::default() };
        let State { x, y, yaw, .. } = course.on_course(&state, course.find(&state));
        Start { x_m: x, y_m: y, yaw_rad: yaw }
    }

    /// The goal along and across the course. A goal at the last waypoint is the end of the course, also where the course passes
    /// there before.
    pub fn goal_on_course(&self) -> Goal {
        let Some(course) = &self.course else { return self.goal };
        let Goal { x_m, y_m, .. } = self.goal;
        let is_end = (course.at(course.length_m()).point - Vector2::new(x_m, y_m)).norm() < SAME_M;
        let [x_m, y_m] = if is_end { [course.length_m(), 0.0] } else { self.on_course(x_m, y_m) };
        Goal { x_m, y_m, ..self.goal }
    }

    /// The bounds of the robot's centre along and across the course: those of `[track]` without a course.
    pub fn track_on_course(&self) -> Track {
        let Some(course) = &self.course else { return self.track };
        let half_m = course.keys().width_m / 2.0;
        Track {
            x_m: [-BEYOND_M, course.length_m() + BEYOND_M],
            y_m: [-half_m, half_m],
            walls: false,
            surroundings: self.surroundings(),
        }
    }

    /// The course and its way as lines that can be drawn; none without a course.
    pub fn course_outline(&self) -> Option<CourseOutline> {
        self.course.as_ref().map(|course| course.outline(self.track_on_course().x_m))
    }

    /// What the scanner sees outside of the track or the course.
    pub fn surroundings(&self) -> Surroundings {
        self.course.as_ref().map_or(self.track.surroundings, |course| course.keys().surroundings)
    }

    /// Passes when there is a course, and start and goal are on its way in this order.
    pub(super) fn validate_course(&self, course: &Course) -> Result<(), Invalid> {
        if course.is_line() {
            let allowed = "at least two; without [course] the robot follows the line along x";
            return Err(Invalid::new("course.waypoints", "[]", allowed));
        }
        if course.length_m() > MAX_LENGTH_M {
            let value = format!("a course of {:.1} m", course.length_m());
            return Err(Invalid::new("course.waypoints", value, format!("at most {MAX_LENGTH_M} m")));
        }
        if self.endless.is_some() {
            let allowed = "not with [course]: it places obstacles along the line through the start";
            return Err(Invalid::new("endless", "(a table)", allowed));
        }
        let (start, goal) = (self.start_on_course(), self.goal_on_course());
        let Track { x_m: [first_m, last_m], y_m: [right_m, left_m], .. } = self.track_on_course();
        let places = [
            ("start.x_m", [self.start.x_m, self.start.y_m], [start.x_m, start.y_m]),
            ("goal.x_m", [self.goal.x_m, self.goal.y_m], [goal.x_m, goal.y_m]),
        ];
        for (key, [x_m, y_m], [along_m, across_m]) in places {
            // Rounding of a place on the bound.
            let is_along = (first_m - SAME_M..=last_m + SAME_M).contains(&along_m);
            if !is_along || !(right_m - SAME_M..=left_m + SAME_M).contains(&across_m) {
                let value = format!("{x_m} (y_m = {y_m})");
                let allowed = format!(
                    "at most {left_m} m beside the course, half of course.width_m, and {BEYOND_M} m beyond its {:.2} m; it is \
                     {across_m:.2} m to the left of it at {along_m:.2} m",
                    course.length_m()
                );
                return Err(Invalid::new(key, value, allowed));
            }
        }
        if goal.x_m <= start.x_m {
            let value = format!("{} (y_m = {})", self.goal.x_m, self.goal.y_m);
            let allowed = format!(
                "a place ahead of the start, which is at {:.2} m along the course; this is at {:.2} m",
                start.x_m, goal.x_m
            );
            return Err(Invalid::new("goal.x_m", value, allowed));
        }
        Ok(())
    }
}
