//! `scanloop-lab fork`: a recorded drive, driven on from one of its scans with something changed.
//!
//! [`replay::fork`] leads all processes to that scan by their journals; the simulated loop drives on from there.

mod sweep;

use std::path::{Path, PathBuf};

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use emulator::{Outcome, Referee};
use fault_matrix::PipedStage;
use pipeline::Step;
use replay::compare::FieldDifference;
use replay::fork::{Fork, ForkChange, Repetition};
use replay::{ReplayDrive, ReplayOptions, ReplayReport, replay};
use serde::Serialize;
use shared_types::{AnyStage, Role};

use crate::cores::on_all_cores;
use commands::print_json;
use commands::replay::program;
use sweep::Sweep;

/// Arguments of `fork`.
#[derive(Debug, Args)]
pub(crate) struct ForkArguments {
    /// The recording.
    file: PathBuf,
    /// The scan from which on something is changed.
    #[arg(long, value_name = "SCAN", value_parser = clap::value_parser!(u64).range(1..))]
    at: u64,
    /// Change a key of a stage or of the scenario, for example `controller.horizon_s=2` or `scenario.noise.range_m=0.03`; may
    /// be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Add an obstacle, with keys of `[[obstacle]]`: `shape=circle,x_m=5,y_m=0.2,radius_m=0.1`; may be repeated.
    #[arg(long, value_name = "KEYS")]
    obstacle: Vec<String>,
    /// A program with a stage in place of that of its role: `controller=./mine --fast`; may be repeated for other roles. It
    /// calls `runtime::stage::main`.
    #[arg(long, value_name = "ROLE=COMMAND")]
    with: Vec<String>,
    /// Drive on for so long, if the drive does not end before [s].
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Drive one variant for each of `n` values of a key, evenly from `a` to `b`.
    #[arg(long, value_name = "KEY=a..b/n", conflicts_with = "with")]
    sweep: Option<String>,
    /// Print JSON to standard output.
    #[arg(long)]
    json: bool,
}

/// How a drive went.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Course {
    /// Nothing while it lasts.
    outcome: Option<Outcome>,
    reason: String,
    scans: u64,
    time_s: f64,
    min_clearance_m: f64,
    path_length_m: f64,
}

/// A drive that was driven on.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Forked {
    /// The key that was swept, with its value.
    set: Option<String>,
    /// The scan at which it was left; none where nothing in it becomes different.
    scan: Option<u64>,
    /// The first output that is another than in the recording.
    parts: Option<FieldDifference>,
    driven: Course,
    #[serde(flatten)]
    repetition: Repetition,
    /// The estimator had fields of a topic of your own, which were left out.
    lacks_own_topic: bool,
}

/// The answer of the command.
#[derive(Debug, Serialize)]
struct ForkReport {
    at: u64,
    lockstep: bool,
    recorded: Course,
    forks: Vec<Forked>,
}

/// Drives on; exit code 1 if nothing was changed and the drive does not repeat its recording.
///
/// # Errors
/// A recording, a scan, a key or a program that is not allowed; exit code 2.
pub(crate) fn fork(arguments: &ForkArguments) -> anyhow::Result<Exit> {
    let ForkArguments { file, at, set, obstacle, with, duration, sweep, json } = arguments;
    if let Some(seconds) = duration.filter(|seconds| !(0.1..=1e6).contains(seconds)) {
        return Err(Failure::bad_input(format!("--duration {seconds} is not allowed: 0.1 to 1000000")));
    }
    let drive = ReplayDrive::read_one(file)?;
    let sweep = sweep.as_deref().map(str::parse::<Sweep>).transpose();
    let sweep = sweep.map_err(|reason| Failure::bad_input(format!("--sweep {reason}")))?;
    let variants = sweep.map_or_else(|| vec![None], |sweep| sweep.settings().map(Some).collect());
    let one = |index: usize| {
        let variant: &Option<String> = &variants[index];
        let set: Vec<String> = set.iter().chain(variant).cloned().collect();
        let change = ForkChange::new(&drive, *at, &set, obstacle)?;
        drive_on(&drive, &change, with, *duration, variant.clone())
    };
    let mut forks =
        on_all_cores(variants.len(), one, || ())?.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    let is_changed = !(set.is_empty() && obstacle.is_empty() && with.is_empty() && arguments.sweep.is_none());
    if let Some(followed) = forks.first_mut().filter(|followed| !is_changed && followed.scan.is_none()) {
        followed.follow(file, *at)?;
    }
    let report = ForkReport { at: *at, lockstep: drive.is_in_lockstep(), recorded: recorded(&drive)?, forks };
    print_json(*json, &report)?;
    answer!(*json, "{}", text(&report, &file.display().to_string(), is_changed))?;
    let repeats = |forked: &Forked| forked.repetition.identical == forked.repetition.compared;
    Ok(if is_changed || report.forks.iter().all(repeats) { Exit::Done } else { Exit::NotReached })
}

