//! Recomputes a recorded drive, stage by stage, and compares every output with the recorded one.
//!
//! Each process has published a journal before each output: what it took, which times it was told, what its timeouts and
//! its time budget did, and which checkpoints it wrote and continued from. The replay does the same in the same order.
//! So each stage is checked alone, and a difference is reported where it arises. An output that can't be recomputed is
//! counted as skipped, with the reason.
//!
//! Compared are all bytes but those that depend on the clock and on the process: [`compare::NOT_COMPARED`].

mod command;
pub mod compare;
mod drive;
pub mod fork;
mod stage;
pub mod why;

use std::path::Path;
use std::sync::Mutex;

use console::exit::Failure;
use serde::Serialize;
use shared_types::{ROLES, Role};

use crate::compare::FieldDifference;
pub use crate::drive::{NearDrive, ReplayDrive};
use crate::stage::Findings;

/// This many differences are kept; all are counted.
pub const MAX_DIFFERENCES: usize = 20;

/// What is replayed.
#[derive(Debug, Clone, Default)]
pub struct ReplayOptions {
    /// The stages; all when empty.
    pub stages: Vec<Role>,
    /// The first scan.
    pub from: Option<u64>,
    /// The last scan.
    pub to: Option<u64>,
    /// Keys of the stages that are changed: `controller.horizon_s=2`.
    pub set: Vec<String>,
    /// Programs in place of stages, with their arguments. Without `stages`, only these are replayed.
    pub with: Vec<(Role, Vec<String>)>,
    /// Factor on the bounds of the agreement, with changed keys or other programs.
    pub tolerance: f64,
    /// Replay as fast as the drive was recorded, instead of as fast as possible.
    pub in_real_time: bool,
}

/// The result of a replay.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ReplayReport {
    /// Scans in the recording, within the limits.
    pub scans: u64,
    /// Outputs of the stages.
    pub samples: u64,
    /// Outputs that were recomputed.
    pub compared: u64,
    /// Outputs that could not be recomputed.
    pub skipped: u64,
    /// Outputs that are equal to the recorded ones.
    pub identical: u64,
    /// Outputs that an injected fault has changed, or that come from a robot which it has altered; they are not compared.
    pub injected: u64,
    /// Outputs that are beyond the bounds of the agreement, with changed keys or other programs.
    pub beyond: u64,
    /// With changed keys or other programs, how their outputs differ from the recorded ones.
    pub statistics: Vec<StageStatistics>,
    /// The first differences.
    pub differences: Vec<FieldDifference>,
    /// Why outputs were skipped, and how many.
    pub reasons: Vec<Skipped>,
    /// Outputs of scans after the one that decided the outcome, in lock-step; they do not belong to the run.
    pub after_end: u64,
    /// Processes whose outputs are not compared: programs of your own, drivers of devices, and those without journals.
    pub not_compared: Vec<NotCompared>,
    /// Stages that can't be replayed, because samples that they read or write have another layout.
    pub not_replayed: Vec<NotReplayed>,
}

/// A process whose outputs are not compared.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotCompared {
    /// Name of the role.
    pub role: &'static str,
    /// The process.
    pub incarnation: u32,
    /// The driver, or the command that was started; none for a built-in stage without journals.
    pub program: Option<String>,
    /// Whether journals of the process were recorded.
    pub has_journals: bool,
    /// The option with which its command is started again and gets the same inputs; none for a robot.
    pub with: Option<String>,
}

impl std::fmt::Display for NotCompared {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { role, incarnation, program, has_journals, with } = self;
        let program = program.as_deref().unwrap_or("built-in");
        let journals = if *has_journals { "" } else { ", without journals" };
        write!(formatter, "not compared: {role} {incarnation}, {program}{journals}")?;
        with.as_ref().map_or(Ok(()), |with| write!(formatter, "; to compare it: {with}"))
    }
}

/// A stage that can't be replayed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotReplayed {
    /// Name of the role.
    pub role: &'static str,
    /// The fields that differ, with their topic.
    pub fields: Vec<String>,
}

/// How the outputs of one stage differ from the recorded ones, scan by scan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageStatistics {
    /// Name of the role.
    pub role: &'static str,
    /// Scans on which both gave an output.
    pub compared: u64,
    /// Of these, scans on which only one of them drove.
    pub kind_differs: u64,
    /// Replayed minus recorded, quantity by quantity.
    pub differences: Vec<handover::shadow::QuantityDifference>,
}

impl std::fmt::Display for StageStatistics {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { role, compared, kind_differs, differences } = self;
        write!(formatter, "{role}: {compared} scans compared, {kind_differs} of another kind")?;
        differences.iter().try_for_each(|difference| {
            let interval = difference
                .mean_interval
                .map_or_else(String::new, |[low, high]| format!(", 95 % interval {low:.6} to {high:.6}"));
            let handover::shadow::QuantityDifference { quantity, unit, mean, max_abs, .. } = difference;
            write!(formatter, "\n  {quantity}: mean {mean:.6} {unit}{interval}, largest {max_abs:.6} {unit}")
        })
    }
}

