//! `scanloop bench`: repeatable measurements of the parts, on shipped or named inputs.
//!
//! Programs that are only needed for measurements are in another executable, see `instrument`.

pub mod compare;
mod instrument;
pub mod latency;
pub mod ride;
pub mod scheduling;
pub mod solver;

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use console::exit::Exit;
use console::note;
use figures::{MEASURED_PROFILE, PROFILE};

use self::compare::CompareArguments;
use self::latency::LatencyArguments;
use self::ride::RideArguments;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Measure the cost of one solve of the optimal control problem, on recorded initial states.
    ///
    /// For each Hessian, each QP solver and each number of intervals it reports median, 99th percentile and maximum of
    /// the time per SQP step, feedback phase and converged solve [us]. It also reports iterations, failures and heap
    /// allocations per solve. The weights are those of an earlier comparison of solvers (docs/solver.md), not those of
    /// a run. The feedback phase is the work that remains when the measured state arrives: move the linearised model to
    /// it, condense, solve one quadratic program.
    ///
    /// JSON keys: `cases`, `laps`, `start` (`warm` or `cold`), `solvers` with `name`, `hessian`, `refine`, `n`, `layout`,
    /// `cases` (measured ones), `converged`, `failed`, `step_us`, `feedback_us`, `solve_us`, `iterations`, `allocations`
    /// (null without the executable `scanloop-bench`, which counts them and runs this bench if it exists); `profile`;
    /// `growth` with the fits of cost over N; with `--peer` also `about_peers`, `peers` with `ratio_p50`, `ratio_p99`,
    /// `same`, `others`; `skipped`.
    Solver(SolverArguments),
    /// Measure the time from scan to actuation at a given rate, scheduling and load.
    ///
    /// Drives the scenario `endless` in real time. With `--compute none` it sends the same samples through five
    /// processes of the executable `scanloop-bench` that compute nothing. It measures the wake-ups of the machine first.
    /// All times are given corrected and not corrected for coordinated omission (docs/latency.md). Files of `--out`:
    /// `report.json`, `latency.hlog`, `scan_to_actuation.hgrm` (and `_corrected`), `histogram.svg`, `ccdf.svg`,
    /// `trace.json` for ui.perfetto.dev.
    ///
    /// JSON keys: `rate_hz`, `duration_s`, `published`, `commanded`, `late`, `lost`, `unaccounted`, `residual`, `faults`,
    /// `complete_chains`, `scan_to_actuation_us`, `scan_to_actuation_corrected_us`, `data_age_us`, `transport_us`,
    /// `stages_us`, `hops_us`, `publications_us`, `robot_lateness_us`, `wake_up_noise_us`, `stamps_us_per_stage`,
    /// `smallest_visible_us`, `machine`, `profile`, `intervals` (lines of a HdrHistogram log), and the arguments.
    Latency(LatencyArguments),
    /// Compare two builds: whether one is slower, with a confidence interval and the smallest visible difference.
    ///
    /// The input is two files of `bench latency --json`, or two commands that run in turns. Commands print JSON with
    /// the figure that `--metric` names; with `--metric wall` their run time is compared. JSON keys: `metric`, `a`,
    /// `b`, `difference`, `interval`, `confidence`, `verdict` (`no difference`, or how B compares with A: `slower` or
    /// `faster` for times, `higher` or `lower` for other figures), `smallest_visible`, `rounds_to_settle` and
    /// `metric_to_settle` (for `no difference`: the rounds or the metric that would show one, or null), `text`,
    /// `others`.
    Compare(CompareArguments),
    /// Measure how well courses are driven, compared with the optimum that sees what the robot saw.
    ///
    /// The drives run in one process, in simulated time, on all cores. The regret is the objective J of the drive over that
    /// of the optimum; J has fixed weights (docs/ride.md). Exit code 1 if a regret is below 0.99: then the bench is wrong.
    ///
    /// JSON keys: `rows` with `name`, `seed`, `family`, `outcome`, `regret` (null if the goal was not reached), `driven` and
    /// `optimum` (keys of `ride` in `report.json`), `note`; `summary` with `courses`, `regret`, `families`, `second_difference_ratio`,
    /// `steering_step_max_rad`, `clearance_loss_m`, `time_loss_s` (each with `mean`, `p95`, `max`), `clear_objective_max`, `worst`; `faults`.
    Ride(RideArguments),
    /// Measure four hops between five processes over other transports, as ratios to ours.
    ///
    /// The executable `scanloop-bench` runs this bench; `scanloop bench transport --help` shows its arguments once that
    /// is built.
    #[command(disable_help_flag = true)]
    Transport {
        /// Arguments of the bench.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
        arguments: Vec<OsString>,
    },
    /// Measure what companions and topics of your own cost: 5 to 50 processes, 10 to 100 topics, 1 to 24 readers, samples
    /// of 64 B to 4 MB.
    ///
    /// The executable `scanloop-bench` runs this bench; `scanloop bench scale --help` shows its arguments once that is built.
    #[command(disable_help_flag = true)]
    Scale {
        /// Arguments of the bench.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
        arguments: Vec<OsString>,
    },
}

/// Arguments of `bench solver`.
#[derive(Debug, Args)]
pub struct SolverArguments {
    /// Initial states, a CSV file with a header; without it the shipped ones.
    ///
    /// Columns are found by name: `x1` to `x5` are sideslip, yaw, yaw rate, x and y. The columns `goal_x_m`, `goal_y_m`,
    /// `obstacle_x_m`, `obstacle_y_m`, `obstacle_a_m` and `obstacle_b_m` are optional (default: goal (10, 0), ellipse at
    /// (5, 0.1) with semi-axes 1.2 and 0.8); others are ignored. Consecutive rows with the same `lap` are 0.1 s apart and
    /// start from the previous solution; rows without `lap` start straight ahead.
    #[arg(long, value_name = "CSV")]
    pub cases: Option<PathBuf>,
    /// Solve the same cases also with CasADi, in turns, and print ratios (`benches/peers/setup.sh` installs it).
    #[arg(long)]
    pub peer: bool,
    /// Numbers of intervals N; peers are compared with N = 6.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_values_t = [6, 12, 24, 48, 96],
          value_parser = clap::value_parser!(u8).range(1..=200))]
    pub intervals: Vec<u8>,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// Runs one benchmark.
///
/// # Errors
/// Bad files and options, and errors of the benchmark itself.
pub(crate) fn bench(system_id: &str, command: &BenchCommand) -> anyhow::Result<Exit> {
    match command {
        BenchCommand::Solver(arguments) => match instrument::find() {
            Ok(_) => Err(instrument::hand_over()),
            Err(_) => solver::solver(arguments, None),
        },
        BenchCommand::Latency(arguments) => latency::latency(system_id, arguments),
        BenchCommand::Compare(arguments) => compare::compare(arguments),
        BenchCommand::Ride(arguments) => ride::ride(arguments),
        BenchCommand::Transport { .. } | BenchCommand::Scale { .. } => Err(instrument::hand_over()),
    }
}

/// Replaces this process by the instrument if `name` is one of its services; returns when that fails.
pub(crate) fn measuring_service(name: &str) -> Option<anyhow::Error> {
    let is_measuring = name == "hop" || name == "load" || name.starts_with(latency::echo::PREFIX);
    is_measuring.then(instrument::hand_over)
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
