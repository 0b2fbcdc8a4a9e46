//! The files of a run from which another orchestrator can adopt it, in the directory of the system; each is written
//! whole or not at all.
//!
//! `run.toml` contains scenario and system and is written once. `processes.toml` contains the process of each role and
//! the newest directive; it is written at each change, before the change is published. `progress.toml` says which goals
//! and laps are behind the robot.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context;
use emulator::{DriveProgress, JudgedBy, Outcome, Scenario};
use plan::Plan;
use plan::system::System;
use runtime::{Domain, OwnTopics, PROCESSES_FILE};
use serde::{Deserialize, Serialize};
use shared_types::{Authority, Role, SLOTS};
use supervision::entry::{ProcessEntry, ProcessRow, role_name};
use toml::{Table, Value};
use vehicle::{of_text, text_of};

pub(crate) const RUN_FILE: &str = "run.toml";
const PROGRESS_FILE: &str = "progress.toml";

/// The run: scenario, system and options.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub(crate) struct RunFile {
    /// Where the results are written.
    pub out: PathBuf,
    /// Whether time is simulated.
    pub lockstep: bool,
    /// Driven time after which the run ends [s].
    #[serde(default)]
    pub duration_s: Option<f64>,
    /// The process table with all settings.
    pub system: System,
    /// The scenario.
    pub scenario: Scenario,
}

/// The process of each role, and the newest directive.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct ProcessRegistry {
    /// How many orchestrators this run has had.
    pub generation: u32,
    /// The largest number given to a process.
    pub last_incarnation: u32,
    /// `Phase`.
    pub phase: u32,
    /// 1 when the wheels are to be blocked.
    pub stop: u32,
    /// `DrivenBy`.
    #[serde(default)]
    pub driven_by: u32,
    /// What decides the outcome, once the robot is connected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged_by: Option<JudgedBy>,
    /// How the run ends, once it is decided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outcome: Option<Outcome>,
    /// Why it ends so.
    #[serde(default)]
    pub reason: String,
    /// Whose samples count, in the order of roles.
    #[serde(default)]
    pub authority: Vec<Right>,
    /// One row per role.
    #[serde(default)]
    pub role: Vec<RoleRow>,
    /// One row per living process, also for candidates and processes that are about to end.
    #[serde(default)]
    pub process: Vec<ProcessRow>,
}

/// [`Authority`] as it stands in the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Right {
    pub incarnation: u32,
    pub previous: u32,
    pub from_scan: u64,
}

/// The history of a role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RoleRow {
    /// The role.
    #[serde(with = "role_name")]
    pub role: Role,
    /// The incarnation that fills it, or did last; 0 before the first.
    pub incarnation: u32,
    /// How often it was started again.
    pub restarts: u32,
    /// How it is started.
    pub entry: ProcessEntry,
}

impl ProcessRegistry {
    /// The newest registry of a system.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    pub(crate) fn read(domain: &Domain) -> anyhow::Result<Self> {
        let registry: Self = read(domain, PROCESSES_FILE)?;
        let entries = registry.role.iter().map(|row| &row.entry);
        for entry in entries.chain(registry.process.iter().map(|row| &row.entry)) {
            entry
                .validate()
                .with_context(|| format!("{PROCESSES_FILE} of {}", domain.directory().display()))?;
        }
        Ok(registry)
    }

    /// Writes the whole file or nothing.
    ///
    /// # Errors
    /// Those of the file system.
    pub(crate) fn write(&self, domain: &Domain) -> anyhow::Result<()> {
        Ok(domain.folder().write(PROCESSES_FILE, text_of(self)?.as_bytes())?)
    }

    /// Whose samples count.
    pub(crate) fn authority(&self) -> [Authority; SLOTS] {
        std::array::from_fn(|index| {
            self.authority.get(index).map_or_else(Authority::default, |right| Authority {
                incarnation: right.incarnation,
                previous: right.previous,
                from_scan: right.from_scan,
            })
        })
    }

    /// The row of a role.
    pub(crate) fn of(&self, role: Role) -> Option<&RoleRow> {
        self.role.iter().find(|row| row.role == role)
    }
}

impl From<&Authority> for Right {
    fn from(authority: &Authority) -> Self {
        let &Authority { incarnation, previous, from_scan } = authority;
        Self { incarnation, previous, from_scan }
    }
}

