//! Typed settings of a process: one table of the file that the orchestrator has checked and written for its role.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shared_types::Role;

use crate::{Clock, Domain, RuntimeError};

/// Name of the settings file of a role in the directory of the system.
pub fn settings_file(role: Role) -> String {
    format!("settings-{role}.toml")
}

/// Name of the settings file of one incarnation, which it reads instead of that of its role, if there is one.
pub fn own_settings_file(incarnation: u32) -> String {
    format!("settings-{incarnation}.toml")
}

/// Name of the file with the settings that an incarnation was started with, if they were not those of its role. It stays
/// there when the role has got them, or the process was refused: a recorder may read it later.
pub fn started_settings_file(incarnation: u32) -> String {
    format!("started-{incarnation}.toml")
}

/// Name of the table in it that belongs to the role alone. Only the robot reads the scenario.
pub fn settings_table(role: Role) -> &'static str {
    if role == Role::Robot { "scenario" } else { role.name() }
}

/// The time of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockKind {
    /// CLOCK_MONOTONIC: driving in real time.
    Monotonic,
    /// Time moves with the samples, in lock-step.
    Simulated,
}

impl ClockKind {
    /// A clock of this kind.
    pub fn clock(self) -> Clock {
        match self {
            Self::Monotonic => Clock::Monotonic,
            Self::Simulated => Clock::simulated(),
        }
    }
}

/// The table `run` of the settings: what all processes need to know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSettings {
    /// Scan period [ns].
    pub period_ns: u64,
    /// The time the loop lives in.
    pub clock: ClockKind,
    /// How long actuator and robot let the wheels turn without a directive [ns].
    pub orphan_stop_ns: u64,
    /// Processes end after this time without a directive [ns].
    pub orphan_timeout_ns: u64,
}

/// The file of an incarnation or of its role as a table.
pub(crate) fn read(domain: &Domain, role: Role, incarnation: u32) -> Result<toml::Table, RuntimeError> {
    let own = own_settings_file(incarnation);
    let name = if domain.folder().contains(&own) { own } else { settings_file(role) };
    let text = domain.folder().read_text(&name)?;
    text.parse()
        .map_err(|error: toml::de::Error| RuntimeError::settings(domain.directory().join(name), error))
}

/// One table of the file as settings of type `T`; a table that is absent reads as empty.
pub(crate) fn table<T: DeserializeOwned>(
    domain: &Domain,
    role: Role,
    all: &toml::Table,
    name: &str,
) -> Result<T, RuntimeError> {
    let value = all.get(name).cloned().unwrap_or_else(|| toml::Table::new().into());
    T::deserialize(value).map_err(|error| {
        RuntimeError::settings(domain.directory().join(settings_file(role)), format_args!("{name}: {error}"))
    })
}
