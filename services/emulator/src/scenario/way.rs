//! A scenario with a course: what a file leaves open, what it may not have, and positions along and across the course.
//!
//! Without a course these positions are those in the plane.

use nalgebra::Vector2;
use toml::{Table, Value};
use vehicle::course::CourseOutline;
use vehicle::course::{CourseKeys, Waypoint};
use vehicle::frame::wrap_angle;
use vehicle::{Course, Goal, Invalid, State, Surroundings, Track};

use super::{Scenario, Start};

/// How far before its first waypoint and behind its last one a course can be driven [m].
const BEYOND_M: f64 = 2.0;
/// Largest length of a course: what the stages take for a position along it, without the part beyond its ends [m].
const MAX_LENGTH_M: f64 = 9_990.0;
/// A goal is looked for from so far behind the one before it [m].
const BETWEEN_M: f64 = 0.05;
/// Positions that differ by no more are the same [m].
const SAME_M: f64 = 1e-6;

/// Which keys a file has that a course gives without them.
pub(super) struct Given {
    track: bool,
    /// `x_m` and `y_m` of the start, and of each goal.
    start: [bool; 2],
    goals: Vec<[bool; 2]>,
    yaw: bool,
}

impl Given {
    pub(super) fn of(table: &Table) -> Self {
        let has = |value: &Value, key| value.as_table().is_some_and(|inner| inner.contains_key(key));
        let place = |value: &Value| [has(value, "x_m"), has(value, "y_m")];
        let start = table.get("start");
        Self {
            track: table.contains_key("track"),
            start: start.map_or([false; 2], place),
            goals: match table.get("goal") {
                Some(Value::Array(goals)) => goals.iter().map(place).collect(),
                Some(goal) => vec![place(goal)],
                None => vec![[false; 2]],
            },
            yaw: start.is_some_and(|start| has(start, "yaw_rad")),
        }
    }

