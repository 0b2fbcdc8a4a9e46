//! `scanloop why`: why the robot did what it did in one scan of a recorded or running drive.

mod running;

use std::path::PathBuf;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use replay::why::{Row, late, slow, stops, why as answer_for};
use replay::{NearDrive, ReplayDrive};

use crate::print_json;

/// Arguments of `why`.
#[derive(Debug, Args)]
pub struct WhyArguments {
    /// The recording, and the scan. A number alone is a scan of the running system, and nothing is all that it has driven.
    #[arg(value_name = "[FILE] SCAN", num_args = 0..=2, required_unless_present_any = ["stops", "slow", "late"])]
    pub of: Vec<String>,
    /// List the stops instead: the first scan of each, how many scans it lasted, and the reason.
    #[arg(long, group = "overview")]
    pub stops: bool,
    /// List the ten slowest scans instead: the time from the end of the sweep to the actuation [ms], and the slowest stage.
    #[arg(long, group = "overview")]
    pub slow: bool,
    /// List the scans that were answered after the next one was published, or never.
    #[arg(long, group = "overview")]
    pub late: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Answers for one scan, or lists those worth a question.
///
/// # Errors
/// A file or a scan that is not there, and a system that is not recorded; exit code 2.
pub(crate) fn why(system_id: &str, arguments: &WhyArguments) -> anyhow::Result<Exit> {
    let WhyArguments { of, stops, slow, late, json } = arguments;
    let (file, scan) = asked(of, *stops || *slow || *late)?;
    let Some(scan) = scan else {
        let drive = match &file {
            Some(file) => ReplayDrive::read_one(file)?,
            None => ReplayDrive::read_growing(running::drive(system_id, None)?.path())?,
        };
        return overview(arguments, &drive);
    };
    let mut drive = match &file {
        Some(file) => NearDrive::open(file, false)?,
        None => running::drive(system_id, Some(scan))?,
    };
    let why = answer_for(drive.near(scan)?, scan)?;
    print_json(*json, &why)?;
    answer!(*json, "{why}")?;
    Ok(Exit::Done)
}

/// The recording, else the running system is meant, and the scan. What has only digits is a scan; a file of such a name is
/// `./57`.
fn asked(of: &[String], is_overview: bool) -> anyhow::Result<(Option<PathBuf>, Option<u64>)> {
    let refuse = |reason: &str| Err(Failure::bad_input(reason));
    let scan = |text: &str| {
        let refused = || format!("SCAN {text:?} is not allowed: a whole number from 1 to {}", u64::MAX);
        text.parse().ok().filter(|scan| *scan > 0).ok_or_else(|| Failure::bad_input(refused()))
    };
    let is_number = |text: &str| {
        let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
        !digits.is_empty() && digits.chars().all(|letter| letter.is_ascii_digit())
    };
    Ok(match (of, is_overview) {
        ([], true) => (None, None),
        ([file], true) if !is_number(file) => (Some(file.into()), None),
        (_, true) => {
            return refuse("--stops, --slow and --late take a recording, or the running system, and no scan");
        }
        ([one], false) if is_number(one) => (None, Some(scan(one)?)),
        ([file, one], false) => (Some(file.into()), Some(scan(one)?)),
        ([file], false) => {
            return refuse(&format!("{file}: the scan is missing, or one of --stops, --slow and --late"));
        }
        _ => return refuse("the scan is missing, or one of --stops, --slow and --late"),
    })
}

fn overview(arguments: &WhyArguments, drive: &ReplayDrive) -> anyhow::Result<Exit> {
    let rows: Vec<Row> = match arguments {
        WhyArguments { stops: true, .. } => stops(drive),
        WhyArguments { slow: true, .. } if drive.is_in_lockstep() => {
            let reason = "in simulated time nothing is slow; it was recorded in lock-step";
            return Err(Failure::bad_input(format!("{}: {reason}", drive.path().display())));
        }
        WhyArguments { slow: true, .. } => slow(drive),
        _ => late(drive),
    };
    print_json(arguments.json, &rows)?;
    for row in &rows {
        answer!(arguments.json, "scan {:>6} {:>10}  {}", row.scan, row.amount(), row.text)?;
    }
    if rows.is_empty() {
        answer!(arguments.json, "none")?;
    }
    Ok(Exit::Done)
}
