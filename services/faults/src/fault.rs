//! The file of one fault.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use shared_types::{Role, Topic};

use crate::Change;
use crate::sample_fault::{SampleAction, SampleFault};

/// Longest time of a process fault [s]: a cell with real processes is short.
const MAX_SECONDS: f64 = 4.0;

/// Part of a drive in which a fault begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DrivePhase {
    /// With the first scan.
    Start,
    /// On the straight way to the obstacle, at full speed.
    Straight,
    /// Beside the obstacle.
    Beside,
    /// In a bend, on a course of its own.
    Bend,
    /// Backwards, on a course of its own.
    Reverse,
    /// Just before the goal.
    Landing,
    /// While the controller is replaced by another process.
    Swap,
    /// While a person drives.
    Person,
}

impl DrivePhase {
    /// All phases, in the order of a drive.
    pub const ALL: [Self; 8] = [
        Self::Start,
        Self::Straight,
        Self::Beside,
        Self::Bend,
        Self::Reverse,
        Self::Landing,
        Self::Swap,
        Self::Person,
    ];

    /// Its name in the name of a cell.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Straight => "straight",
            Self::Beside => "beside",
            Self::Bend => "bend",
            Self::Reverse => "reverse",
            Self::Landing => "landing",
            Self::Swap => "swap",
            Self::Person => "person",
        }
    }

    /// Whether it is on a course of its own.
    pub const fn has_own_course(self) -> bool {
        matches!(self, Self::Bend | Self::Reverse)
    }
}

impl fmt::Display for DrivePhase {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

/// One fault.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InjectedFault {
    /// Name of the file.
    #[serde(skip)]
    pub name: String,
    /// What fails.
    pub title: String,
    /// By how much.
    pub magnitude: String,
    /// How it is injected.
    pub inject: Injection,
    /// What must happen.
    pub expect: Expectation,
    /// What differs in some phases.
    #[serde(default, rename = "in")]
    pub in_phase: BTreeMap<DrivePhase, InPhase>,
}

/// Where a fault acts.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Injection {
    /// On the samples of one topic.
    Sample(SampleFault),
    /// In the emulated robot: tables of the scenario file.
    Scenario(ScenarioFault),
    /// On a process.
    Process(ProcessFault),
    /// On a person who drives.
    Person(PersonFault),
}

/// A person who asks for nothing new any more, or for what is old.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PersonFault {
    /// How old what it asks for is when it arrives [ms]; without it, it asks for nothing new.
    pub delay_ms: Option<u64>,
}

/// Other values of keys of the scenario.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioFault {
    /// Number of scans that it lasts; without it, to the end of the drive.
    pub scans: Option<u64>,
    /// The keys, as in a scenario file.
    pub set: toml::Table,
}

/// A process, or all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProcessName {
    /// The process of a role.
    Role(Role),
    /// The orchestrator.
    Orchestrator,
    /// All processes of the system: the machine stalls.
    All,
}

impl fmt::Display for ProcessName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(match self {
            Self::Role(role) => role.name(),
            Self::Orchestrator => "orchestrator",
            Self::All => "all",
        })
    }
}

/// A fault of a process.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProcessFault {
    /// The process.
    #[serde(deserialize_with = "process")]
    pub process: ProcessName,
    /// What happens to it.
    pub action: ProcessAction,
    /// How long it is suspended, or floods; without it, to the end of the cell [s].
    pub seconds: Option<f64>,
}

/// What happens to a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProcessAction {
    /// It is killed.
    Kill,
    /// It is suspended.
    Hang,
    /// Its topic is flooded in its name.
    Flood,
    /// Shared memory is filled.
    Fill,
}

/// What must happen.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expectation {
    /// How the drive may end, as in `report.json`; a cell with real processes may also be `driving` at its end.
    pub outcomes: Vec<String>,
    /// Roles, or the orchestrator, one of which must detect it; without any, it must have no effect on the wheels.
    pub detected_by: Vec<String>,
    /// Longest time until then [ms].
    pub within_ms: f64,
    /// From when on it can be told from what is normal: later than its beginning where it has to grow [ms].
    #[serde(default)]
    pub detectable_ms: f64,
    /// `true`: it can be told only once the robot has left the way of the drive without the fault by 5 cm.
    #[serde(default)]
    pub from_effect: bool,
}

/// What differs in one phase.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InPhase {
    /// Replaces [`Expectation::outcomes`].
    pub outcomes: Option<Vec<String>>,
    /// Replaces [`Expectation::detected_by`].
    pub detected_by: Option<Vec<String>>,
    /// Replaces [`Expectation::within_ms`].
    pub within_ms: Option<f64>,
    /// Replaces [`Expectation::detectable_ms`].
    pub detectable_ms: Option<f64>,
    /// Whether there is no such cell, because the fault is none in this phase.
    pub skip: bool,
    /// Why it differs.
    pub because: String,
}

