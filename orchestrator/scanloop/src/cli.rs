//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use conformance::ConformanceArguments;
use plan::Choice;
use session::arguments::{AdoptArguments, RunArguments};

use crate::analyse::AnalyseCommand;
use crate::bench::BenchCommand;
use crate::calibrate::CalibrateArguments;
use crate::shadow::ShadowArguments;
use crate::swap::SwapArguments;
use crate::types::TypesArguments;

/// Autonomous driving that closes the loop within one laser scan.
#[derive(Debug, Parser)]
#[command(name = "scanloop", version, max_term_width = 100)]
pub struct Cli {
    /// Which system on this machine is meant: 1 to 16 letters, digits or `-`.
    #[arg(long, global = true, value_name = "NAME", env = runtime::SYSTEM_ID_VARIABLE, default_value = "default")]
    pub system_id: String,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start all processes, drive a scenario, stop everything, print a summary.
    ///
    /// When an earlier run of this system lost its orchestrator and still drives, its wheels are blocked and its
    /// processes end first; `--adopt` takes them over instead.
    Run(RunArguments),
    /// Take over the processes of a run whose orchestrator died, while they drive; the same as `run --adopt`.
    ///
    /// They are told by process id, start time, system and incarnation; a stranger is never touched. Exit code 2 when
    /// there is nothing to adopt.
    Adopt(AdoptArguments),
    /// Validate scenario and system files and print the graph of processes and topics.
    Check(CheckArguments),
    /// Show the processes of a running system.
    Status {
        /// Print JSON to standard output.
        #[arg(long)]
        json: bool,
    },
    /// Block the wheels of a running system and end all its processes.
    ///
    /// Returns within a second, whether the orchestrator answers, hangs or is gone. Exit code 0: the block is acknowledged;
    /// 4: it is not confirmed, and what still lives is listed. Rest follows by v / a; the processes end meanwhile. A stop is
    /// never taken back: `run` starts the system anew. This does not replace a hardware emergency stop.
    Stop(StopArguments),
    /// Start one process of a running system again, without losing a scan.
    ///
    /// The new process takes over from one that works and only then the old one ends; exit code 1 when the new one does
    /// not come up, and the old one keeps driving. A process that does not work is ended first.
    Restart {
        /// robot, estimator, obstacles, controller or actuator.
        role: String,
    },
    /// Exchange one process of a running system for another, without losing a scan.
    ///
    /// The new process computes beside the old one until it has agreed with it for some scans, takes over at a scan
    /// that both know beforehand, and is rolled back when it fails while the old one still stands by. Exit code 1
    /// when it was refused or rolled back. JSON keys: `role`, `from`, `to`, `shadow_scans`, `last_scan_old`,
    /// `first_scan_new`, `missed_scans`, `duplicate_scans`, `command_jump_rad`, `command_jump_mps`, `outcome`
    /// (`swapped`, `refused`, `rolled_back`), `reason`.
    Swap(SwapArguments),
    /// Find out whether a program, in whatever language, may fill a role.
    ///
    /// The program is started alone, all other roles are played with a recorded drive, and each requirement is tried.
    /// Exit code 1 when a required case failed, 4 when the program could not be started. JSON keys: `role`, `command`,
    /// `passed`, `failed` (required), `not_recommended`, `skipped`, `cases` with `name`, `level` (`required`,
    /// `recommended`), `outcome` (`passed`, `failed`, `skipped`), `reason`, `requirement`.
    Conformance(ConformanceArguments),
    /// Let a process run beside the live one, with no authority ever, and compare both.
    ///
    /// Both get the same samples. The report has the share of scans answered, differences with intervals, and times of
    /// both with intervals of their ratio. Ctrl-C ends it early, with the report so far. Exit code 1 when the process
    /// ended by itself or fell silent. JSON keys: `role`, `live`, `shadow`, `outcome` (`completed`, `interrupted`,
    /// `run_ended`, `died`, `silent`), `reason`, `scans`, `answered`, `answered_share`, `late`, `invalid`, `repeated`,
    /// `compared`, `kind_differs`, `differences`, `reaction_ms`, `compute_ms`.
    Shadow(ShadowArguments),
    /// Run one built-in implementation; `scanloop run` starts these.
    Service {
        /// emulator, ekf, ellipses, nmpc or actuation.
        name: String,
    },
    /// Drive random courses through the in-process pipeline on all cores and count how they end.
    ///
    /// Six in ten courses have obstacles at rest; the others are symmetric, blocked, have an obstacle that appears
    /// close ahead, or one that moves. JSON keys: `runs`, `reached`, `missed`, `stopped`, `timeout`, `collision`,
    /// `passable`, `passable_reached`, `blocked`, `blocked_stopped`, `min_clearance_m`, `time_to_goal_s`, `bad`.
    Campaign(CampaignArguments),
    /// Measure parts of the loop.
    #[command(subcommand)]
    Bench(BenchCommand),
    /// Show where the time from scan to actuation goes, live from the samples of a running system.
    Latency {
        /// Stop after that many seconds.
        #[arg(long, value_name = "S", default_value_t = 5.0)]
        duration: f64,
        /// Print the figures of the whole time as JSON to standard output: `latency_us` as in `report.json`.
        #[arg(long)]
        json: bool,
    },
    /// Answer a question of the design: observability, correlation of the controls, number of intervals.
    #[command(subcommand)]
    Analyse(AnalyseCommand),
    /// Find what is wrong with a robot from recorded or driven runs, for `run --calibration`.
    ///
    /// The result is merged into a calibration file with standard errors and 95 % intervals; a picture shows what the
    /// fit misses. Runs that are too few, out of range, or not plausible are refused with the reason.
    Calibrate(CalibrateArguments),
    /// Look at the samples on the bus.
    #[command(subcommand)]
    Topic(TopicCommand),
    /// Print the samples of all topics: fields, units, offsets.
    Types(TypesArguments),
}

