//! Settings that change while the system drives: keys of one role, checked like those of a file.
//!
//! The settings file of the role holds all keys with the values that hold, so the change starts from there.

use anyhow::Context;
use console::exit::Failure;
use emulator::Scenario;
use runtime::{Domain, RuntimeError, own_settings_file, settings_file, settings_table};
use serde::Serialize;
use shared_types::{Role, did_you_mean};
use toml::{Table, Value};
use vehicle::{Goal, Invalid, Setting, read};

use crate::overrides::{parse_override, set};
use crate::rate::{require_few_on_robots_way, require_few_on_the_way, require_rate};
use crate::settings::DRIVERS;
use crate::{System, is_of_scenario};

/// Tables of the scenario that only the emulated robot reads and that are no part of the course.
const OF_THE_ROBOT: [&str; 3] = ["robot", "noise", "scanner"];
/// Tables with keys that may change.
const TABLES: [&str; 9] =
    ["estimator", "obstacles", "controller", "actuator", "robot", "noise", "scanner", "player", "ros2"];
/// Keys of a role that have their value from elsewhere when a run starts, and from where.
const DERIVED: [(&str, &str); 12] = [
    ("controller.goal", "the scenario sets it"),
    ("controller.track", "the scenario sets it"),
    ("controller.course", "the scenario sets it"),
    ("obstacles.course", "the scenario sets it"),
    ("obstacles.walls", "the scenario sets it"),
    ("obstacles.wall_y_m", "the scenario sets it"),
    ("obstacles.track_x_m", "the scenario sets it"),
    ("controller.period_s", "it follows from rate_hz"),
    ("controller.profile", "it gives defaults to other keys at the start of a run: set those"),
    ("estimator.profile", "it gives defaults to other keys at the start of a run: set those"),
    ("estimator.map", "its file is read at the start of a run"),
    ("robot.preset", "it gives defaults to other keys at the start of a run: set those"),
];

/// The role that all of these `KEY=VALUE` belong to.
///
/// # Errors
/// A key that does not belong to exactly one role, or keys of several roles; exit code 2.
pub fn role_of(overrides: &[String]) -> anyhow::Result<Role> {
    let mut found: Option<(Role, String)> = None;
    for text in overrides {
        let (key, _) = parse_override(text)?;
        let role = role_of_key(&key)?;
        match &found {
            Some((other, before)) if *other != role => {
                return Err(Failure::bad_input(format!(
                    "{before} belongs to role {other}, {key} to role {role}: set keys of one role at a time"
                )));
            }
            _ => found = Some((role, key)),
        }
    }
    found.map(|(role, _)| role).ok_or_else(|| Failure::bad_input("expected KEY=VALUE"))
}

fn role_of_key(key: &str) -> anyhow::Result<Role> {
    let refused =
        |reason: &str| Failure::bad_input(format!("{key} can't be set while the system runs: {reason}"));
    let is_derived = |of: &str| key == of || key.strip_prefix(of).is_some_and(|rest| rest.starts_with('.'));
    if let Some((_, reason)) = DERIVED.iter().find(|(of, _)| is_derived(of)) {
        return Err(refused(reason));
    }
    let (first, rest) = key.split_once('.').unwrap_or((key, ""));
    if OF_THE_ROBOT.contains(&first) || DRIVERS.contains(&first) {
        return Ok(Role::Robot);
    }
    match first.parse() {
        Ok(role) if !rest.is_empty() => Ok(role),
        Ok(_) => Err(refused("it is a table; name one of its keys")),
        Err(_) if first == "vehicle" => {
            Err(refused(&format!("all stages read it; ROLE.{key} sets it for one of them")))
        }
        Err(_) if is_of_scenario(first) => Err(refused("it is a part of the course")),
        Err(_) if System::keys().iter().any(|of| of.name == first) => {
            Err(refused("all processes depend on it"))
        }
        Err(_) => {
            let meant = did_you_mean(first, TABLES);
            Err(Failure::bad_input(format!(
                "{key} is unknown: expected a key of estimator, obstacles, controller, actuator, robot, noise, scanner, \
                 player or ros2; `scanloop reference` lists them.{meant}"
            )))
        }
    }
}

