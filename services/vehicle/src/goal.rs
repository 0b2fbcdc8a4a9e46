//! Where to land: one goal, or several in their order.

use key_table::{Invalid, Key, Setting, Table, Value, settings};
use serde::{Deserialize, Serialize};

use crate::frame::wrap_angle;

settings! {
    /// A place to land at.
    #[derive(Copy)]
    pub struct Goal {
        /// Position along the track [m].
        pub x_m: f64 = 10.0, (-1e4..=1e4, "within `track.x_m`");
        /// Lateral position, which is also the line that the robot follows [m].
        pub y_m: f64 = 0.0, (-1e3..=1e3, "within `track.y_m`");
        /// The goal is reached when the robot's centre lands within this distance of it [m].
        pub tolerance_m: f64 = 0.1, 0.01..=1.0;
        /// Direction of the robot there; without the key any. A `[course]` without waypoints leads to it in this direction; on
        /// any other way it must be that of the way [rad].
        pub yaw_rad: Option<f64> = None, (-7.0..=7.0, "the direction of the way there, by `yaw_tolerance_rad`");
        /// With `yaw_rad`: largest difference of the directions with which the goal is reached [rad].
        pub yaw_tolerance_rad: f64 = 0.1, 0.005..=3.2;
        /// How long the robot stands there before it drives to the next goal [s].
        pub stay_s: f64 = 1.0, 0.5..=3600.0;
    }
}

impl Goal {
    /// How far a pose of the robot is away [m].
    pub fn distance_m(&self, x_m: f64, y_m: f64) -> f64 {
        (x_m - self.x_m).hypot(y_m - self.y_m)
    }

    /// How far the robot's direction is from that of the goal, -pi to pi; `None` where any direction is right [rad].
    pub fn yaw_error_rad(&self, yaw_rad: f64) -> Option<f64> {
        self.yaw_rad.map(|wanted| wrap_angle(yaw_rad - wanted))
    }

    /// Whether a robot that stands at this distance with this error of its direction has reached it. NaN has not.
    pub fn is_reached(&self, distance_m: f64, yaw_error_rad: Option<f64>) -> bool {
        distance_m <= self.tolerance_m
            && yaw_error_rad.is_none_or(|error| error.abs() <= self.yaw_tolerance_rad)
    }
}

/// The goals of a drive, at least one: the table `[goal]`, or tables `[[goal]]` in the order in which they are reached.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(into = "Value")]
pub struct Goals {
    goals: Vec<Goal>,
    /// Whether a file has them as `[[goal]]`.
    is_list: bool,
}

impl Goals {
    /// All of them in their order.
    pub fn all(&self) -> &[Goal] {
        &self.goals
    }

    /// The same, to be changed.
    pub fn all_mut(&mut self) -> &mut [Goal] {
        &mut self.goals
    }

    /// The one at which the drive ends.
    pub fn last(&self) -> Goal {
        self.goals.last().copied().unwrap_or_default()
    }

    /// Those from one on, at least the last.
    pub fn left(&self, index: usize) -> Self {
        let index = index.min(self.goals.len() - 1);
        Self { goals: self.goals[index..].to_vec(), ..self.clone() }
    }

    /// Whether a file has them as `[[goal]]`.
    pub fn is_list(&self) -> bool {
        self.is_list
    }

    /// Its key in messages.
    pub fn key(&self, index: usize) -> String {
        if self.is_list { format!("goal[{index}]") } else { "goal".to_owned() }
    }
}

impl Default for Goals {
    fn default() -> Self {
        Goal::default().into()
    }
}

impl From<Goal> for Goals {
    fn from(goal: Goal) -> Self {
        Self { goals: vec![goal], is_list: false }
    }
}

impl From<Goals> for Value {
    fn from(goals: Goals) -> Self {
        // Numbers can always be written.
        let written = |goal: &Goal| Self::try_from(goal).unwrap_or(Self::Boolean(false));
        match goals.goals.as_slice() {
            [goal] if !goals.is_list => written(goal),
            all => Self::Array(all.iter().map(written).collect()),
        }
    }
}

impl<'de> Deserialize<'de> for Goals {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        Self::from_value("goal", value).map_err(serde::de::Error::custom)
    }
}

impl Setting for Goals {
    fn from_value(path: &str, value: Value) -> Result<Self, Invalid> {
        if !value.is_array() {
            return Goal::from_value(path, value).map(Self::from);
        }
        let goals = Vec::from_value(path, value)?;
        if goals.is_empty() {
            return Err(Invalid::new(path, "[]", "at least one"));
        }
        Ok(Self { goals, is_list: true })
    }

    fn require_all(&self, _: &str) -> Result<(), Invalid> {
        let mut all = self.goals.iter().enumerate();
        all.try_for_each(|(index, goal)| goal.require_all(&self.key(index)))
    }

    fn schema() -> Table {
        Vec::<Goal>::schema()
    }

    fn keys() -> Vec<Key> {
        Goal::keys()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Goals, Invalid> {
        let mut table = key_table::parse(text).unwrap();
        Goals::from_value("goal", table.remove("goal").unwrap())
    }

    #[test]
    fn one_table_and_several_are_read_and_written_as_they_were() {
        for text in
            ["[goal]\nx_m = 3.0\n", "[[goal]]\nx_m = 3.0\n", "[[goal]]\nx_m = 3.0\n[[goal]]\nyaw_rad = 1.5\n"]
        {
            let goals = read(text).unwrap();
            let written = Table::from_iter([("goal".to_owned(), Value::from(goals.clone()))]);
            assert_eq!(written["goal"].is_array(), text.contains("[["), "{text}");
            assert_eq!(read(&written.to_string()).unwrap(), goals, "{text}");
        }
        assert_eq!(read("[[goal]]\n[[goal]]\nx_m = 4.0").unwrap().last().x_m, 4.0);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place_in_the_list() {
        assert_eq!(read("goal = []").unwrap_err().to_string(), "goal = [] is not allowed: at least one");
        let unknown = read("[[goal]]\n[[goal]]\nz_m = 1.0").unwrap_err().to_string();
        assert!(unknown.starts_with("goal[1].z_m = 1.0 is not allowed"), "{unknown}");
        let large = read("[[goal]]\n[[goal]]\ntolerance_m = 9.0").unwrap().require_all("goal").unwrap_err();
        assert_eq!(large.key, "goal[1].tolerance_m");
        assert_eq!(
            read("[goal]\ntolerance_m = 9.0").unwrap().require_all("goal").unwrap_err().key,
            "goal.tolerance_m"
        );
    }

    #[test]
    fn a_goal_with_a_direction_is_reached_in_it_only() {
        let goal = Goal { yaw_rad: Some(3.1), ..Goal::default() };
        // Across the jump from pi to -pi the difference is 0.08 rad.
        let error = goal.yaw_error_rad(-3.1);
        assert!((error.unwrap() - (std::f64::consts::TAU - 6.2)).abs() < 1e-12);
        assert!(goal.is_reached(0.1, error) && !goal.is_reached(0.101, error));
        assert!(!goal.is_reached(0.0, goal.yaw_error_rad(0.0)) && !goal.is_reached(0.0, Some(f64::NAN)));
        assert_eq!(Goal::default().yaw_error_rad(2.0), None);
        assert!(Goal::default().is_reached(0.0, None) && !Goal::default().is_reached(f64::NAN, None));
    }
}