/// Outputs that could not be recomputed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Skipped {
    /// Their topic.
    pub topic: &'static str,
    /// The process that published them.
    pub incarnation: u32,
    /// Why.
    pub reason: String,
    /// How many.
    pub samples: u64,
}

impl ReplayReport {
    /// Whether every output that could be recomputed is equal to the recorded one.
    pub fn is_identical(&self) -> bool {
        self.compared > 0 && self.identical == self.compared
    }
}

/// Replays a recording.
///
/// # Errors
/// A file that can't be read, samples of another layout, keys that are not allowed; exit code 2.
pub fn replay(path: &Path, options: &ReplayOptions) -> anyhow::Result<ReplayReport> {
    let wanted = wanted(options);
    let mut report = ReplayReport::default();
    // Recordings that were joined are replayed one after the other.
    for mut drive in ReplayDrive::read(path)? {
        drive.set(&options.set).map_err(|reason| Failure::bad_input(format!("--set {reason}")))?;
        drive.is_changed |= !options.with.is_empty();
        replay_drive(drive, &wanted, path, options, &mut report)?;
    }
    report.differences.sort_by_key(|difference| difference.scan);
    report.differences.truncate(MAX_DIFFERENCES);
    if report.samples == 0 {
        let path = path.display();
        return Err(Failure::bad_input(format!("{path}: no output of these stages is in these scans")));
    }
    Ok(report)
}

/// The stages that the options ask for.
fn wanted(options: &ReplayOptions) -> Vec<Role> {
    let of_programs = options.with.iter().map(|(role, _)| *role);
    match (&options.stages[..], &options.with[..]) {
        ([], []) => Role::ALL.to_vec(),
        ([], _) => of_programs.collect(),
        (stages, _) => stages.iter().copied().chain(of_programs).collect(),
    }
}

/// Replays one drive, and adds what was found to the report.
fn replay_drive(
    mut drive: ReplayDrive,
    wanted: &[Role],
    path: &Path,
    options: &ReplayOptions,
    report: &mut ReplayReport,
) -> anyhow::Result<()> {
    let (stages, not_replayed) = drive.replayable(wanted, path)?;
    if options.in_real_time {
        drive.set_pace(options.from);
    }
    let drive = &drive;
    report.scans += drive.scans(options.from, options.to);
    report.not_replayed.extend(not_replayed);
    // One after the other: each is a system of its own.
    for (role, command) in options.with.iter().filter(|(role, _)| stages.contains(role)) {
        command::replay(*role, command, drive, options)?.add_to(report);
    }
    let is_built_in = |role: &Role| options.with.iter().all(|(other, _)| other != role);
    let built_in: Vec<Role> = stages.into_iter().filter(is_built_in).collect();
    for findings in replay_stages(&built_in, drive, options)? {
        findings?.add_to(report);
    }
    Ok(())
}

/// The stages by what they cost: no processor is idle while the longest one ends.
const BY_COST: [Role; 5] = [Role::Controller, Role::Obstacles, Role::Robot, Role::Estimator, Role::Actuator];

/// Replays stages on as many threads as there are processors; in real time each has its own.
///
/// # Errors
/// A thread that can't be started; then no further stage is begun.
fn replay_stages(
    stages: &[Role],
    drive: &ReplayDrive,
    options: &ReplayOptions,
) -> std::io::Result<Vec<anyhow::Result<Findings>>> {
    let queue = BY_COST.iter().filter(|role| stages.contains(role));
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = if options.in_real_time { stages.len() } else { processors.min(stages.len()) };
    let queue = Mutex::new(queue);
    let work = || {
        let mut found = Vec::new();
        while let Some(role) = queue.lock().ok().and_then(|mut queue| queue.next()) {
            found.push((role.index(), stage::replay(*role, drive, options)));
        }
        found
    };
    let mut found: Vec<_> = std::thread::scope(|scope| -> std::io::Result<_> {
        let start = |_| std::thread::Builder::new().spawn_scoped(scope, work);
        let threads = (0..threads).map(start).collect::<Result<Vec<_>, _>>();
        if threads.is_err() {
            queue.lock().into_iter().for_each(|mut queue| queue.by_ref().for_each(drop));
        }
        let lost = || vec![(ROLES, Err(anyhow::anyhow!("a stage ended with a panic")))];
        Ok(threads?.into_iter().flat_map(|thread| thread.join().unwrap_or_else(|_| lost())).collect())
    })?;
    found.sort_by_key(|(place, _)| *place);
    Ok(found.into_iter().map(|(_, findings)| findings).collect())
}
