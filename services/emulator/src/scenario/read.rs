//! From a TOML table to a scenario, with errors that name the key.
//!
//! Serde says what is wrong, not where. So each key of a table is read alone first, in a table of its own: if
//! that fails, the key is found. It works because every key of every table here has a default.

use serde::de::DeserializeOwned;
use toml::{Table, Value};
use vehicle::Invalid;

use super::obstacle::ObstacleFile;
use super::{Endless, Goal, Noise, Obstacle, Robot, Scenario, Start, Track};

/// The scenario in `table`, with types and names of keys checked, numbers not yet.
pub(super) fn scenario(table: Table) -> Result<Scenario, Invalid> {
    for (key, value) in &table {
        match key.as_str() {
            "track" => section::<Track>(key, value)?,
            "start" => section::<Start>(key, value)?,
            "goal" => section::<Goal>(key, value)?,
            "robot" => section::<Robot>(key, value)?,
            "noise" => section::<Noise>(key, value)?,
            "endless" => section::<Endless>(key, value)?,
            "obstacle" => obstacles(value)?,
            _ => one_key::<Scenario>(key, value)?,
        }
    }
    let shown = table.to_string();
    table.try_into().map_err(|error: toml::de::Error| Invalid::new("scenario", shown, error.message()))
}

/// Line of a byte of the text, from 1.
pub(super) fn line_of(text: &str, byte: usize) -> usize {
    1 + text.bytes().take(byte).filter(|letter| *letter == b'\n').count()
}

fn section<T: DeserializeOwned>(name: &str, value: &Value) -> Result<(), Invalid> {
    let table = value.as_table().ok_or_else(|| Invalid::new(name, value, format!("a table [{name}]")))?;
    table.iter().try_for_each(|(key, value)| one_key::<T>(key, value)).map_err(|error| error.within(name))
}

fn obstacles(value: &Value) -> Result<(), Invalid> {
    let tables = value.as_array().ok_or_else(|| Invalid::new("obstacle", value, "tables [[obstacle]]"))?;
    for (index, value) in tables.iter().enumerate() {
        let name = format!("obstacle[{index}]");
        section::<ObstacleFile>(&name, value)?;
        let file: ObstacleFile = value
            .clone()
            .try_into()
            .map_err(|error: toml::de::Error| Invalid::new(&name, value, error.message()))?;
        Obstacle::try_from(file).map_err(|error| error.within(&name))?;
    }
    Ok(())
}

/// Reads a table that holds this key only.
fn one_key<T: DeserializeOwned>(key: &str, value: &Value) -> Result<(), Invalid> {
    let alone = Table::from_iter([(key.to_owned(), value.clone())]);
    match alone.try_into::<T>() {
        Ok(_) => Ok(()),
        Err(error) => Err(Invalid::new(key, value, allowed(error.message()))),
    }
}

/// What is allowed, in words, from what serde says about one key.
fn allowed(message: &str) -> String {
    let message = message.lines().next().unwrap_or_default();
    let expected = message.rsplit_once("expected ").map_or(message, |(_, expected)| expected);
    if message.starts_with("unknown field") {
        return format!("the key is unknown, expected {expected}");
    }
    match expected {
        "f64" => "a number".to_owned(),
        "u64" => "a whole number from 0".to_owned(),
        "an array of length 2" => "an array of two numbers".to_owned(),
        other => other.to_owned(),
    }
}