/// Why the file of a fault can't be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {message}")]
pub struct FaultError {
    /// The file.
    pub file: String,
    /// What is wrong.
    pub message: String,
}

impl InjectedFault {
    /// The fault `name` in `text`.
    ///
    /// # Errors
    /// File, key, value and what is allowed.
    pub fn parse(name: &str, text: &str) -> Result<Self, FaultError> {
        let refuse = |message: String| FaultError { file: format!("{name}.toml"), message };
        let fault: Self = toml::from_str(text).map_err(|error| refuse(error.to_string()))?;
        let fault = Self { name: name.to_owned(), ..fault };
        fault.validate().map_err(refuse)?;
        Ok(fault)
    }

    /// What must happen when it begins in a phase.
    pub fn expected(&self, phase: DrivePhase) -> Expectation {
        let mut expected = self.expect.clone();
        if let Some(InPhase { outcomes, detected_by, within_ms, detectable_ms, .. }) =
            self.in_phase.get(&phase).cloned()
        {
            expected.outcomes = outcomes.unwrap_or(expected.outcomes);
            expected.detected_by = detected_by.unwrap_or(expected.detected_by);
            expected.within_ms = within_ms.unwrap_or(expected.within_ms);
            expected.detectable_ms = detectable_ms.unwrap_or(expected.detectable_ms);
        }
        expected
    }

    /// The phases in which it can begin.
    pub fn phases(&self) -> impl Iterator<Item = DrivePhase> + '_ {
        let is_skipped = |phase: &DrivePhase| self.in_phase.get(phase).is_some_and(|differs| differs.skip);
        let is_of_person = matches!(self.inject, Injection::Person(_));
        let begins = move |phase: &DrivePhase| match phase {
            DrivePhase::Person => true,
            // A process that fails knows of no course.
            _ if phase.has_own_course() => !is_of_person && !self.is_live(),
            _ => !is_of_person,
        };
        DrivePhase::ALL.into_iter().filter(begins).filter(move |phase| !is_skipped(phase))
    }

    /// Whether it needs real processes.
    pub fn is_live(&self) -> bool {
        matches!(self.inject, Injection::Process(_))
    }

    /// Passes when all expectations and what is injected are allowed.
    pub(crate) fn validate(&self) -> Result<(), String> {
        for phase in DrivePhase::ALL {
            self.expected(phase).validate()?;
        }
        match &self.inject {
            Injection::Sample(fault) => {
                Change::new(fault).map_err(|error| format!("inject.sample.fields: {error}"))?;
                let is_changing =
                    matches!(fault.action, SampleAction::Set | SampleAction::Add | SampleAction::Scale);
                let may_have_fields = is_changing || fault.action == SampleAction::Freeze;
                if is_changing && fault.fields.is_empty() || !may_have_fields && !fault.fields.is_empty() {
                    return Err(
                        "inject.sample.fields goes with the actions set, add, scale and freeze".to_owned()
                    );
                }
                if (fault.action == SampleAction::Delay) != (fault.delay_ms > 0) {
                    return Err("inject.sample.delay_ms goes with the action delay".to_owned());
                }
                if fault.at_robot && fault.topic != Topic::Actuation {
                    return Err("inject.sample.at_robot: the robot reads the topic actuation only".to_owned());
                }
                Ok(())
            }
            Injection::Process(ProcessFault { seconds: Some(seconds), .. })
                if !(*seconds > 0.0 && *seconds <= MAX_SECONDS) =>
            {
                Err(format!(
                    "inject.process.seconds = {seconds} is not allowed: above 0, up to {MAX_SECONDS}"
                ))
            }
            Injection::Process(_) | Injection::Scenario(_) | Injection::Person(_) => Ok(()),
        }
    }
}

impl Expectation {
    fn validate(&self) -> Result<(), String> {
        const OUTCOMES: [&str; 6] = ["reached", "missed", "stopped", "timeout", "failed", "driving"];
        if let Some(other) = self.outcomes.iter().find(|outcome| !OUTCOMES.contains(&outcome.as_str())) {
            return Err(format!("outcomes: `{other}` is not one of {}", OUTCOMES.join(", ")));
        }
        let is_known = |name: &str| name == "orchestrator" || name.parse::<Role>().is_ok();
        if let Some(other) = self.detected_by.iter().find(|name| !is_known(name)) {
            return Err(format!("detected_by: `{other}` is neither a role nor orchestrator"));
        }
        if self.outcomes.is_empty() {
            return Err("outcomes: at least one".to_owned());
        }
        if !(self.within_ms >= 0.0 && self.detectable_ms >= 0.0) {
            return Err("within_ms and detectable_ms are 0 or more".to_owned());
        }
        Ok(())
    }
}

fn process<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<ProcessName, D::Error> {
    match String::deserialize(deserializer)?.as_str() {
        "orchestrator" => Ok(ProcessName::Orchestrator),
        "all" => Ok(ProcessName::All),
        role => role.parse().map(ProcessName::Role).map_err(serde::de::Error::custom),
    }
}
