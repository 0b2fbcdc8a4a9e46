//! `scanloop record` and `scanloop recording`.

mod import;

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use console::exit::{Exit, Failure};
use console::output::data;
use console::{answer, note};
use recording::info::Info;
use recording::recorder::{RecorderOptions, record as record_system};
use recording::{copy, export};
use runtime::{Shutdown, one_line};
use session::arguments::check_duration;

use self::import::ImportArguments;
use crate::print_json;

/// Arguments of `record`.
#[derive(Debug, Args)]
pub struct RecordArguments {
    /// The recording.
    #[arg(value_name = "FILE", default_value = "recording.mcap")]
    pub file: PathBuf,
    /// Stop after this many seconds; without it at Ctrl-C, or when the system ends.
    #[arg(long, value_name = "S")]
    pub duration: Option<f64>,
    /// Replace a file of that name.
    #[arg(long)]
    pub force: bool,
    /// Print what was recorded as JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Take orders from standard input; `run --record` starts the recorder with this option.
    #[arg(long, hide = true)]
    pub of_run: bool,
    /// Keep so many seconds in memory instead; FILE is then the folder for the files of incidents.
    #[arg(long, value_name = "S", hide = true, requires = "of_run")]
    pub ring: Option<f64>,
}

/// What to do with a recording.
#[derive(Debug, Subcommand)]
pub enum RecordingCommand {
    /// Show what a recording holds.
    Info {
        /// The recording.
        file: PathBuf,
        /// Print JSON to standard output.
        #[arg(long)]
        json: bool,
    },
    /// Make a whole recording of all that can be read of a damaged one, or one that was cut off. Exit code 1 means that
    /// something is missing.
    Repair {
        /// The recording.
        file: PathBuf,
        /// The new recording; without it `NAME-repaired.mcap` beside the old one.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// Replace a file of that name.
        #[arg(long)]
        force: bool,
    },
    /// Copy some seconds of a recording into a new one.
    Cut {
        /// The recording.
        file: PathBuf,
        /// The first second, counted from the start of the recording.
        #[arg(long, value_name = "S", default_value_t = 0.0)]
        from: f64,
        /// The last second.
        #[arg(long, value_name = "S")]
        to: Option<f64>,
        /// The new recording.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Replace a file of that name.
        #[arg(long)]
        force: bool,
    },
    /// Export a recording for other programs.
    #[command(group = clap::ArgGroup::new("form").required(true).multiple(true))]
    Export {
        /// The recording.
        file: PathBuf,
        /// Folder for one table per topic.
        #[arg(long, value_name = "DIR", group = "form")]
        csv: Option<PathBuf>,
        /// Folder for a bag of ROS 2.
        #[arg(long, value_name = "DIR", group = "form")]
        rosbag2: Option<PathBuf>,
        /// Replace files of the same name.
        #[arg(long)]
        force: bool,
    },
    /// Import scans and odometry of another program as a recording.
    ///
    /// Estimator and obstacle detector run over them in simulated time, and what they compute is recorded too, so `replay`, `view`
    /// and `report` read the file. The scanner is described by the first scan; ranges that are NaN, infinite, zero or beyond the
    /// limits of a message are no returns. The stamps of the messages count, and the log time where a stamp is zero or goes back.
    /// What was taken and left out, and why, is printed. Exit code 2 for a file that is none of both or was damaged, and for
    /// bags in SQLite (db3) or of ROS 1, with the program that converts them.
    Import(Box<ImportArguments>),
}

/// Records a running system.
///
/// # Errors
/// A system that does not run, a file that exists; exit code 2. Errors of the bus.
pub(crate) fn record(system_id: &str, arguments: &RecordArguments) -> anyhow::Result<Exit> {
    check_duration(arguments.duration)?;
    let domain = supervision::runs::existing(system_id)?;
    let shutdown = Shutdown::on_signals()?;
    let RecordArguments { file, duration, force, of_run, .. } = arguments;
    let options = RecorderOptions {
        file: file.clone(),
        ring_s: arguments.ring,
        force: *force,
        duration: duration.map(Duration::from_secs_f64),
        of_run: *of_run,
    };
    let summary = record_system(&domain, &options, &shutdown)?;
    let megabytes = summary.bytes as f64 * 1e-6;
    answer!(
        arguments.json,
        "{}: {megabytes:.2} MB, {} samples, {} lost",
        file.display(),
        summary.samples,
        summary.lost
    )?;
    print_json(arguments.json, &summary)?;
    if summary.error.is_empty() {
        return Ok(Exit::Done);
    }
    note!("error: {}: {}; what was written before is readable", file.display(), summary.error);
    Ok(Exit::NotReached)
}

/// Shows, repairs, cuts, exports or imports a recording.
///
/// # Errors
/// A file that can't be read or written; exit code 2.
pub(crate) fn recording(command: &RecordingCommand) -> anyhow::Result<Exit> {
    match command {
        RecordingCommand::Import(arguments) => return import::import(arguments),
        RecordingCommand::Info { file, json } => {
            let info = Info::read(file)?;
            print_json(*json, &info)?;
            if !json {
                data(&info.to_string())?;
            }
        }
        RecordingCommand::Repair { file, out, force } => {
            let out = out.clone().unwrap_or_else(|| repaired(file));
            let copied = copy::repair(file, &out, *force)?;
            for missing in copied.missing() {
                answer!(false, "{missing}")?;
            }
            let state = match (copied.is_loss, copied.gaps.is_empty()) {
                (true, _) => "was damaged or cut off, and is not whole",
                (false, true) => "was complete",
                (false, false) => "was damaged, but nothing of the drive is missing",
            };
            let (messages, files) = (copied.messages, names(&copied.files));
            answer!(false, "{} {state}; {messages} messages in {files}", file.display())?;
            if copied.is_loss {
                return Ok(Exit::NotReached);
            }
        }
        RecordingCommand::Cut { file, from, to, out, force } => {
            let allowed = |seconds: f64| (0.0..=1e6).contains(&seconds);
            if !allowed(*from) || to.is_some_and(|to| !allowed(to) || to < *from) {
                return Err(Failure::bad_input(
                    "--from and --to are seconds: 0 to 1000000, --from before --to",
                ));
            }
            let ns = |seconds: f64| (seconds * 1e9) as u64;
            let copied = copy::copy(file, out, *force, ns(*from)..=to.map_or(u64::MAX, ns))?;
            let (messages, bytes) = (copied.messages, copied.bytes);
            answer!(false, "{}: {messages} messages, {bytes} bytes", names(&copied.files))?;
        }
        RecordingCommand::Export { file, csv, rosbag2, force } => {
            let (tables, bag) = export::export(file, csv.as_deref(), rosbag2.as_deref(), *force)?;
            if let (Some(folder), Some(exported)) = (csv, tables) {
                answer!(false, "{}: {} rows", folder.display(), exported.rows)?;
                if !exported.left_out.is_empty() {
                    let topics = one_line(&exported.left_out.join(", "));
                    let text = format!(
                        "not exported, because their samples are not those of this program: {topics}"
                    );
                    runtime::print(runtime::Priority::Warning, &text);
                }
            }
            if let (Some(folder), Some(messages)) = (rosbag2, bag) {
                answer!(false, "{}: {messages} messages", folder.display())?;
            }
        }
    }
    Ok(Exit::Done)
}

fn names(files: &[PathBuf]) -> String {
    files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn repaired(file: &Path) -> PathBuf {
    let mut name = file.file_stem().unwrap_or_default().to_owned();
    name.push("-repaired.mcap");
    file.with_file_name(name)
}
