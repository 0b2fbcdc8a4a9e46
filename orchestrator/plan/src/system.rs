//! The system file: which process fills which role, at which rate, with which settings.

use std::path::Path;

use console::exit::Failure;
use console::user_file::{self, TEXT_BYTES};
use pipeline::Tuning;
use serde::{Deserialize, Serialize};
use shared_types::Role;
use supervision::entry::ProcessEntry;
use supervision::realtime;
use toml::{Table, Value};
use vehicle::{Invalid, require};

/// The built-in process table.
pub const BUILT_IN: &str = include_str!("../../systems/default.toml");

/// A checked system file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct System {
    /// Scans per second, 0.5 to 1000 [Hz].
    #[serde(default = "default_rate")]
    pub rate_hz: f64,
    /// How long processes go on when no orchestrator speaks to them, 1 to 3600 [s].
    #[serde(default = "default_orphan_timeout")]
    pub orphan_timeout_s: f64,
    /// How long the wheels may turn without a directive, 0.5 to `orphan_timeout_s` [s].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orphan_stop_s: Option<f64>,
    /// What is asked of the machine.
    #[serde(default)]
    pub realtime: runtime::Realtime,
    /// One entry per role.
    #[serde(rename = "process", default)]
    pub processes: Vec<ProcessEntry>,
    /// Settings of the estimator.
    #[serde(default)]
    pub estimator: estimator::Config,
    /// Settings of the obstacle description.
    #[serde(default)]
    pub obstacles: obstacles::Config,
    /// Settings of the controller.
    #[serde(default)]
    pub controller: nmpc::Config,
    /// Settings of the actuator.
    #[serde(default)]
    pub actuator: actuation::Config,
}

impl System {
    /// The system in a table that was read before, possibly with overrides in it; `file` stands in messages only.
    ///
    /// # Errors
    /// One message with file, key, value and allowed range; exit code 2.
    pub fn from_table(table: Table, file: &str) -> anyhow::Result<Self> {
        let known = [
            "rate_hz",
            "orphan_timeout_s",
            "orphan_stop_s",
            "realtime",
            "process",
            "estimator",
            "obstacles",
            "controller",
            "actuator",
        ];
        if let Some(key) = table.keys().find(|key| !known.contains(&key.as_str())) {
            let known = known.map(|key| format!("`{key}`")).join(", ");
            return Err(Failure::bad_input(format!(
                "{file}: {key}: the key is unknown, expected one of {known}"
            )));
        }
        let shown = table.clone();
        let system: Self = serde_path_to_error::deserialize(Value::Table(table)).map_err(|error| {
            let path = error.path().to_string();
            let value = value_at(&shown, &path).map_or_else(String::new, |value| format!(" = {value}"));
            let message = error.inner().message().lines().next().unwrap_or_default().to_owned();
            Failure::bad_input(format!("{file}: {path}{value} is not allowed: {message}"))
        })?;
        system.validate().map_err(|invalid| Failure::bad_input(format!("{file}: {invalid}")))?;
        Ok(system)
    }

    /// The table of a file, or the built-in one.
    ///
    /// # Errors
    /// A message with the file, and the line where the text is no TOML; exit code 2.
    pub fn read_table(file: Option<&Path>) -> anyhow::Result<(Table, String)> {
        let (text, name) = match file {
            None => (BUILT_IN.to_owned(), "built-in system".to_owned()),
            Some(path) => {
                let name = path.display().to_string();
                (
                    user_file::read(path, TEXT_BYTES)
                        .map_err(|error| Failure::bad_input(format!("{name}: {error}")))?,
                    name,
                )
            }
        };
        let table = text.parse::<Table>().map_err(|error| {
            let line = error.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            Failure::bad_input(format!("{name}: line {line}: {}", error.message().replace('\n', ", ")))
        })?;
        Ok((table, name))
    }

    /// How long the wheels may turn without a directive [s].
    pub fn orphan_stop_s(&self) -> f64 {
        self.orphan_stop_s.unwrap_or_else(|| self.orphan_timeout_s.min(ORPHAN_STOP_S))
    }

