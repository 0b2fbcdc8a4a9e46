//! `scanloop campaign`: drives many random courses through the pipeline, and lists those that went wrong.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context;
use console::exit::Exit;
use console::note;
use console::progress::Steps;
use emulator::course::{Family, of_campaign};
use emulator::{Outcome, Scenario, feasible};
use pipeline::{Settings, WayToRest};
use report::NO_OBSTACLE_M;
use serde::Serialize;

use crate::cli::CampaignArguments;
use crate::cores::on_all_cores;
use crate::print_json;

/// How one course ended.
#[derive(Debug, Clone)]
struct CourseRun {
    seed: u64,
    family: Family,
    passable: bool,
    outcome: Outcome,
    reason: String,
    time_s: f64,
    min_clearance_m: f64,
    /// Smallest clearance on a way to rest.
    min_rest_clearance_m: f64,
    /// Scans without a way to rest that keeps clear.
    without_rest: u64,
}

/// A course with a wrong outcome.
#[derive(Debug, Clone, Serialize)]
struct BadCourse {
    seed: u64,
    family: &'static str,
    outcome: Outcome,
    reason: String,
    scenario: PathBuf,
}

/// The result of a campaign.
#[derive(Debug, Clone, Default, Serialize)]
struct Summary {
    runs: u64,
    reached: u64,
    missed: u64,
    stopped: u64,
    timeout: u64,
    collision: u64,
    passable: u64,
    passable_reached: u64,
    blocked: u64,
    blocked_stopped: u64,
    min_clearance_m: f64,
    min_rest_clearance_m: f64,
    without_rest: u64,
    time_to_goal_s: BTreeMap<&'static str, f64>,
    families: BTreeMap<&'static str, BTreeMap<&'static str, u64>>,
    bad: Vec<BadCourse>,
}

/// Drives the courses and prints how they ended; exit code 3 when one collided, 1 when another was bad or a scan had no way
/// to rest without contact.
///
/// # Errors
/// Errors of the file system.
pub(crate) fn campaign(arguments: &CampaignArguments) -> anyhow::Result<Exit> {
    let runs = drive_all(arguments)?;
    let summary = summarise(&runs, arguments)?;
    note!("{}", text(&summary));
    print_json(arguments.json, &summary)?;
    Ok(match (summary.collision, summary.bad.is_empty()) {
        (0, true) => Exit::Done,
        (0, false) => Exit::NotReached,
        _ => Exit::Collision,
    })
}

fn drive_all(arguments: &CampaignArguments) -> anyhow::Result<Vec<CourseRun>> {
    let mut steps = Steps::new(arguments.runs, "courses");
    let seed = |index: usize| arguments.seed.wrapping_add(index as u64);
    let runs = on_all_cores(usize::try_from(arguments.runs)?, |index| drive(seed(index)), || steps.step(""));
    let mut runs = runs.into_iter().collect::<anyhow::Result<Vec<CourseRun>>>()?;
    runs.sort_by_key(|run| run.seed);
    Ok(runs)
}

fn drive(seed: u64) -> anyhow::Result<CourseRun> {
    let (family, scenario) = of_campaign(seed);
    let passable = feasible::passable(&scenario);
    let (mut time_s, mut min_clearance_m) = (0.0, NO_OBSTACLE_M);
    let settings = Settings::of(scenario);
    let (mut rest, mut min_rest_clearance_m, mut without_rest) =
        (WayToRest::new(&settings), NO_OBSTACLE_M, 0);
    let drive = pipeline::drive(&settings, |step| {
        (time_s, min_clearance_m) = (step.truth.time_s, step.truth.min_clearance_m);
        let clearance_m = rest.clearance(&step.truth);
        min_rest_clearance_m = min_rest_clearance_m.min(clearance_m);
        without_rest += u64::from(clearance_m <= 0.0);
    })?;
    Ok(CourseRun {
        seed,
        family,
        passable,
        outcome: drive.outcome,
        reason: drive.reason,
        time_s,
        min_clearance_m,
        min_rest_clearance_m,
        without_rest,
    })
}

