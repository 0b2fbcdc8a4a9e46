//! The settings files of a system: one per role, with what its process may know and nothing else.
//!
//! A robot with a driver has the tables of the driver and `vehicle` in addition. Obstacles and hidden faults of the robot stand in the robot's file only: the stages never read the truth.

use emulator::Scenario;
use pipeline::Tuning;
use runtime::{Domain, Realtime, RunSettings, settings_file, settings_table};
use shared_types::Role;
use toml::{Table, Value};

/// Implementations of role robot that drive a robot which is no part of the system, each with a table of its name.
pub const DRIVERS: [&str; 2] = ["player", "ros2"];

/// The table of a driver, complete.
#[derive(Debug, Clone, PartialEq)]
pub struct DriverTable {
    /// Its name, that of the implementation.
    pub name: &'static str,
    /// Its keys.
    pub table: Value,
}

/// Writes the settings file of each role; every key that a role has stands in it with the value that holds.
///
/// # Errors
/// Settings that are not allowed, and errors of the file system.
pub fn write(
    domain: &Domain,
    run: &RunSettings,
    realtime: &Realtime,
    scenario: &Scenario,
    tuning: &Tuning,
    driver: Option<&DriverTable>,
) -> anyhow::Result<()> {
    for role in Role::ALL.iter().copied() {
        let mut table = of(role, run, realtime, scenario, tuning)?;
        if let (Role::Robot, Some(driver)) = (role, driver) {
            table.insert(driver.name.to_owned(), driver.table.clone());
            table.insert("vehicle".to_owned(), Value::try_from(tuning.vehicle)?);
        }
        domain.folder().write(&settings_file(role), toml::to_string(&table)?.as_bytes())?;
    }
    Ok(())
}

/// The settings file of a role as a table.
///
/// # Errors
/// Settings that are not allowed.
pub fn of(
    role: Role,
    run: &RunSettings,
    realtime: &Realtime,
    scenario: &Scenario,
    tuning: &Tuning,
) -> anyhow::Result<Table> {
    let own = match role {
        Role::Robot => Value::Table(scenario.to_table()),
        Role::Estimator => Value::try_from(tuning.estimator.complete()?)?,
        Role::Obstacles => Value::try_from(&tuning.obstacles)?,
        Role::Controller => Value::try_from(&tuning.controller)?,
        Role::Actuator => Value::try_from(&tuning.actuator)?,
    };
    let mut table = Table::new();
    table.insert("run".to_owned(), Value::try_from(run)?);
    table.insert("realtime".to_owned(), Value::try_from(realtime)?);
    table.insert(settings_table(role).to_owned(), own);
    Ok(table)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use runtime::ClockKind;
    use vehicle::{Key, Setting};

    use super::*;
    use crate::System;

    fn files(tuning: &Tuning) -> Vec<(Role, Table)> {
        let run = RunSettings {
            period_ns: 1,
            clock: ClockKind::Simulated,
            orphan_stop_ns: 1,
            orphan_timeout_ns: 1,
        };
        let scenario = Scenario::parse(Scenario::shipped("corridor").unwrap(), "corridor").unwrap();
        let of = |role: &Role| (*role, of(*role, &run, &Realtime::default(), &scenario, tuning).unwrap());
        Role::ALL.iter().map(of).collect()
    }

    /// Dotted keys of a table without those of the tables in it.
    fn keys(table: &Table, around: &str, found: &mut BTreeSet<String>) {
        for (key, value) in table {
            match value {
                Value::Table(inner) => keys(inner, &format!("{around}{key}."), found),
                _ => _ = found.insert(format!("{around}{key}")),
            }
        }
    }

    /// The same of keys as the documentation has them.
    fn documented(keys: &[Key], around: &str, found: &mut BTreeSet<String>) {
        for key in keys {
            match key.keys.as_slice() {
                // A list of tables is empty here.
                _ if key.is_list_of_tables() => _ = found.insert(format!("{around}{}", key.name)),
                [] => _ = found.insert(format!("{around}{}", key.name)),
                inner => documented(inner, &format!("{around}{}.", key.name), found),
            }
        }
    }

    #[test]
    fn the_files_hold_every_documented_key_and_no_other() {
        let of_system = System::keys();
        for (role, file) in files(&Tuning::default()).into_iter().filter(|(role, _)| *role != Role::Robot) {
            let (mut written, mut named) = (BTreeSet::new(), BTreeSet::new());
            keys(file[role.name()].as_table().unwrap(), "", &mut written);
            let table = of_system.iter().find(|key| key.name == role.name()).unwrap();
            documented(&table.keys, "", &mut named);
            assert!(named.len() >= 5);
            // Keys that have no value without a scenario that gives them.
            named.retain(|key| {
                !["map", "course.path", "course.turn_radius_m", "goal.yaw_rad", "vehicle.scanner.first_rad"]
                    .contains(&key.as_str())
            });
            assert_eq!(written, named, "{role}");
        }
    }

    #[test]
    fn what_comes_from_the_profile_stands_in_the_file() {
        let mut tuning = Tuning::default();
        for (profile, rate) in
            [(estimator::NoiseProfile::Scaled, 0.0), (estimator::NoiseProfile::Source, 0.053)]
        {
            tuning.estimator.profile = profile;
            let (_, file) = files(&tuning).into_iter().find(|(role, _)| *role == Role::Estimator).unwrap();
            assert_eq!(file["estimator"]["odometry_longitudinal"].as_float(), Some(0.01));
            assert_eq!(file["estimator"]["odometry_lateral_rate"].as_float(), Some(rate));
            let read: estimator::EstimatorConfig = file["estimator"].clone().try_into().unwrap();
            assert_eq!(read.settings().unwrap(), tuning.estimator.settings().unwrap());
        }
    }

    #[test]
    fn only_the_robot_reads_the_scenario() {
        for (role, file) in files(&Tuning::default()) {
            let text = toml::to_string(&file).unwrap();
            assert_eq!(text.contains("[[scenario.obstacle]]"), role == Role::Robot, "{role}: {text}");
            assert_eq!(text.contains("odometry_jump_rad"), role == Role::Robot, "{role}: {text}");
            assert_eq!(file.len(), 3, "{role}: {text}");
        }
    }
}