impl Forked {
    /// Compares a drive in real time with what its journals give from a scan on.
    fn follow(&mut self, file: &Path, at: u64) -> anyhow::Result<()> {
        let ReplayReport { compared, identical, differences, .. } =
            replay(file, &ReplayOptions { from: Some(at), ..ReplayOptions::default() })?;
        let first_difference = differences.into_iter().next();
        self.parts.clone_from(&first_difference);
        self.repetition = Repetition { compared, identical, first_difference };
        Ok(())
    }
}

/// Drives on from where a change makes an output another one.
fn drive_on(
    drive: &ReplayDrive,
    change: &ForkChange,
    with: &[String],
    duration_s: Option<f64>,
    set: Option<String>,
) -> anyhow::Result<Forked> {
    let product = if with.is_empty() { PathBuf::new() } else { crate::faults::product()? };
    let programs = with.iter().map(|text| program(text, &product)).collect::<Result<Vec<_>, _>>();
    let programs = programs.map_err(|reason| Failure::bad_input(format!("--with {reason}")))?;
    let replaced: Vec<Role> = programs.iter().map(|(role, _)| *role).collect();
    let Some(fork) = Fork::find(drive, change, &replaced)? else {
        let (driven, repetition) = (recorded(drive)?, Repetition::default());
        return Ok(Forked { set, scan: None, parts: None, driven, repetition, lacks_own_topic: false });
    };
    let (mut stages, mut kept): (Vec<Box<dyn AnyStage>>, Vec<PipedStage>) = (Vec::new(), Vec::new());
    for (role, command) in &programs {
        let refuse = |reason| Failure::bad_input(format!("--with {role}={}: {reason}", command.join(" ")));
        let start = PipedStage::start(command, *role, change.settings_of(*role)?, drive.period_ns());
        let mut stage = start.map_err(refuse)?;
        if let Some((_, state)) = fork.states.iter().find(|(of, _)| of == role) {
            stage.resume(state).map_err(refuse)?;
        }
        stages.push(stage.copy());
        kept.push(stage);
    }
    let mut forked = Forked {
        set,
        scan: Some(fork.scan),
        parts: fork.parts.clone(),
        driven: Course::default(),
        repetition: Repetition::default(),
        lacks_own_topic: fork.lacks_own,
    };
    let mut referee = Referee::new(&fork.scenario);
    let mut begun_s = 0.0;
    for (truth, actuation) in drive.truths(fork.scan - 1) {
        begun_s = truth.time_s;
        if let Some(outcome) = referee.observe(truth, actuation) {
            let (scan, at) = (truth.header.scan_id, fork.scan);
            return Err(Failure::bad_input(format!(
                "--at {at}: the drive had ended at scan {scan}, {outcome}"
            )));
        }
    }
    let (mut simulation, orders) = fork.into_loop(stages);
    let (mut orders, mut step) = (orders.into_iter().peekable(), Box::<Step>::default());
    while forked.driven.outcome.is_none()
        && duration_s.is_none_or(|limit_s| step.truth.time_s < begun_s + limit_s)
    {
        simulation.move_on();
        while let Some((_, order)) = orders.next_if(|(scan, _)| *scan <= simulation.next_scan()) {
            simulation.order(&order);
        }
        simulation.measure(&mut *step);
        simulation.settle(&mut *step);
        forked.repetition.add(drive, &step);
        forked.driven.outcome = referee.observe(&step.truth, step.actuation.as_ref());
        forked.driven.note(&step.truth);
    }
    if let Some(reason) = kept.iter().find_map(PipedStage::failure) {
        return Err(Failure::process(format!("--with: {reason}")));
    }
    referee.reason().clone_into(&mut forked.driven.reason);
    forked.parts = forked.parts.or_else(|| forked.repetition.first_difference.clone());
    Ok(forked)
}

