//! What can be asked of a running orchestrator.

use serde::{Deserialize, Serialize};
use shared_types::Role;
use supervision::entry::ProcessEntry;
use supervision::fleet::Fleet;
use supervision::supervisor::{Supervisor, VisibleState};

/// What can be asked of a running orchestrator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Request {
    /// The state of all processes.
    Status,
    /// Block the wheels and end everything.
    Stop,
    /// End one process and start it again.
    Restart {
        /// Its role.
        #[serde(with = "role_name")]
        role: Role,
    },
    /// Exchange one process for another.
    Swap(SwapRequest),
    /// What became of an exchange.
    SwapResult {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
    /// Let a process run in the shadow of another.
    Shadow(ShadowRequest),
    /// What became of a shadow.
    ShadowResult {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
    /// End a shadow early.
    ShadowEnd {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
}

/// A process that is to come beside the one that fills a role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Successor {
    /// The role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Built-in implementation; exactly one of this and `command`.
    pub implementation: Option<String>,
    /// Program and arguments.
    pub command: Option<Vec<String>>,
}

/// An exchange that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapRequest {
    /// The process that comes beside the one that drives.
    #[serde(flatten)]
    pub successor: Successor,
    /// Scans in a row on which the new process must agree before it takes over.
    pub shadow_scans: u64,
    /// Scans after that during which the old process stands by.
    pub standby_scans: u64,
    /// Factor on the bounds of agreement.
    pub tolerance: f64,
}

/// A shadow that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShadowRequest {
    /// The process that comes beside the one that drives.
    #[serde(flatten)]
    pub successor: Successor,
    /// How long it is to run [ms].
    pub duration_ms: u64,
}

impl Successor {
    /// How it is started: as the process that fills the role, but for the program.
    ///
    /// # Errors
    /// Why it can't be, in words.
    pub(crate) fn entry(&self, fleet: &Fleet) -> Result<ProcessEntry, String> {
        let entry = fleet.entry_with(self.role, self.implementation.clone(), self.command.clone());
        let entry = entry.ok_or_else(|| format!("no process of role {}", self.role))?;
        entry.validate().map_err(|invalid| invalid.to_string())?;
        Ok(entry)
    }

    /// That the system drives and the role is filled by a process that is ready; `what` it is not ready for else.
    ///
    /// # Errors
    /// The reason in words.
    pub(crate) fn require_ready(&self, supervisor: &Supervisor, what: &str) -> Result<(), String> {
        let role = self.role;
        let is_ready = supervisor.process(role).is_some_and(|view| view.state == VisibleState::Ready);
        if supervisor.phase() == shared_types::Phase::Driving && is_ready {
            return Ok(());
        }
        Err(format!("{role} is not ready {what}: the system must drive"))
    }
}

/// A role travels by its name.
mod role_name {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use shared_types::Role;

    pub(super) fn serialize<S: Serializer>(role: &Role, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(role.name())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Role, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
