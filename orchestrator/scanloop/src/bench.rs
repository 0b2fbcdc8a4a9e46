//! `scanloop bench`: repeatable measurements of the parts, on shipped or named inputs.
//!
//! Those that only study the product are in the laboratory, see [`crate::laboratory`].

pub mod latency;
pub mod scheduling;

use clap::Subcommand;
use console::exit::Exit;
use console::note;
use figures::{MEASURED_PROFILE, PROFILE};

use self::latency::LatencyArguments;
use crate::laboratory::{self, StudyArguments};

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Measure the cost of one solve of the optimal control problem, on recorded initial states.
    #[command(disable_help_flag = true)]
    Solver(StudyArguments),
    /// Measure the time from scan to actuation at a given rate, scheduling and load.
    ///
    /// Drives the scenario `endless` in real time. With `--compute none` it sends the same samples through five
    /// processes of the executable `scanloop-lab` that compute nothing. It measures the wake-ups of the machine first.
    /// All times are given corrected and not corrected for coordinated omission (docs/latency.md). Files of `--out`:
    /// `report.json`, `latency.hlog`, `scan_to_actuation.hgrm` (and `_corrected`), `histogram.svg`, `ccdf.svg`,
    /// `trace.json` for ui.perfetto.dev.
    Latency(LatencyArguments),
    /// Compare two builds: whether one is slower, with a confidence interval and the smallest visible difference.
    #[command(disable_help_flag = true)]
    Compare(StudyArguments),
    /// Measure how well courses are driven, compared with the optimum that sees what the robot saw.
    #[command(disable_help_flag = true)]
    Ride(StudyArguments),
    /// Measure how far the estimated pose is from the true one, and whether its covariance says so.
    #[command(disable_help_flag = true)]
    Estimator(StudyArguments),
    /// Measure four hops between five processes over other transports, as ratios to ours.
    #[command(disable_help_flag = true)]
    Transport(StudyArguments),
}

/// Runs one benchmark.
///
/// # Errors
/// Bad files and options, and errors of the benchmark itself.
pub(crate) fn bench(system_id: &str, command: &BenchCommand) -> anyhow::Result<Exit> {
    match command {
        BenchCommand::Latency(arguments) => latency::latency(system_id, arguments),
        BenchCommand::Solver(study) => Err(laboratory::hand_over(system_id, "solver", study)),
        BenchCommand::Compare(study) => Err(laboratory::hand_over(system_id, "compare", study)),
        BenchCommand::Ride(study) => Err(laboratory::hand_over(system_id, "ride", study)),
        BenchCommand::Estimator(study) => Err(laboratory::hand_over(system_id, "estimator", study)),
        BenchCommand::Transport(study) => Err(laboratory::hand_over(system_id, "transport", study)),
    }
}

/// Prints a note when this executable was built with another profile than an installed one.
pub fn warn_of_profile() {
    if PROFILE != MEASURED_PROFILE {
        note!(
            "built with the profile `{PROFILE}`: times of an installed executable are those of \
             `cargo build --profile {MEASURED_PROFILE}`"
        );
    }
}