/// The settings file of a role with other values; `file` is the content of the present one.
///
/// # Errors
/// A key of another role, and a value that is not allowed, with what is; exit code 2.
pub fn settings(role: Role, file: &str, overrides: &[String]) -> anyhow::Result<String> {
    let mut file: Table = file.parse()?;
    for text in overrides {
        let (key, value) = parse_override(text)?;
        if role_of_key(&key)? != role {
            return Err(Failure::bad_input(format!("{key} does not belong to role {role}")));
        }
        let driver = driver_of_key(&key);
        match (role, driver.is_some()) {
            (Role::Robot, false) => match file.get_mut(settings_table(role)) {
                Some(Value::Table(scenario)) => set(scenario, &key, value)?,
                _ => anyhow::bail!("the settings of the robot have no scenario"),
            },
            (Role::Robot, true) if driver.is_some_and(|name| !file.contains_key(name)) => {
                let name = driver.unwrap_or_default();
                return Err(Failure::bad_input(format!("{key}: this system has no robot `{name}`")));
            }
            _ => set(&mut file, &key, value)?,
        }
    }
    let rate_hz = file.get("run").and_then(|run| run.get("period_ns")).and_then(Value::as_integer);
    let rate_hz = rate_hz.map_or(0.0, |period_ns| 1e9 / period_ns as f64);
    let own = checked(role, &file, rate_hz)?;
    file.insert(settings_table(role).to_owned(), own);
    Ok(toml::to_string(&file)?)
}

/// The settings file of the controller with another goal, along and across the course.
///
/// # Errors
/// A file without goals.
pub fn with_goal(file: &str, index: usize, goal: &Goal) -> anyhow::Result<String> {
    let mut file: Table = file.parse()?;
    let own = file.get_mut(settings_table(Role::Controller)).and_then(Value::as_table_mut);
    let place = own.and_then(|own| match index.checked_sub(1) {
        None => own.get_mut("goal"),
        Some(index) => own.get_mut("next_goals")?.get_mut(index),
    });
    *place.context("the settings of the controller have no such goal")? = Value::try_from(goal)?;
    Ok(toml::to_string(&file)?)
}

/// By how much each key changes from the one settings file of a role to the other: the difference of its numbers without a
/// sign, the largest of several, 0 without numbers.
///
/// # Errors
/// A text that is no `KEY=VALUE`, and files that are not TOML.
pub fn amounts(role: Role, files: [&str; 2], overrides: &[String]) -> anyhow::Result<Vec<(String, f64)>> {
    let [old, new] = [files[0].parse::<Table>()?, files[1].parse::<Table>()?];
    let mut found = Vec::new();
    for text in overrides {
        let (key, _) = parse_override(text)?;
        let is_of_scenario = role == Role::Robot && driver_of_key(&key).is_none();
        let path = if is_of_scenario { format!("{}.{key}", settings_table(role)) } else { key.clone() };
        let [old, new] = [&old, &new].map(|table| numbers(value_at(table, &path)));
        let by = old.iter().zip(&new).map(|(old, new)| (old - new).abs()).fold(0.0, f64::max);
        found.push((key, by));
    }
    Ok(found)
}

/// The driver that a key belongs to.
fn driver_of_key(key: &str) -> Option<&str> {
    key.split_once('.').map(|(table, _)| table).filter(|table| DRIVERS.contains(table))
}

fn value_at<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    let mut parts = path.split('.');
    let first = table.get(parts.next()?)?;
    parts.try_fold(first, |value, part| value.get(part))
}

/// The number, or the numbers of a list.
fn numbers(value: Option<&Value>) -> Vec<f64> {
    match value {
        Some(Value::Float(number)) => vec![*number],
        Some(Value::Integer(number)) => vec![*number as f64],
        Some(Value::Array(items)) => items.iter().flat_map(|item| numbers(Some(item))).collect(),
        _ => Vec::new(),
    }
}

