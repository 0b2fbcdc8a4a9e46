//! `scanloop why`: why the robot did what it did in one scan of a recorded drive.

use std::path::PathBuf;

use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use replay::ReplayDrive;
use replay::why::{Row, Why, late, slow, stops, why as answer_for};

use crate::print_json;

/// Arguments of `why`.
#[derive(Debug, Args)]
pub struct WhyArguments {
    /// The recording.
    pub file: PathBuf,
    /// The scan.
    #[arg(required_unless_present_any = ["stops", "slow", "late"])]
    pub scan: Option<u64>,
    /// List the stops instead: the first scan of each, how many scans it lasted, and the reason.
    #[arg(long, group = "overview", conflicts_with = "scan")]
    pub stops: bool,
    /// List the ten slowest scans instead: the time from the end of the sweep to the actuation [ms], and the slowest stage.
    #[arg(long, group = "overview", conflicts_with = "scan")]
    pub slow: bool,
    /// List the scans that were answered after the next one was published, or never.
    #[arg(long, group = "overview", conflicts_with = "scan")]
    pub late: bool,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Answers for one scan, or lists those worth a question.
///
/// # Errors
/// A file or a scan that is not there; exit code 2.
pub(crate) fn why(arguments: &WhyArguments) -> anyhow::Result<Exit> {
    let WhyArguments { file, scan, json, .. } = arguments;
    let drive = ReplayDrive::read_one(file)?;
    let Some(scan) = *scan else { return overview(arguments, &drive) };
    let why = answer_for(&drive, scan)?;
    print_json(*json, &why)?;
    answer!(*json, "{}", text(&why))?;
    Ok(Exit::Done)
}

fn overview(arguments: &WhyArguments, drive: &ReplayDrive) -> anyhow::Result<Exit> {
    let rows: Vec<Row> = match arguments {
        WhyArguments { stops: true, .. } => stops(drive),
        WhyArguments { slow: true, .. } if drive.is_in_lockstep() => {
            let reason = "in simulated time nothing is slow; it was recorded in lock-step";
            return Err(Failure::bad_input(format!("{}: {reason}", arguments.file.display())));
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

/// One screen.
fn text(why: &Why) -> String {
    let mut text = format!("scan {}\n", why.scan);
    for (index, sentence) in why.sentences.iter().enumerate() {
        let is_next = index > 0 && why.sentences[index - 1].about == sentence.about;
        let about = if is_next { "" } else { sentence.about };
        text += &format!("{about:<10} {}\n", sentence.text);
    }
    text
}