impl RunFile {
    /// Writes the whole file or nothing.
    ///
    /// # Errors
    /// Those of the file system.
    pub(crate) fn write(&self, domain: &Domain) -> anyhow::Result<()> {
        Ok(domain.folder().write(RUN_FILE, self.text()?.as_bytes())?)
    }

    /// The content of the file.
    ///
    /// # Errors
    /// A path that is no text.
    pub(crate) fn text(&self) -> anyhow::Result<String> {
        let Self { out, lockstep, duration_s, system, scenario } = self;
        let mut table = Table::new();
        table.insert("out".to_owned(), Value::try_from(out)?);
        table.insert("lockstep".to_owned(), (*lockstep).into());
        table.extend(duration_s.map(|time_s| ("duration_s".to_owned(), time_s.into())));
        table.insert("system".to_owned(), system.to_table().into());
        table.insert("scenario".to_owned(), scenario.to_table().into());
        Ok(table.to_string())
    }

    /// Reads the options of a run, and its plan.
    ///
    /// # Errors
    /// A file that is missing or cannot be read.
    pub(crate) fn read(domain: &Domain) -> anyhow::Result<(Self, Plan)> {
        let run: Self = read(domain, RUN_FILE)?;
        let (scenario, system) = (run.scenario.clone(), run.system.clone());
        let none = || OwnTopics {
            run: system.run_settings(run.lockstep),
            topic: Vec::new(),
            companion: Vec::new(),
            also_reads: Vec::new(),
        };
        let own_topics = OwnTopics::of(domain)?.unwrap_or_else(none);
        let plan = Plan { scenario, system, own_topics, warnings: Vec::new(), given: BTreeSet::new() };
        Ok((run, plan))
    }
}

/// Notes how far a drive has come. Without room for it, another orchestrator would continue from what was noted before.
pub(crate) fn note_progress(domain: &Domain, progress: &DriveProgress) {
    let _ = text_of(progress).map(|text| domain.folder().write(PROGRESS_FILE, text.as_bytes()));
}

/// How far a drive had come, where that was noted.
pub(crate) fn noted_progress(domain: &Domain) -> Option<DriveProgress> {
    read(domain, PROGRESS_FILE).ok()
}

/// The system of a run, and whether time is simulated.
///
/// # Errors
/// A run file that is absent or can't be read.
pub fn driven_system(domain: &Domain) -> anyhow::Result<(System, bool)> {
    let (run, _) = RunFile::read(domain)?;
    Ok((run.system, run.lockstep))
}

fn read<T: serde::de::DeserializeOwned>(domain: &Domain, name: &str) -> anyhow::Result<T> {
    let text = domain.folder().read_text(name)?;
    of_text(&text).with_context(|| format!("{}", domain.directory().join(name).display()))
}

#[cfg(test)]
mod tests {
    use runtime::Identity;

    use super::*;

    #[test]
    fn a_registry_is_read_back_as_it_was_written() {
        let domain = Domain::create(&format!("ros{}", std::process::id())).unwrap();
        let entry = ProcessEntry::of(Role::Controller, &["./mine".to_owned(), "--fast".to_owned()]);
        let process_registry = ProcessRegistry {
            generation: 2,
            judged_by: Some(JudgedBy::Estimate),
            outcome: Some(Outcome::Missed),
            reason: "passed \"it\"".to_owned(),
            authority: vec![Right { incarnation: 7, previous: 3, from_scan: 1 << 40 }; 5],
            role: vec![RoleRow { role: Role::Controller, incarnation: 7, restarts: 1, entry: entry.clone() }],
            process: vec![ProcessRow {
                role: Role::Controller,
                identity: Identity::of(&domain, std::process::id(), 7).unwrap(),
                entry,
            }],
            ..ProcessRegistry::default()
        };
        process_registry.write(&domain).unwrap();
        assert_eq!(ProcessRegistry::read(&domain).unwrap(), process_registry);
        assert_eq!(
            process_registry.authority()[4],
            Authority { incarnation: 7, previous: 3, from_scan: 1 << 40 }
        );
        domain.remove().unwrap();
        assert!(ProcessRegistry::read(&domain).is_err());
    }
}
