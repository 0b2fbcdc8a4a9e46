//! Courses of another size, for vehicles of another size.

use std::ops::RangeInclusive;

use toml::{Table, Value};

use super::{Scenario, ScenarioError};

/// Tables whose lengths are those of the robot and its devices.
const OF_THE_ROBOT: [&str; 3] = ["robot", "noise", "scanner"];
/// Factors by which a course may be larger.
const FACTORS: RangeInclusive<f64> = 0.1..=10.0;
/// How the keys of lengths end, and the key of the time that a robot has.
const LENGTH: &str = "_m";
const TIME: &str = "timeout_s";

impl Scenario {
    /// The same course with all lengths, speeds left alone, larger by a factor; there is as much more time.
    ///
    /// # Errors
    /// A factor that is not 0.1 to 10, and a length that is too large or too small then.
    pub fn scaled(&self, factor: f64) -> Result<Self, ScenarioError> {
        if !FACTORS.contains(&factor) {
            let message = format!("not allowed: {} to {}", FACTORS.start(), FACTORS.end());
            return Err(ScenarioError { file: self.name.clone(), message });
        }
        let mut table = self.to_table();
        scale_lengths(&mut table, factor);
        Self::from_table(table, &self.name)
    }
}

/// The same for tables of a scenario.
pub fn scale_lengths(tables: &mut Table, factor: f64) {
    for (key, value) in tables.iter_mut().filter(|(key, _)| !OF_THE_ROBOT.contains(&key.as_str())) {
        scale(key, value, factor);
    }
}

fn scale(key: &str, value: &mut Value, factor: f64) {
    match value {
        Value::Float(number) if key.ends_with(LENGTH) || key == TIME => *number *= factor,
        Value::Integer(number) if key.ends_with(LENGTH) || key == TIME => {
            *value = Value::Float(*number as f64 * factor);
        }
        Value::Array(values) => values.iter_mut().for_each(|value| scale(key, value, factor)),
        Value::Table(table) => table.iter_mut().for_each(|(key, value)| scale(key, value, factor)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Shape;

    #[test]
    fn lengths_grow_and_the_robot_stays_as_it_is() {
        let walls = Scenario::parse(Scenario::shipped("walls").unwrap(), "walls").unwrap();
        let large = walls.scaled(3.0).unwrap();
        assert_eq!((large.robot, large.noise), (walls.robot, walls.noise));
        assert_eq!(large.timeout_s, 3.0 * walls.timeout_s);
        assert_eq!(large.track.y_m, walls.track.y_m.map(|y_m| 3.0 * y_m));
        assert_eq!(large.goal.last().x_m, 3.0 * walls.goal.last().x_m);
        for (large, small) in large.obstacles.iter().zip(&walls.obstacles) {
            assert_eq!([large.x_m, large.y_m], [small.x_m, small.y_m].map(|at_m| 3.0 * at_m));
            let size = |shape: &Shape| match *shape {
                Shape::Box { length_m, width_m, .. } => [length_m, width_m],
                Shape::Circle { radius_m } => [radius_m; 2],
            };
            assert_eq!(size(&large.shape), size(&small.shape).map(|size_m| 3.0 * size_m));
        }
        let curve = Scenario::parse(Scenario::shipped("s-curve").unwrap(), "s-curve").unwrap();
        let length_m = |scenario: &Scenario| scenario.course.as_ref().unwrap().length_m();
        assert!((length_m(&curve.scaled(2.0).unwrap()) / length_m(&curve) - 2.0).abs() < 1e-9);
        for factor in [f64::NAN, 0.0, -1.0, 1e9] {
            let error = walls.scaled(factor).unwrap_err();
            assert_eq!(error.to_string(), "walls: not allowed: 0.1 to 10");
        }
    }
}