    /// The scan period [ns].
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz).round() as u64
    }

    /// The settings of the stages.
    pub fn tuning(&self) -> Tuning {
        Tuning {
            estimator: self.estimator.clone(),
            obstacles: self.obstacles,
            controller: self.controller.clone(),
            actuator: self.actuator.clone(),
        }
    }

    /// The entry of a role; a checked system has one for each.
    pub fn entry(&self, role: Role) -> Option<&ProcessEntry> {
        self.processes.iter().find(|entry| entry.role == role)
    }

    fn validate(&self) -> Result<(), Invalid> {
        require("rate_hz", self.rate_hz, 0.5..=1000.0)?;
        require("orphan_timeout_s", self.orphan_timeout_s, 1.0..=3600.0)?;
        require("orphan_stop_s", self.orphan_stop_s(), MIN_ORPHAN_STOP_S..=self.orphan_timeout_s)?;
        realtime::validate(&self.realtime).map_err(|invalid| invalid.within("realtime"))?;
        for (index, entry) in self.processes.iter().enumerate() {
            entry.validate().map_err(|error| error.within(&format!("process[{index}]")))?;
        }
        for role in Role::ALL {
            let count = self.processes.iter().filter(|entry| entry.role == *role).count();
            if count > 1 {
                let topics: Vec<&str> = role.writes().iter().map(|topic| topic.name()).collect();
                let allowed = format!(
                    "one process per role; {count} processes would write topic {}",
                    topics.join(", ")
                );
                return Err(Invalid::new("process.role", role, allowed));
            }
            if count == 0 {
                return Err(Invalid::new(
                    "process",
                    format!("no process of role {role}"),
                    "one process per role",
                ));
            }
        }
        self.tuning().validate()
    }
}

/// The value at a path like `controller.weights.x` or `process[2].role`.
fn value_at<'a>(table: &'a Table, path: &str) -> Option<&'a Value> {
    let mut parts = path.split(['.', '[']).map(|part| part.trim_end_matches(']'));
    let mut value = table.get(parts.next()?)?;
    for part in parts {
        value = match value {
            Value::Table(inner) => inner.get(part)?,
            Value::Array(items) => items.get(part.parse::<usize>().ok()?)?,
            _ => return None,
        };
    }
    (!value.is_table() && !value.is_array()).then_some(value)
}

fn default_rate() -> f64 {
    10.0
}

/// Directives come ten times a second, and a busy machine may hold them up.
const MIN_ORPHAN_STOP_S: f64 = 0.5;
/// A robot without supervision drives on for this time at most [s].
const ORPHAN_STOP_S: f64 = 5.0;

fn default_orphan_timeout() -> f64 {
    30.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error_of(text: &str) -> String {
        let mut table: Table = BUILT_IN.parse().unwrap();
        for (key, value) in text.parse::<Table>().unwrap() {
            match (table.get_mut(&key), value) {
                (Some(Value::Array(items)), Value::Array(more)) => items.extend(more),
                (_, value) => drop(table.insert(key, value)),
            }
        }
        System::from_table(table, "lab.toml").unwrap_err().to_string()
    }

    #[test]
    fn the_built_in_system_is_valid_and_fills_every_role() {
        let system = System::from_table(BUILT_IN.parse().unwrap(), "built-in").unwrap();
        assert_eq!(system.processes.len(), 5);
        assert_eq!(system.period_ns(), 100_000_000);
    }

    #[test]
    fn messages_name_file_key_value_and_what_is_allowed() {
        assert_eq!(error_of("rate_hz = nan"), "lab.toml: rate_hz = NaN is not allowed: 0.5 to 1000");
        assert!(
            error_of("rate = 10.0")
                .starts_with("lab.toml: rate: the key is unknown, expected one of `rate_hz`")
        );
        let typed = error_of("rate_hz = \"fast\"");
        assert!(typed.starts_with("lab.toml: rate_hz = \"fast\" is not allowed: invalid type"), "{typed}");
    }

    #[test]
    fn two_processes_of_one_role_are_refused() {
        let twice = error_of("[[process]]\nrole = \"controller\"\nimplementation = \"nmpc\"");
        assert_eq!(
            twice,
            "lab.toml: process.role = controller is not allowed: one process per role; 2 processes would write topic command"
        );
        let unknown = error_of("[[process]]\nrole = \"pilot\"\nimplementation = \"nmpc\"");
        let expected =
            "process[5].role = \"pilot\" is not allowed: unknown role `pilot`: expected robot, estimator";
        assert!(unknown.contains(expected), "{unknown}");
        let foreign = error_of("[[process]]\nrole = \"controller\"\nimplementation = \"ekf\"");
        assert!(foreign.contains("process[5].implementation = ekf is not allowed: one of nmpc"), "{foreign}");
    }
}
