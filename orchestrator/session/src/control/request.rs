//! What can be asked of a running orchestrator.

use runtime::HUB;
use serde::{Deserialize, Serialize};
use shared_types::Role;
use supervision::entry::{ProcessEntry, role_name};

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
    /// Inject a fault.
    Inject {
        /// Its name.
        fault: String,
        /// How long it lasts [s]; without it, as its file says.
        for_s: Option<f64>,
    },
    /// Replace a companion: by a command, or by a new process of its own.
    ReplaceCompanion {
        /// Its name.
        name: String,
        /// Program and arguments.
        command: Option<Vec<String>>,
        /// Scans in a row on which the new process must agree, where its topics have bounds.
        shadow_scans: u64,
    },
    /// Replace one process by another.
    Swap(SwapRequest),
    /// Change keys of a goal.
    Goal {
        /// `KEY=VALUE` each.
        set: Vec<String>,
    },
    /// Block the wheels until [`Request::Resume`]; all processes stay ready.
    Pause,
    /// Let the controller drive again.
    Resume,
    /// Drive by hand from now on.
    Teleop,
    /// Block the wheels until the person who drives asks for a control, or as [`Request::Pause`].
    Hold {
        /// The number of the person, from [`Reply::Teleop`].
        person: u64,
        /// Whether it drives no more: then only [`Request::Resume`] or another person drives on.
        ends: bool,
    },
    /// What the person who drives by hand asks for.
    Control {
        /// The number of the person, from [`Reply::Teleop`].
        person: u64,
        /// Velocity [m/s]; zero to stand.
        velocity_mps: f64,
        /// Steering angle [rad].
        steering_rad: f64,
        /// When it was asked for [ns of CLOCK_MONOTONIC].
        given_ns: u64,
    },
    /// Ask for the certificate of a swap.
    SwapResult {
        /// Its number, from [`Reply::Accepted`].
        number: u64,
    },
    /// Write the last seconds that are kept in memory to a file.
    Keep,
    /// Let a process run in the shadow of another.
    Shadow(ShadowRequest),
    /// Ask for the report of a shadow.
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

/// A candidate for a role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Successor {
    /// The role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// Built-in implementation; exactly one of this and `command`, or neither when settings change.
    pub implementation: Option<String>,
    /// Program and arguments.
    pub command: Option<Vec<String>>,
    /// Name of the host for the implementation; without it, the one where the role is.
    #[serde(default)]
    pub host: Option<String>,
}

/// The request for a swap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SwapRequest {
    /// The new process.
    #[serde(flatten)]
    pub successor: Successor,
    /// Settings that change, `KEY=VALUE` each. The successor then names no program: the running one starts again.
    #[serde(default)]
    pub set: Vec<String>,
    /// Scans in a row on which the new process must agree before it takes over.
    pub shadow_scans: u64,
    /// Scans after that during which the old process is a standby.
    pub standby_scans: u64,
    /// Factor on the bounds of agreement.
    pub tolerance: f64,
}

/// The request for a shadow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShadowRequest {
    /// The new process.
    #[serde(flatten)]
    pub successor: Successor,
    /// How long it is to run [ms].
    pub duration_ms: u64,
}

impl Successor {
    /// The entry of the process: that of the running process, with another program, or on another one of `hosts`.
    ///
    /// # Errors
    /// The reason why it can't be started.
    pub(crate) fn entry(&self, live: &ProcessEntry, hosts: &[String]) -> Result<ProcessEntry, String> {
        let (implementation, command) = (self.implementation.clone(), self.command.clone());
        let host = match self.host.as_deref() {
            None => live.host.clone(),
            Some(HUB) => None,
            Some(name) if hosts.iter().any(|host| host == name) => Some(name.to_owned()),
            Some(name) => {
                let names = [hosts, &[HUB.to_owned()]].concat().join(", ");
                return Err(format!("host = {name} is not allowed: one of {names}"));
            }
        };
        if host != live.host && matches!(self.role, Role::Robot | Role::Actuator) {
            let name = self.host.as_deref().unwrap_or_default();
            return Err(format!(
                "host = {name} is not allowed for {}: robot and actuator stay on one host, so that a stop needs no network",
                self.role
            ));
        }
        if let (Some(host), Some(command)) = (&live.host, &command) {
            let command = command.join(" ");
            return Err(format!(
                "command = {command} is not allowed: an `implementation`, because the role is on host {host}"
            ));
        }
        let entry = ProcessEntry { implementation, command, host, ..live.clone() };
        entry.validate().map_err(|invalid| invalid.to_string())?;
        Ok(entry)
    }
}