fn summarise(runs: &[CourseRun], arguments: &CampaignArguments) -> anyhow::Result<Summary> {
    let mut summary = Summary {
        runs: runs.len() as u64,
        min_clearance_m: NO_OBSTACLE_M,
        min_rest_clearance_m: NO_OBSTACLE_M,
        ..Summary::default()
    };
    let mut times: Vec<f64> = Vec::new();
    for run in runs {
        match run.outcome {
            Outcome::Reached => summary.reached += 1,
            Outcome::Missed => summary.missed += 1,
            Outcome::Stopped => summary.stopped += 1,
            Outcome::Collision => summary.collision += 1,
            Outcome::Timeout | Outcome::Interrupted | Outcome::Failed => summary.timeout += 1,
        }
        summary.min_clearance_m = summary.min_clearance_m.min(run.min_clearance_m);
        summary.min_rest_clearance_m = summary.min_rest_clearance_m.min(run.min_rest_clearance_m);
        summary.without_rest += run.without_rest;
        *summary.families.entry(run.family.name()).or_default().entry(run.outcome.name()).or_default() += 1;
        if run.outcome == Outcome::Reached {
            times.push(run.time_s);
        }
        let bad = match run.family {
            Family::Plain | Family::Symmetric if run.passable => {
                summary.passable += 1;
                summary.passable_reached += u64::from(run.outcome == Outcome::Reached);
                run.outcome != Outcome::Reached
            }
            Family::Blocked if !run.passable => {
                summary.blocked += 1;
                summary.blocked_stopped += u64::from(run.outcome == Outcome::Stopped);
                run.outcome != Outcome::Stopped
            }
            // For obstacles that appear late or move, passing and stopping are both right.
            _ => !matches!(run.outcome, Outcome::Reached | Outcome::Stopped),
        };
        if bad || run.without_rest > 0 {
            summary.bad.push(save(run, arguments)?);
        }
    }
    times.sort_by(f64::total_cmp);
    if let (Some(first), Some(last)) = (times.first(), times.last()) {
        summary.time_to_goal_s =
            BTreeMap::from([("min", *first), ("p50", times[times.len() / 2]), ("max", *last)]);
    }
    Ok(summary)
}

/// Writes the scenario of a bad course, so that `scanloop run FILE` repeats it.
fn save(run: &CourseRun, arguments: &CampaignArguments) -> anyhow::Result<BadCourse> {
    let (family, scenario): (Family, Scenario) = of_campaign(run.seed);
    std::fs::create_dir_all(&arguments.out).with_context(|| format!("--out {}", arguments.out.display()))?;
    let path = arguments.out.join(format!("{}.toml", scenario.name));
    std::fs::write(&path, scenario.to_toml()).with_context(|| format!("{}", path.display()))?;
    let CourseRun { seed, outcome, ref reason, without_rest, .. } = *run;
    let reason = match without_rest {
        0 => reason.clone(),
        scans => format!("{reason}, {scans} scans without a way to rest"),
    };
    Ok(BadCourse { seed, family: family.name(), outcome, reason, scenario: path })
}

fn text(summary: &Summary) -> String {
    let Summary { runs, reached, missed, stopped, timeout, collision, .. } = summary;
    let mut text = format!(
        "courses         {runs}: {reached} reached, {stopped} stopped, {missed} missed, {timeout} timeout, {collision} collision\n"
    );
    let _ = writeln!(text, "passable        {} of {} reached", summary.passable_reached, summary.passable);
    let _ = writeln!(text, "closed          {} of {} stopped", summary.blocked_stopped, summary.blocked);
    let _ = writeln!(text, "clearance       smallest {:.3} m", summary.min_clearance_m);
    let _ = writeln!(
        text,
        "way to rest     smallest clearance {:.3} m, {} scans without one",
        summary.min_rest_clearance_m, summary.without_rest
    );
    for (family, outcomes) in &summary.families {
        let counts: Vec<String> =
            outcomes.iter().map(|(outcome, count)| format!("{count} {outcome}")).collect();
        let _ = writeln!(text, "  {family:<13} {}", counts.join(", "));
    }
    for BadCourse { seed, family, outcome, reason, scenario } in &summary.bad {
        let _ = writeln!(
            text,
            "bad             seed {seed} ({family}): {outcome}, {reason}; scanloop run --lockstep {}",
            scenario.display()
        );
    }
    text
}
