//! Changes keys in the recorded settings of the stages.

use std::collections::BTreeMap;

use shared_types::{Role, did_you_mean};
use toml::{Table, Value};

/// Sets one key.
///
/// # Errors
/// What is wrong with a text that is no `ROLE.KEY=VALUE`.
pub(super) fn set(settings: &mut BTreeMap<Role, Table>, text: &str) -> Result<(), String> {
    let (targets, value) = parse(text)?;
    for (role, key) in targets {
        let table = settings.get_mut(&role).ok_or("a role has no settings")?;
        set_key(table, &key, value.clone()).map_err(|reason| format!("{text}: {reason}"))?;
    }
    Ok(())
}

/// Sets one key in the settings of a process, if it is one of its role.
///
/// # Errors
/// As [`set`].
pub(super) fn set_of(role: Role, table: &mut Table, text: &str) -> Result<(), String> {
    let (targets, value) = parse(text)?;
    for (_, key) in targets.iter().filter(|(of, _)| *of == role) {
        set_key(table, key, value.clone()).map_err(|reason| format!("{text}: {reason}"))?;
    }
    Ok(())
}

/// The roles whose settings a text changes, each with the key in them, and the value.
fn parse(text: &str) -> Result<(Vec<(Role, String)>, Value), String> {
    let allowed =
        "KEY=VALUE, where KEY begins with estimator, obstacles, controller, actuator, vehicle or scenario";
    let (key, value) = text.split_once('=').ok_or_else(|| format!("{text}: expected {allowed}"))?;
    let value: Value = format!("value = {value}")
        .parse::<Table>()
        .ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| Value::String(value.to_owned()));
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