/// Arguments of `stop`.
#[derive(Debug, Args, Default)]
pub struct StopArguments {
    /// Stop all systems of this user.
    #[arg(long)]
    pub all: bool,
    /// Stop systems of another user; for root.
    #[arg(long, value_name = "UID")]
    pub uid: Option<u32>,
    /// End the processes of a run that was stopped: what `stop` leaves behind to do.
    #[arg(long, value_name = "RUN", hide = true)]
    pub finish: Option<String>,
}

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArguments {
    /// Scenario or system files, or names of shipped scenarios.
    #[arg(value_name = "FILE")]
    pub files: Vec<String>,
    /// The choice of scenario and system.
    #[command(flatten)]
    pub choice: Choice,
    /// Print the names of the shipped scenarios to standard output.
    #[arg(long)]
    pub list: bool,
}

/// Arguments of `campaign`.
#[derive(Debug, Args)]
pub struct CampaignArguments {
    /// How many courses.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub runs: u64,
    /// Seed of the first course; the others follow it.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Where the scenario files of bad courses are written.
    #[arg(long, value_name = "DIR", default_value = "out/campaign", value_parser = console::output::folder())]
    pub out: PathBuf,
}

/// Looking at topics.
#[derive(Debug, Subcommand)]
pub enum TopicCommand {
    /// All topics: type, size, writer, readers.
    List,
    /// Rate of a topic, measured over the last seconds.
    Hz {
        /// Name of the topic.
        topic: String,
        /// Stop after that many seconds.
        #[arg(long, value_name = "S", default_value_t = 5.0)]
        duration: f64,
    },
    /// Samples of a topic as JSON, one line each, to standard output.
    Echo {
        /// Name of the topic.
        topic: String,
        /// Stop after that many samples.
        #[arg(long, short = 'n', value_name = "N")]
        count: Option<u64>,
        /// Leave out arrays of more than 16 elements.
        #[arg(long)]
        short: bool,
    },
}
