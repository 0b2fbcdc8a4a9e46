//! Faults in a running system: which can be injected there, and the file that tells a process of its fault.

use serde::{Deserialize, Serialize};
use shared_types::Role;

use crate::{FaultError, InjectedFault, Injection, ProcessAction, SampleAction, all};

/// How long a fault lasts that names no time of its own [s].
const LASTS_S: f64 = 2.0;
/// A process that publishes later than this can't answer the next scan in time [ms].
const MAX_DELAY_MS: u64 = 50;
/// Tables of the scenario that are no part of the course.
const OF_THE_ROBOT: [&str; 3] = ["robot", "noise", "scanner"];

/// Name of the file in the directory of a system whose processes take faults.
pub const PERMIT_FILE: &str = "allow-inject";

/// Name of the file in the directory of a system that holds the [`ActiveFault`] of a role.
pub fn fault_file(role: Role) -> String {
    format!("fault-{role}.toml")
}

/// The fault of a running process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActiveFault {
    /// Its name.
    pub name: String,
    /// When it ends, on CLOCK_MONOTONIC [ns].
    pub until_ns: u64,
}

/// Names of all faults that can be injected into a running system, in their order.
///
/// # Errors
/// As [`all`].
pub fn live_names() -> Result<Vec<String>, FaultError> {
    let live = all()?.into_iter().filter(|fault| fault.refused_live().is_none());
    Ok(live.map(|fault| fault.name).collect())
}

impl InjectedFault {
    /// Why it can't be injected into a running system; `None` if it can.
    pub fn refused_live(&self) -> Option<&'static str> {
        match &self.inject {
            Injection::Sample(fault) if fault.at_robot => {
                Some("it acts between actuator and robot, where no process changes samples")
            }
            Injection::Sample(fault) => match fault.action {
                SampleAction::Duplicate | SampleAction::Reorder | SampleAction::Flood => {
                    Some("a process publishes each sample once and in order")
                }
                SampleAction::Delay if fault.delay_ms > MAX_DELAY_MS => {
                    Some("the process would wait so long that it could not answer the next scan")
                }
                _ => None,
            },
            Injection::Scenario(fault) => {
                let is_late = fault.set.get("scanner").is_some_and(|scanner| scanner.get("late_s").is_some());
                let is_of_course = fault.set.keys().any(|table| !OF_THE_ROBOT.contains(&table.as_str()));
                match (is_of_course, is_late) {
                    (true, _) => Some("it changes the course"),
                    (_, true) => {
                        Some("scans that are delivered late leave no state from which the robot can return")
                    }
                    _ => None,
                }
            }
            Injection::Process(fault) => match fault.action {
                ProcessAction::Fill => Some("it fills the memory of all programs of this machine"),
                ProcessAction::Kill | ProcessAction::Hang | ProcessAction::Flood => None,
            },
            Injection::Person(_) => {
                Some("it acts on what a person asks for: end or suspend `scanloop teleop`")
            }
        }
    }

    /// The role whose process must change what it does; `None` for a fault that acts on a process from outside.
    pub fn acts_in(&self) -> Option<Role> {
        match &self.inject {
            Injection::Sample(fault) => fault.topic.writer(),
            Injection::Scenario(_) => Some(Role::Robot),
            Injection::Process(_) | Injection::Person(_) => None,
        }
    }

    /// How long it lasts unless it is told otherwise, at a scan period [s].
    pub fn lasts_s(&self, period_s: f64) -> f64 {
        match &self.inject {
            Injection::Sample(fault) => fault.scans.map(|scans| scans as f64 * period_s),
            Injection::Scenario(fault) => fault.scans.map(|scans| scans as f64 * period_s),
            Injection::Process(fault) => fault.seconds,
            Injection::Person(_) => None,
        }
        .unwrap_or(LASTS_S)
    }
}