/// How the recorded drive went.
fn recorded(drive: &ReplayDrive) -> anyhow::Result<Course> {
    let mut referee = Referee::new(&drive.scenario()?);
    let mut course = Course::default();
    for (truth, actuation) in drive.truths(drive.last_scan()) {
        course.note(truth);
        course.outcome = referee.observe(truth, actuation);
        if course.outcome.is_some() {
            break;
        }
    }
    referee.reason().clone_into(&mut course.reason);
    Ok(course)
}

impl Default for Course {
    fn default() -> Self {
        let (outcome, reason) = (None, String::new());
        Self { outcome, reason, scans: 0, time_s: 0.0, min_clearance_m: 0.0, path_length_m: 0.0 }
    }
}

impl Course {
    fn note(&mut self, truth: &shared_types::Truth) {
        self.scans = truth.header.scan_id;
        (self.time_s, self.min_clearance_m) = (truth.time_s, truth.min_clearance_m);
        self.path_length_m = truth.path_length_m;
    }

    fn row(&self) -> String {
        let Self { outcome, scans, time_s, min_clearance_m, path_length_m, .. } = self;
        let outcome = outcome.map_or("drives", |outcome| outcome.name());
        let nearest = if *min_clearance_m < report::NO_OBSTACLE_M {
            format!("{min_clearance_m:.3}")
        } else {
            "-".to_owned()
        };
        format!("{outcome:<10} {scans:>6} {time_s:>8.1} {path_length_m:>8.2} {nearest:>10}")
    }
}

fn text(report: &ForkReport, file: &str, is_changed: bool) -> String {
    let ForkReport { at, lockstep, recorded, forks } = report;
    let width =
        forks.iter().filter_map(|forked| forked.set.as_ref()).map(String::len).max().unwrap_or(0).max(9);
    let mut text = format!(
        "{file}: scan {at} of {}, {}\n{:width$} {:>6} outcome     scans   time_s    way_m  nearest_m\n{:width$} {:>6} {}\n",
        recorded.scans,
        if *lockstep { "in lock-step" } else { "in real time" },
        "",
        "parts",
        "recorded",
        "",
        recorded.row()
    );
    for Forked { set, parts, driven, .. } in forks {
        let scan = parts.as_ref().map_or_else(|| "never".to_owned(), |parts| parts.scan.to_string());
        text += &format!("{:width$} {scan:>6} {}\n", set.as_deref().unwrap_or("driven on"), driven.row());
    }
    let [forked] = &forks[..] else { return text };
    let Forked { scan, parts, driven, repetition, lacks_own_topic, .. } = forked;
    match (scan, parts) {
        (_, Some(parts)) => text += &format!("parts at {parts}\n"),
        (None, None) => text += "no output of the recording becomes another one\n",
        (Some(_), None) => {}
    }
    if !is_changed {
        let Repetition { compared, identical, .. } = repetition;
        text += &format!("{identical} of {compared} outputs repeat the recording to the bit\n");
    }
    if *lacks_own_topic {
        text += "the estimator drives on without the topic of your own that was recorded\n";
    }
    if !driven.reason.is_empty() {
        text += &format!("{}\n", driven.reason);
    }
    text
}
