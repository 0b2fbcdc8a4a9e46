//! Arguments of `run` and `adopt`, and the checks that other commands share.

use std::path::PathBuf;

use clap::Args;
use console::exit::Failure;
use console::new_file::make_folder;
use console::output::require_writable;
use plan::Choice;

/// Arguments of `run`.
#[derive(Debug, Args, Default)]
pub struct RunArguments {
    /// Scenario file, or name of a shipped scenario (`scanloop check --list` prints them); without it `corridor`.
    #[arg(value_name = "SCENARIO")]
    pub scenario: Option<String>,
    /// Scenario and system.
    #[command(flatten)]
    pub choice: Choice,
    /// Results, end and progress.
    #[command(flatten)]
    pub common: CommonArguments,
    /// Simulate time: as fast as the machine allows, no sample lost, repeatable to the last bit.
    #[arg(long)]
    pub lockstep: bool,
    /// Record the drive, by default into `recording.mcap` in the folder of the report, where it replaces an earlier one.
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    pub record: Option<Option<PathBuf>>,
    /// Show the run as `scanloop top` does; what is printed meanwhile follows when the view ends. Ctrl-C ends the run, `q`
    /// the view only.
    #[arg(long, conflicts_with_all = ["quiet", "adopt", "adopt_or_start"])]
    pub top: bool,
    /// Serve the live page of the run on 127.0.0.1, as `scanloop view` does; `--view=PORT` takes another port, 0 any free one.
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "7117")]
    pub view: Option<u16>,
    /// Let `scanloop inject` cause faults in this run; with the emulated robot only.
    #[arg(long, conflicts_with_all = ["lockstep", "adopt"])]
    pub allow_inject: bool,
    /// Take over the orphaned processes of a run whose orchestrator died; scenario and system are those of that run.
    #[arg(long, conflicts_with_all = ["scenario", "system", "calibration", "seed", "overrides", "lockstep", "record"])]
    pub adopt: bool,
    /// Adopt orphaned processes if there are any, else start a run; for a service manager.
    #[arg(long, conflicts_with = "adopt")]
    pub adopt_or_start: bool,
}

/// Arguments that `run` and `adopt` share.
#[derive(Debug, Args, Clone, Default)]
pub struct CommonArguments {
    /// Folder for `report.json`, the picture and the logs; default `out/SCENARIO`, of an adopted run its own.
    #[arg(long, value_name = "DIR", value_parser = console::output::folder())]
    pub out: Option<PathBuf>,
    /// Replace files in the folder that this program did not write: `report.json`, `drive.svg`.
    #[arg(long)]
    pub force: bool,
    /// End the run after this many driven seconds since its start, as `timeout`.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Print no progress.
    #[arg(long)]
    pub quiet: bool,
}

/// Checks `--duration`.
///
/// # Errors
/// A time that is not allowed; exit code 2.
pub fn check_duration(duration_s: Option<f64>) -> anyhow::Result<()> {
    match duration_s {
        Some(duration_s) if !(duration_s > 0.0 && duration_s <= 1e6) => Err(Failure::bad_input(format!(
            "--duration {duration_s} is not allowed: above 0, up to 1000000 s"
        ))),
        _ => Ok(()),
    }
}

/// Makes the folder of the results; returns its absolute path.
///
/// # Errors
/// A folder that can't be made; exit code 2.
pub fn out_folder(out: PathBuf) -> anyhow::Result<PathBuf> {
    if std::path::absolute(&out).is_ok_and(|path| path.to_str().is_none()) {
        let out = out.display();
        return Err(Failure::bad_input(format!(
            "--out {out}: the path of the folder is not UTF-8; name another one"
        )));
    }
    if let Err(reason) = require_writable(&out) {
        return Err(Failure::bad_input(format!("--out {}: {reason}", out.display())));
    }
    let made = make_folder(&out).and_then(|()| std::path::absolute(&out));
    made.map_err(|error| Failure::bad_input(format!("--out {}: {error}", out.display())))
}
