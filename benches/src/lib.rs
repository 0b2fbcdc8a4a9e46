//! The benches that are no part of the product, with the executable `scanloop-bench`.
//!
//! `scanloop bench ...` finds it and hands its own arguments over, so it need not be called by hand. It has the
//! benches that need more than the product is made of: other transports, an allocator that counts, stages that
//! compute nothing, load. The benches of Criterion share recorded laps and a bus with two ends.

mod allocations;
mod empty_stages;
mod lap;
mod load;
mod payload;
mod round_trips;
mod scale;
mod transport;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use commands::bench::{SolverArguments, solver};
use console::exit::{Exit, Failure};
use console::limits;

pub use allocations::{CountingAllocator, allocations};
pub use lap::Lap;
pub use round_trips::{Echo, Peer, echo_until_told};

use scale::ScaleArguments;
use transport::TransportArguments;

/// The commands of `scanloop` that this executable runs.
#[derive(Debug, Parser)]
#[command(name = "scanloop", bin_name = "scanloop", version, max_term_width = 100)]
struct Cli {
    /// Which system on this machine is meant; these benches have systems of their own.
    #[arg(long, global = true, value_name = "NAME", env = runtime::SYSTEM_ID_VARIABLE, hide = true)]
    system_id: Option<String>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure parts of the loop.
    #[command(subcommand)]
    Bench(BenchCommand),
    /// Run a process of a bench; the benches start these.
    Service {
        /// hop, load, scale-companion or echo-ROLE.
        name: String,
    },
}

#[derive(Debug, Subcommand)]
enum BenchCommand {
    /// What one solve of the optimal control problem costs, with its heap allocations.
    Solver(SolverArguments),
    /// What companions and topics of your own cost: 5 to 50 processes, 10 to 100 topics, 1 to 24 readers, samples of 64 B
    /// to 4 MB.
    ///
    /// Each system drives `endless` in real time. JSON keys: `profile`, `duration_s`, `series` with `series` (`processes`,
    /// `topics`, `readers` or `bytes`), `points` with `value`, `scan_to_actuation_us`, `lost`, `samples`, `missed`,
    /// `shared_memory_kib`, `memory_kib`, `start_ms`, and `fits` of lines with `intercept`, `slope` and `r_squared`.
    Scale(ScaleArguments),
    /// What four hops between five processes cost over other transports, as ratios to ours.
    ///
    /// Every contender runs the same chain of processes, in turns: each round starts each chain once. Intervals hold
    /// with 99 %; where one contains 1 no difference was seen. Peers that are not built are skipped with the command
    /// that builds them.
    ///
    /// JSON: one object for one `--rate`, a list of them for several. Keys: `profile`, `rate_hz`, `hops`,
    /// `payload_bytes` (a number, or one per hop for `pipeline`), `scheduling`, `cpus`, `load`, `policy`, `rounds`,
    /// `confidence`, `transports` with `name`, `policy`, `latency_us`, `sent`, `lost`, `ratio_p50`,
    /// `ratio_p50_interval`, `verdict_p50`, the same for p99; `polling`, the same for processes that poll when both
    /// policies are measured; `skipped` with `name`, `reason`.
    Transport(TransportArguments),
}

/// Runs the command line and returns its exit code.
pub fn main() -> ExitCode {
    commands::program(run)
}

fn run() -> anyhow::Result<Exit> {
    let cli: Cli = console::output::arguments();
    runtime::check_log_filter()?;
    runtime::start_logging();
    match cli.command {
        Command::Service { name } => service(&name).map(|()| Exit::Done),
        Command::Bench(command) => {
            limits::require_room_for_a_system()?;
            runtime::start_terminal();
            match command {
                BenchCommand::Solver(arguments) => solver::solver(&arguments, Some(allocations)),
                BenchCommand::Scale(arguments) => scale::scale(&arguments),
                BenchCommand::Transport(arguments) => transport::transport(&arguments),
            }
        }
    }
}

fn service(name: &str) -> anyhow::Result<()> {
    if let Some(ended) = empty_stages::run(name) {
        return ended;
    }
    match name {
        load::SERVICE => load::run(),
        scale::companion::SERVICE => scale::companion::run(),
        "hop" => hops::hop().map_err(|error| match error {
            hops::HopError::NotInAChain => Failure::bad_input(error),
            other => other.into(),
        }),
        _ => Err(Failure::bad_input(format!(
            "unknown service `{name}`: expected hop, load, scale-companion or echo-ROLE"
        ))),
    }
}