    /// The scenario with start and goal on its course where the file has none; without a course as it is.
    ///
    /// # Errors
    /// A track beside a course, and half a position.
    pub(super) fn complete(&self, mut scenario: Scenario) -> Result<Scenario, Invalid> {
        let Some(course) = &scenario.course else { return Ok(scenario) };
        if self.track {
            return Err(Invalid::new("track", "(a table)", "either [track] or [course], not both"));
        }
        if course.keys().waypoints.is_empty() {
            scenario.course = Some(scenario.through_goals(course.keys())?);
            return Ok(scenario);
        }
        let waypoints = &course.keys().waypoints;
        let goals = self.goals.iter().enumerate().map(|(index, given)| (scenario.goal.key(index), *given));
        for (name, given) in std::iter::once(("start".to_owned(), self.start)).chain(goals) {
            let (missing, other) = match given {
                [true, false] => ("y_m", "x_m"),
                [false, true] => ("x_m", "y_m"),
                _ => continue,
            };
            let allowed = format!("a number [m], as {name}.{other} is given");
            return Err(Invalid::new(missing, "(missing)", allowed).within(&name));
        }
        if let Some(first) = waypoints.first().filter(|_| !self.start[0]) {
            (scenario.start.x_m, scenario.start.y_m) = (first.x_m, first.y_m);
        }
        if !self.yaw {
            let [along_m, _] = course.locate(Vector2::new(scenario.start.x_m, scenario.start.y_m));
            scenario.start.yaw_rad = wrap_angle(course.at(along_m).yaw);
        }
        if let Some(last) = waypoints.last() {
            let open = scenario.goal.all_mut().iter_mut().zip(&self.goals).filter(|(_, [given, _])| !given);
            open.for_each(|(goal, _)| (goal.x_m, goal.y_m) = (last.x_m, last.y_m));
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

    /// The goals along and across the course, each behind the one before it where the course passes there again. A last goal
    /// at the last waypoint is the end of the course.
    pub fn goals_on_course(&self) -> Vec<Goal> {
        self.goals_behind(0, None)
    }

    /// The goals that are left along and across the course, each behind the one before it, and the first of them not before
    /// `along_m`, where the robot is.
    pub fn goals_ahead(&self, reached: usize, along_m: f64) -> Vec<Goal> {
        self.goals_behind(reached, Some(along_m - BETWEEN_M))
    }

    fn goals_behind(&self, first: usize, mut before_m: Option<f64>) -> Vec<Goal> {
        let Some(course) = &self.course else { return self.goal.left(first).all().to_vec() };
        let last = self.goal.all().len() - 1;
        let goals = self.goal.all().iter().enumerate().skip(first).map(|(index, goal)| {
            let point = Vector2::new(goal.x_m, goal.y_m);
            let is_end = index == last && (course.at(course.length_m()).point - point).norm() < SAME_M;
            let [x_m, y_m] = match before_m {
                _ if is_end => [course.length_m(), 0.0],
                None => course.locate(point),
                Some(before_m) => course.within(point, [course.next(point, before_m + BETWEEN_M); 2]),
            };
            before_m = Some(x_m);
            Goal { x_m, y_m, ..*goal }
        });
        goals.collect()
    }

    /// The course from the start through all goals.
    fn through_goals(&self, keys: &CourseKeys) -> Result<Course, Invalid> {
        let Start { x_m, y_m, yaw_rad } = self.start;
        let start = Waypoint::new(x_m, y_m, Some(yaw_rad));
        let goals = self.goal.all().iter();
        let goals = goals.map(|goal| Waypoint::new(goal.x_m, goal.y_m, goal.yaw_rad));
        let places: Vec<Waypoint> = std::iter::once(start).chain(goals).collect();
        // The course names waypoints, which this file does not have.
        let of_goal = |mut invalid: Invalid| {
            let index = invalid.key.strip_prefix("waypoints[").and_then(|rest| rest.split_once(']'));
            let index = index.and_then(|(index, _)| index.parse::<usize>().ok());
            match index {
                Some(index) => {
                    let last = self.goal.all().len() - 1;
                    invalid.key = format!("{}.x_m", self.goal.key(index.max(1).min(last + 1) - 1));
                }
                None => invalid = invalid.within("course"),
            }
            invalid
        };
        keys.through(places).try_into().map_err(of_goal)
    }

    /// Passes when each goal that has a direction has that of the way there.
    pub(super) fn validate_goals(&self) -> Result<(), Invalid> {
        for (index, (goal, place)) in self.goal.all().iter().zip(self.goals_on_course()).enumerate() {
            let way_rad = self.course.as_ref().map_or(0.0, |course| course.robot_yaw(place.x_m));
            if goal.yaw_error_rad(way_rad).is_some_and(|error| error.abs() > goal.yaw_tolerance_rad) {
                let allowed = format!(
                    "the direction of the way there, {way_rad:.3}, by yaw_tolerance_rad = {}; a [course] without waypoints \
                     leads to goals in their directions",
                    goal.yaw_tolerance_rad
                );
                let key = format!("{}.yaw_rad", self.goal.key(index));
                return Err(Invalid::new(&key, goal.yaw_rad.unwrap_or_default(), allowed));
            }
        }
        Ok(())
    }

    /// The bounds of the robot's centre along and across the course: those of `[track]` without a course.
    pub fn track_on_course(&self) -> Track {
        let Some(course) = &self.course else { return self.track };
        let half_m = course.keys().width_m.largest_m() / 2.0;
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
        let (start, goals) = (self.start_on_course(), self.goals_on_course());
        let [first_m, last_m] = self.track_on_course().x_m;
        let mut places = vec![("start".to_owned(), [self.start.x_m, self.start.y_m], [start.x_m, start.y_m])];
        places.extend(self.goal.all().iter().zip(&goals).enumerate().map(|(index, (goal, place))| {
            (self.goal.key(index), [goal.x_m, goal.y_m], [place.x_m, place.y_m])
        }));
        for (table, [x_m, y_m], [along_m, across_m]) in &places {
            // Rounding of a place on the bound.
            let is_along = (first_m - SAME_M..=last_m + SAME_M).contains(along_m);
            let half_m = course.half_width_m(*along_m);
            if !is_along || across_m.abs() > half_m + SAME_M {
                let value = format!("{x_m} (y_m = {y_m})");
                let allowed = format!(
                    "at most {half_m} m beside the course, half of course.width_m, and {BEYOND_M} m beyond its {:.2} m; it is \
                     {across_m:.2} m to the left of it at {along_m:.2} m",
                    course.length_m()
                );
                return Err(Invalid::new(&format!("{table}.x_m"), value, allowed));
            }
        }
        for pair in places.windows(2) {
            let [(before, _, [before_m, _]), (table, [x_m, y_m], [along_m, _])] = pair else { continue };
            if along_m <= before_m {
                let allowed = format!(
                    "a place ahead of the {before}, which is at {before_m:.2} m along the course; this is at {along_m:.2} m"
                );
                return Err(Invalid::new(&format!("{table}.x_m"), format!("{x_m} (y_m = {y_m})"), allowed));
            }
        }
        Ok(())
    }
}
