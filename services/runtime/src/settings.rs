//! Typed settings of a process: one table of the file that the orchestrator has checked and written.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::{Clock, Domain, RuntimeError};

/// Name of the file in the directory of the system.
pub const SETTINGS_FILE: &str = "settings.toml";

/// Which time the loop lives in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockKind {
    /// CLOCK_MONOTONIC: driving in real time.
    Monotonic,
    /// Time moves with the samples: lock-step.
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
    /// How long processes go on without a directive before they end [ns].
    pub orphan_timeout_ns: u64,
}

/// The file as a table.
pub(crate) fn read(domain: &Domain) -> Result<toml::Table, RuntimeError> {
    let text = domain.folder().read_text(SETTINGS_FILE)?;
    text.parse().map_err(|error: toml::de::Error| RuntimeError::Settings {
        path: domain.directory().join(SETTINGS_FILE),
        reason: error.to_string(),
    })
}

/// One table of the file as settings of type `T`; a table that is absent reads as empty.
pub(crate) fn table<T: DeserializeOwned>(
    domain: &Domain,
    all: &toml::Table,
    name: &str,
) -> Result<T, RuntimeError> {
    let value = all.get(name).cloned().unwrap_or_else(|| toml::Value::Table(toml::Table::new()));
    value.try_into().map_err(|error: toml::de::Error| RuntimeError::Settings {
        path: domain.directory().join(SETTINGS_FILE),
        reason: format!("{name}: {error}"),
    })
}