/// The table of the role alone, with the rules of all its keys checked.
fn checked(role: Role, file: &Table, rate_hz: f64) -> anyhow::Result<Value> {
    let own = file.get(settings_table(role)).and_then(Value::as_table).cloned().unwrap_or_default();
    match role {
        Role::Robot => {
            if let Some(Value::Table(table)) = file.get("player") {
                reread("player", table.clone(), player::PlayerConfig::validate)?;
            }
            if let Some(Value::Table(table)) = file.get("ros2") {
                reread("ros2", table.clone(), driver::ros2::Ros2Config::validate)?;
            }
            let scenario = Scenario::from_table(own, "settings of the robot").map_err(Failure::bad_input)?;
            if !DRIVERS.iter().any(|driver| file.contains_key(*driver)) {
                require_few_on_robots_way(&scenario, rate_hz).map_err(Failure::bad_input)?;
            }
            Ok(Value::try_from(scenario)?)
        }
        Role::Estimator => {
            let value = reread(role.name(), own, estimator::EstimatorConfig::validate)?;
            let config: estimator::EstimatorConfig = value.clone().try_into()?;
            require_few_on_the_way("estimator.vehicle", config.vehicle.command_delay_s, 0.0, rate_hz)
                .map_err(Failure::bad_input)?;
            Ok(value)
        }
        Role::Obstacles => reread(role.name(), own, obstacles::ObstaclesConfig::validate),
        Role::Controller => {
            let value = reread(role.name(), own, nmpc::ControllerConfig::validate)?;
            require_rate(&value.clone().try_into()?, rate_hz).map_err(Failure::bad_input)?;
            Ok(value)
        }
        Role::Actuator => reread(role.name(), own, actuation::ActuatorConfig::validate),
    }
}

/// The table as its struct writes it, checked.
fn reread<T: Setting + Serialize>(
    name: &str,
    table: Table,
    validate: impl Fn(&T) -> Result<(), Invalid>,
) -> anyhow::Result<Value> {
    let refuse = |invalid: Invalid| Failure::bad_input(invalid.within(name));
    let config: T = read(table).map_err(refuse)?;
    validate(&config).map_err(refuse)?;
    Ok(Value::try_from(config)?)
}

