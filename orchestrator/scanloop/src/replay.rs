//! `scanloop replay`: recomputes a recorded drive and compares it with the recording.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use console::exit::{Exit, Failure};
use console::note;
use replay::{Options, replay as replay_recording};
use shared_types::Role;

use crate::print_json;

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The recording.
    pub file: PathBuf,
    /// Only this stage: robot, estimator, obstacles, controller or actuator; may be repeated.
    #[arg(long, value_name = "ROLE")]
    pub stage: Vec<String>,
    /// The first scan; the stages start from the recorded state nearest before it.
    #[arg(long, value_name = "SCAN")]
    pub from: Option<u64>,
    /// The last scan.
    #[arg(long, value_name = "SCAN")]
    pub to: Option<u64>,
    /// Change a key of a stage, for example `controller.horizon_s=2`; may be repeated. Outputs may then differ within the
    /// bounds of a swap's agreement.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Factor on these bounds.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub tolerance: f64,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Replays a recording.
///
/// # Errors
/// A file, a stage or a key that is not allowed; exit code 2.
pub(crate) fn replay(arguments: &ReplayArguments) -> anyhow::Result<Exit> {
    let ReplayArguments { file, stage, from, to, set, tolerance, json } = arguments;
    let stages = stage.iter().map(|name| name.parse::<Role>()).collect::<Result<_, _>>();
    let stages = stages.map_err(|error| Failure::bad_input(format!("--stage: {error}")))?;
    if !(0.0..=1e6).contains(tolerance) {
        return Err(Failure::bad_input(format!("--tolerance {tolerance} is not allowed: 0 to 1000000")));
    }
    let options = Options { stages, from: *from, to: *to, set: set.clone(), tolerance: *tolerance };
    let started = Instant::now();
    let report = replay_recording(file, &options)?;
    print_json(*json, &report)?;
    let seconds = started.elapsed().as_secs_f64();
    note!(
        "{}: {} scans, {} outputs, {} compared, {} identical, {} skipped, {seconds:.2} s",
        file.display(),
        report.scans,
        report.samples,
        report.compared,
        report.identical,
        report.skipped
    );
    for skipped in &report.reasons {
        note!(
            "skipped {} of {} by process {}: {}",
            skipped.samples,
            skipped.topic,
            skipped.incarnation,
            skipped.reason
        );
    }
    report.differences.iter().for_each(|difference| note!("{difference}"));
    let is_good = if set.is_empty() { report.is_identical() } else { report.beyond == 0 };
    Ok(if is_good { Exit::Done } else { Exit::NotReached })
}
