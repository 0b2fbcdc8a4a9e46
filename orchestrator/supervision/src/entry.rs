//! One process of a system, as the system file describes it and as a run records it.

use runtime::Identity;
use serde::{Deserialize, Serialize};
use shared_types::Role;
use vehicle::{Invalid, require};

use crate::supervisor::{ProcessPolicy, Restart};

/// One process of the system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessEntry {
    /// Role that the process fills: robot, estimator, obstacles, controller or actuator.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Built-in implementation; exactly one of this and `command`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub implementation: Option<String>,
    /// Program and arguments of an implementation of one's own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub command: Option<Vec<String>>,
    /// `never`, `on-failure` or `always`.
    #[serde(default = "default_restart")]
    pub restart: Restart,
    /// Deaths before the first valid output that end the run, 1 to 100.
    #[serde(default = "default_start_limit")]
    pub start_limit: u32,
    /// Restarts within `restart_window_s` of one that had been ready; one death more ends the run, 1 to 1000000.
    #[serde(default = "default_restart_limit")]
    pub restart_limit: u32,
    /// Over this time such deaths are counted, 0.1 to 86400 [s].
    #[serde(default = "default_restart_window")]
    pub restart_window_s: f64,
    /// Longest time to attach, to connect, and to the first output of one that has all it reads, 0.1 to 3600 [s].
    #[serde(default = "default_start_timeout")]
    pub start_timeout_s: f64,
    /// Time between the request to end and the kill, 1 to 3600000 [ms].
    #[serde(default = "default_grace")]
    pub grace_ms: u64,
}

/// A living process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProcessRow {
    /// Its role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Distinguishes it from an unrelated process with the same number.
    pub identity: Identity,
    /// How it was started.
    pub entry: ProcessEntry,
}

/// Built-in implementations: name, and the role that each fills.
pub const IMPLEMENTATIONS: [(&str, Role); 5] = [
    ("emulator", Role::Robot),
    ("ekf", Role::Estimator),
    ("ellipses", Role::Obstacles),
    ("nmpc", Role::Controller),
    ("actuation", Role::Actuator),
];

impl ProcessEntry {
    /// A command that fills a role, with the default policy.
    #[must_use]
    pub fn of(role: Role, command: &[String]) -> Self {
        Self {
            role,
            implementation: None,
            command: Some(command.to_vec()),
            restart: default_restart(),
            start_limit: default_start_limit(),
            restart_limit: default_restart_limit(),
            restart_window_s: default_restart_window(),
            start_timeout_s: default_start_timeout(),
            grace_ms: default_grace(),
        }
    }

    /// The policy by which the supervisor keeps the process alive.
    pub fn policy(&self, period_ns: u64) -> ProcessPolicy {
        let period_ms = period_ns.div_ceil(1_000_000);
        ProcessPolicy {
            restart: self.restart,
            start_limit: self.start_limit,
            restart_limit: self.restart_limit,
            restart_window_ms: (self.restart_window_s * 1e3) as u64,
            start_timeout_ms: (self.start_timeout_s * 1e3) as u64,
            grace_ms: self.grace_ms,
            ..ProcessPolicy::new(self.role, period_ms)
        }
    }

    /// Name of the built-in implementation, or the command.
    pub fn label(&self) -> String {
        match (&self.implementation, &self.command) {
            (Some(name), _) => name.clone(),
            (None, Some(command)) => command.join(" "),
            (None, None) => String::new(),
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed, with what is.
    pub fn validate(&self) -> Result<(), Invalid> {
        let role = self.role;
        match (&self.implementation, &self.command) {
            (Some(name), None) => {
                if !IMPLEMENTATIONS.contains(&(name.as_str(), role)) {
                    let of_role: Vec<&str> =
                        IMPLEMENTATIONS.iter().filter(|(_, of)| *of == role).map(|(name, _)| *name).collect();
                    let allowed = format!("one of {} for role {role}, or a `command`", of_role.join(", "));
                    return Err(Invalid::new("implementation", name, allowed));
                }
            }
            (None, Some(command)) => {
                if command.first().is_none_or(String::is_empty) {
                    return Err(Invalid::new("command", "[]", "a program and its arguments"));
                }
            }
            _ => {
                let allowed = "one of `implementation` and `command`";
                return Err(Invalid::new("implementation", "both or none", allowed));
            }
        }
        require("start_limit", f64::from(self.start_limit), 1.0..=100.0)?;
        require("restart_limit", f64::from(self.restart_limit), 1.0..=1e6)?;
        require("restart_window_s", self.restart_window_s, 0.1..=86_400.0)?;
        require("start_timeout_s", self.start_timeout_s, 0.1..=3600.0)?;
        require("grace_ms", self.grace_ms as f64, 1.0..=3_600_000.0)
    }
}

fn default_restart() -> Restart {
    Restart::OnFailure
}

fn default_start_limit() -> u32 {
    3
}

fn default_restart_limit() -> u32 {
    5
}

fn default_restart_window() -> f64 {
    60.0
}

fn default_start_timeout() -> f64 {
    10.0
}

fn default_grace() -> u64 {
    1000
}

/// A role in files and messages, by its name.
pub mod role_name {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use shared_types::Role;

    /// Writes the name.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(role: &Role, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(role.name())
    }

    /// Reads the name.
    ///
    /// # Errors
    /// A text that is no role, with the names of all.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Role, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
