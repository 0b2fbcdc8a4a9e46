//! `scanloop why`: why the robot did what it did in one scan of a recorded or running drive.

mod running;

use std::path::{Path, PathBuf};

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use replay::why::{Row, late, slow, stops, why as answer_for};
use replay::{NearDrive, ReplayDrive};

use crate::print_json;

/// Added to the priority: the drive comes before the question.
const NICE: i32 = 10;

/// Arguments of `why`.
#[derive(Debug, Args)]
pub struct WhyArguments {
    /// The recording; without it the running system. A file whose name is a number is `./57`.
    #[arg(value_name = "FILE", required_unless_present_any = ["stops", "slow", "late"], allow_negative_numbers = true)]
    pub file: Option<PathBuf>,
    /// The scan.
    #[arg(value_name = "SCAN", allow_negative_numbers = true)]
    pub scan: Option<String>,
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
    let WhyArguments { file, scan, stops, slow, late, json } = arguments;
    let _ = rustix::process::nice(NICE);
    let (file, scan) = asked(file.as_deref(), scan.as_deref(), *stops || *slow || *late)?;
    let Some(scan) = scan else {
        let drive = match file {
            Some(file) => ReplayDrive::read_one(file)?,
            None => ReplayDrive::read_growing(running::drive(system_id, None)?.path())?,
        };
        return overview(arguments, &drive);
    };
    let mut drive = match file {
        Some(file) => NearDrive::open(file, false)?,
        None => running::drive(system_id, Some(scan))?,
    };
    let why = answer_for(drive.near(scan)?, scan)?;
    print_json(*json, &why)?;
    answer!(*json, "{why}")?;
    Ok(Exit::Done)
}

/// The recording, else the running system is meant, and the scan. A number alone is a scan.
fn asked<'a>(
    file: Option<&'a Path>,
    scan: Option<&str>,
    is_overview: bool,
) -> anyhow::Result<(Option<&'a Path>, Option<u64>)> {
    let number = |text: &str| {
        let refused = || format!("SCAN {text:?} is not allowed: a whole number from 1 to {}", u64::MAX);
        text.parse().ok().filter(|scan| *scan > 0).ok_or_else(|| Failure::bad_input(refused()))
    };
    let is_number = |text: &&str| {
        let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
        !digits.is_empty() && digits.chars().all(|letter| letter.is_ascii_digit())
    };
    let alone = file.and_then(Path::to_str).filter(is_number);
    Ok(match (is_overview, alone, scan) {
        (true, None, None) => (file, None),
        (true, ..) => {
            let reason = "--stops, --slow and --late take a recording, or the running system, and no scan";
            return Err(Failure::bad_input(reason));
        }
        (false, Some(scan), None) => (None, Some(number(scan)?)),
        (false, _, Some(scan)) => (file, Some(number(scan)?)),
        (false, None, None) => {
            let file = file.unwrap_or(Path::new("FILE")).display();
            let reason = format!("{file}: the scan is missing, or one of --stops, --slow and --late");
            return Err(Failure::bad_input(reason));
        }
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
