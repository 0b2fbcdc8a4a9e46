//! Defaults of a system whose robot has a driver, `player` or `ros2`.
//!
//! The default calibration undoes the imperfections of the emulated robot. Such a robot is corrected by what drives
//! it, or has nothing to correct, as a simulator. So the calibration is `identity` and the odometry is taken as it is, unless the system file or a
//! calibration file has these keys.

use shared_types::Role;
use toml::{Table, Value};

use crate::settings::DRIVERS;

/// Stage, key, and its value for such a robot.
fn defaults() -> [(&'static str, &'static str, Value); 2] {
    [
        ("actuator", "calibration", Value::String("identity".to_owned())),
        ("estimator", "odometry_longitudinal", Value::Float(0.0)),
    ]
}

/// Adds the defaults to the table of a system file.
pub(crate) fn add_defaults(system: &mut Table) {
    let is_driven = |process: &Value| {
        let has = |key: &str, value: &str| process.get(key).and_then(Value::as_str) == Some(value);
        has("role", Role::Robot.name()) && DRIVERS.iter().any(|name| has("implementation", name))
    };
    let processes = system.get("process").and_then(Value::as_array);
    if !processes.is_some_and(|processes| processes.iter().any(is_driven)) {
        return;
    }
    for (stage, key, value) in defaults() {
        let entry = system.entry(stage.to_owned()).or_insert_with(|| Value::Table(Table::new()));
        // The reader of the whole file refuses what is no table.
        if let Value::Table(table) = entry {
            table.entry(key.to_owned()).or_insert(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn system(robot: &str, more: &str) -> Table {
        let mut table: Table =
            format!("{more}\n[[process]]\nrole = \"robot\"\nimplementation = \"{robot}\"").parse().unwrap();
        add_defaults(&mut table);
        table
    }

    #[test]
    fn a_robot_with_a_driver_is_not_corrected_unless_the_file_says_so() {
        let plain = system("player", "");
        assert_eq!(plain["actuator"]["calibration"].as_str(), Some("identity"));
        assert_eq!(plain["estimator"]["odometry_longitudinal"].as_float(), Some(0.0));
        assert_eq!(system("ros2", "")["actuator"]["calibration"].as_str(), Some("identity"));
        let set =
            system("player", "[actuator]\ncalibration = \"default\"\n[estimator]\nprofile = \"scaled\"");
        assert_eq!(set["actuator"]["calibration"].as_str(), Some("default"));
        assert_eq!(set["estimator"]["odometry_longitudinal"].as_float(), Some(0.0));
        assert_eq!(system("emulator", "").len(), 1);
    }
}