/// Makes the settings of an incarnation those of its role, if it has its own: what starts after it has them, too.
///
/// # Errors
/// [`RuntimeError::File`].
pub fn keep(domain: &Domain, role: Role, incarnation: u32) -> Result<(), RuntimeError> {
    let (folder, own) = (domain.folder(), own_settings_file(incarnation));
    if folder.contains(&own) {
        // A copy would need room on the disk.
        folder.rename(&own, &settings_file(role))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use pipeline::Tuning;
    use runtime::{ClockKind, Realtime, RunSettings};

    use super::*;
    use crate::settings::of;

    fn file(role: Role) -> String {
        let run = RunSettings {
            period_ns: 100_000_000,
            clock: ClockKind::Monotonic,
            orphan_stop_ns: 1,
            orphan_timeout_ns: 1,
        };
        let scenario = Scenario::parse(Scenario::shipped("corridor").unwrap(), "corridor").unwrap();
        let tuning = Tuning::default().for_scenario(&scenario);
        toml::to_string(&of(role, &run, &Realtime::default(), &scenario, &tuning).unwrap()).unwrap()
    }

    fn texts(overrides: &[&str]) -> Vec<String> {
        overrides.iter().map(ToString::to_string).collect()
    }

    fn changed(role: Role, overrides: &[&str]) -> anyhow::Result<Table> {
        Ok(settings(role, &file(role), &texts(overrides))?.parse()?)
    }

    #[test]
    fn a_change_differs_from_the_present_file_in_its_keys_only() {
        for (role, text, path) in [
            (Role::Controller, "controller.intervals=7", ["controller", "intervals"]),
            (Role::Estimator, "estimator.recover_after=7", ["estimator", "recover_after"]),
            (Role::Actuator, "actuator.recovery=3", ["actuator", "recovery"]),
        ] {
            let before: Table = file(role).parse().unwrap();
            let Ok(mut after) = changed(role, &[text]) else {
                panic!("{text}: {:?}", changed(role, &[text]))
            };
            assert_ne!(before, after, "{text}");
            let old = before[path[0]].get(path[1]).cloned();
            let Some(Value::Table(table)) = after.get_mut(path[0]) else { panic!("{text}") };
            let new = table.remove(path[1]);
            assert_ne!(new, old, "{text}");
            old.into_iter().for_each(|old| _ = table.insert(path[1].to_owned(), old));
            assert_eq!(before, after, "{text}");
        }
    }

    #[test]
    fn the_amount_of_a_change_is_the_difference_of_its_numbers() {
        let amounts = |role, overrides: &[&str]| {
            let (old, overrides) = (file(role), texts(overrides));
            let new = settings(role, &old, &overrides).unwrap();
            super::amounts(role, [&old, &new], &overrides).unwrap()
        };
        let cruise = amounts(Role::Controller, &["controller.cruise_mps=0.75", "controller.side=left"]);
        assert_eq!(cruise, [("controller.cruise_mps".to_owned(), 0.25), ("controller.side".to_owned(), 0.0)]);
        let noise = amounts(Role::Robot, &["noise.odometry_m=0.5"]);
        assert_eq!(noise, [("noise.odometry_m".to_owned(), 0.5)]);
        let control = amounts(Role::Controller, &["controller.weights.control=[0.1, 12]"]);
        assert_eq!(control[0].1, 2.0);
    }

    #[test]
    fn the_robot_is_changed_within_its_scenario() {
        let after = changed(Role::Robot, &["robot.velocity_factor=1.3", "noise.range_m=0.02"]).unwrap();
        assert_eq!(after["scenario"]["robot"]["velocity_factor"].as_float(), Some(1.3));
        assert_eq!(after["scenario"]["noise"]["range_m"].as_float(), Some(0.02));
        assert!(after["scenario"]["obstacle"].is_array());
    }

    #[test]
    fn keys_of_one_role_are_accepted_and_others_refused_with_the_reason() {
        let role = |overrides: &[&str]| role_of(&texts(overrides)).map_err(|error| error.to_string());
        assert_eq!(role(&["controller.intervals=7", "controller.horizon_s=2"]), Ok(Role::Controller));
        assert_eq!(role(&["robot.velocity_factor=1.3", "scanner.dropout=0.1"]), Ok(Role::Robot));
        let refused = |overrides: &[&str], reason: &str| {
            let error = role(overrides).unwrap_err();
            assert!(error.contains(reason), "{error}");
        };
        refused(&["controller.intervals=7", "estimator.gate=true"], "keys of one role at a time");
        refused(&["vehicle.width_m=0.5"], "ROLE.vehicle.width_m sets it for one of them");
        refused(&["rate_hz=20"], "all processes depend on it");
        refused(&["process.controller.grace_ms=5"], "all processes depend on it");
        refused(&["goal.x_m=3"], "a part of the course");
        refused(&["controller.goal.x_m=3"], "the scenario sets it");
        refused(&["controller.period_s=0.2"], "it follows from rate_hz");
        refused(&["controller=7"], "name one of its keys");
        refused(&["pilot.intervals=7"], "is unknown: expected a key of estimator");
        refused(&["controller.intervals"], "expected KEY=VALUE");
    }

    #[test]
    fn no_more_commands_may_be_on_their_way_than_a_file_may_have() {
        // At 200 Hz, of which 64 scans are 0.32 s.
        let at_200_hz = |role, text: &str| {
            let mut old: Table = file(role).parse().unwrap();
            set(&mut old, "run.period_ns", Value::Integer(5_000_000)).unwrap();
            settings(role, &old.to_string(), &texts(&[text])).map_err(|error| error.to_string())
        };
        for (role, text) in [
            (Role::Robot, "robot.command_delay_s=0.33"),
            (Role::Robot, "robot.command_jitter_s=0.1"),
            (Role::Estimator, "estimator.vehicle.command_delay_s=0.33"),
        ] {
            let refused = at_200_hz(role, text).unwrap_err();
            let key = text.split('=').next().unwrap();
            assert!(refused.starts_with(&format!("{key} = 0.")) && refused.contains("64 scans"), "{refused}");
        }
        for (role, text) in [
            (Role::Robot, "robot.command_delay_s=0.2"),
            (Role::Robot, "robot.command_jitter_s=0.05"),
            (Role::Estimator, "estimator.vehicle.command_delay_s=0.31"),
        ] {
            at_200_hz(role, text).unwrap();
        }
    }

    #[test]
    fn values_that_are_not_allowed_are_named_with_what_is() {
        let error = |overrides: &[&str]| changed(Role::Controller, overrides).unwrap_err().to_string();
        let range = error(&["controller.intervals=0"]);
        assert!(range.starts_with("controller.intervals = 0 is not allowed: "), "{range}");
        let unknown = error(&["controller.interval=7"]);
        assert!(
            unknown.starts_with("controller.interval = 7 is not allowed: the key is unknown"),
            "{unknown}"
        );
        assert!(error(&["estimator.gate=true"]).contains("does not belong to role controller"));
        let player = changed(Role::Robot, &["player.port=1"]).unwrap_err().to_string();
        assert!(player.contains("no robot `player`"), "{player}");
    }
}
