//! The recorded settings of the stages, and changes of their keys.

use std::collections::BTreeMap;

use console::exit::Failure;
use runtime::settings_table;
use serde::de::DeserializeOwned;
use shared_types::{Role, did_you_mean};
use toml::{Table, Value};

/// The settings of all processes of a drive.
#[derive(Debug, Clone, Default)]
pub(crate) struct DriveSettings {
    pub(super) roles: BTreeMap<Role, Table>,
    /// Of processes that had others than those of their role at the start.
    pub(super) processes: BTreeMap<u32, (Role, Table)>,
}

impl DriveSettings {
    /// Sets one key, in the settings of all processes of its role.
    ///
    /// # Errors
    /// What is wrong with a text that is no `ROLE.KEY=VALUE`.
    pub(crate) fn set(&mut self, text: &str) -> Result<(), String> {
        let (targets, value) = parse(text)?;
        for (role, key) in &targets {
            let of_processes =
                self.processes.values_mut().filter(|(of, _)| of == role).map(|(_, table)| table);
            for table in self.roles.get_mut(role).into_iter().chain(of_processes) {
                set_key(table, key, value.clone()).map_err(|reason| format!("{text}: {reason}"))?;
            }
        }
        Ok(())
    }

    /// Whether a role has other settings than in `other`.
    pub(crate) fn differ(&self, other: &Self, role: Role) -> bool {
        self.roles.get(&role) != other.roles.get(&role)
    }

    /// Adds an obstacle to the scenario of the robot: its keys as in the scenario file.
    ///
    /// # Errors
    /// What is wrong with a text that is no list of `KEY=VALUE`.
    pub(crate) fn add_obstacle(&mut self, text: &str) -> Result<(), String> {
        let keys = text.split(',').map(|pair| match pair.split_once('=') {
            Some((key, value)) => Ok((key.trim().to_owned(), parsed(value.trim()))),
            None => Err(format!(
                "{text}: expected keys of [[obstacle]], like shape=circle,x_m=5,y_m=0,radius_m=0.2"
            )),
        });
        let obstacle = keys.collect::<Result<Table, String>>()?;
        let scenario = self.roles.get_mut(&Role::Robot).and_then(|table| table.get_mut("scenario"));
        let scenario = scenario.and_then(Value::as_table_mut).ok_or("the robot has no scenario")?;
        let all = scenario.entry("obstacle").or_insert_with(|| Value::Array(Vec::new()));
        all.as_array_mut().ok_or("obstacle is no list")?.push(Value::Table(obstacle));
        Ok(())
    }

    /// One table of the settings of a role.
    pub(crate) fn table<T: DeserializeOwned>(&self, role: Role, name: &str) -> anyhow::Result<T> {
        table_in(self.roles.get(&role), role, name)
    }

    /// The settings of the stage of a process.
    pub(crate) fn of_process<T: DeserializeOwned>(&self, incarnation: u32, role: Role) -> anyhow::Result<T> {
        let own = self.processes.get(&incarnation).filter(|(of, _)| *of == role).map(|(_, table)| table);
        table_in(own.or(self.roles.get(&role)), role, settings_table(role))
    }
}

fn table_in<T: DeserializeOwned>(table: Option<&Table>, role: Role, name: &str) -> anyhow::Result<T> {
    let value = table.and_then(|table| table.get(name)).cloned();
    let refuse = |reason: &dyn std::fmt::Display| {
        Failure::bad_input(format!("the settings of role {role} in the recording: {reason}"))
    };
    let mut value = value.ok_or_else(|| refuse(&format!("table {name} is missing")))?;
    // Drives from before this key kept the whole way.
    if let Some(margin) = value.get_mut("margin").and_then(Value::as_table_mut) {
        margin.entry("latency_share").or_insert(Value::Float(1.0));
    }
    T::deserialize(value).map_err(|error| refuse(&format!("{name}: {error}")))
}

/// A value in TOML, or a text without its quotes.
fn parsed(value: &str) -> Value {
    let table = format!("value = {value}").parse::<Table>().ok();
    table.and_then(|mut table| table.remove("value")).unwrap_or_else(|| Value::String(value.to_owned()))
}

/// The roles whose settings a text changes, each with the key in them, and the value.
fn parse(text: &str) -> Result<(Vec<(Role, String)>, Value), String> {
    let allowed =
        "KEY=VALUE, where KEY begins with estimator, obstacles, controller, actuator, vehicle or scenario";
    let (key, value) = text.split_once('=').ok_or_else(|| format!("{text}: expected {allowed}"))?;
    let value = parsed(value);
    let (table, rest) = key.split_once('.').ok_or_else(|| format!("{text}: expected {allowed}"))?;
    let targets: Vec<(Role, String)> = match table {
        "scenario" => vec![(Role::Robot, key.to_owned())],
        "vehicle" => {
            let stages = Role::ALL.iter().filter(|role| **role != Role::Robot);
            stages.map(|role| (*role, format!("{role}.vehicle.{rest}"))).collect()
        }
        name => match name.parse::<Role>() {
            Ok(role) if role != Role::Robot => vec![(role, key.to_owned())],
            _ => return Err(format!("{text}: expected {allowed}")),
        },
    };
    Ok((targets, value))
}

fn set_key(table: &mut Table, key: &str, value: Value) -> Result<(), String> {
    let (name, rest) = key.split_once('.').map_or((key, None), |(name, rest)| (name, Some(rest)));
    match (table.get_mut(name), rest) {
        (Some(Value::Table(inner)), Some(rest)) => set_key(inner, rest, value),
        (Some(known), None) => {
            // `1` for a number with a fraction.
            *known = match (&*known, value) {
                (Value::Float(_), Value::Integer(number)) => Value::Float(number as f64),
                (_, value) => value,
            };
            Ok(())
        }
        _ => {
            let keys: Vec<&str> = table.keys().map(String::as_str).collect();
            let meant = did_you_mean(name, keys.iter().copied());
            Err(format!("unknown key {name}.{meant} Known are {}", keys.join(", ")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_set_where_they_are() {
        let mut table: Table =
            "[controller]\nhorizon_s = 2.0\n[controller.stop]\ntime_s = 1.0".parse().unwrap();
        set_key(&mut table, "controller.stop.time_s", Value::Integer(3)).unwrap();
        assert_eq!(table["controller"]["stop"]["time_s"], Value::Float(3.0));
        let refused = set_key(&mut table, "controller.horizon", Value::Integer(3)).unwrap_err();
        assert_eq!(refused, "unknown key horizon. Did you mean `horizon_s`? Known are horizon_s, stop");
    }
}
