//! The laboratory, with the executable `scanloop-lab`: what studies the product and is no part of it.
//!
//! `scanloop campaign ...` and the other commands of the laboratory find it and hand their arguments over, so it need
//! not be called by hand. The benches of Criterion share recorded laps and a bus with two ends.

mod allocations;
mod analyse;
mod analysis;
mod campaign;
mod compare;
mod cores;
mod empty_stages;
mod estimator;
mod faults;
mod fork;
mod lap;
mod load;
mod optimum;
mod payload;
mod price;
mod ride;
mod robot;
mod round_trips;
pub mod solver;
mod transport;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use commands::completions::{CompleteArguments, print_candidates};
use commands::man::{ManArguments, write_pages};
use commands::{laboratory, reference};
use console::exit::{Exit, Failure};
use console::limits;
use console::output::data;

pub use allocations::{CountingAllocator, allocations};
pub use lap::Lap;
pub use round_trips::{EchoClient, Peer, echo_until_told};

use analyse::AnalyseCommand;
use campaign::arguments::CampaignArguments;
use compare::CompareArguments;
use estimator::EstimatorArguments;
use faults::FaultsArguments;
use fork::ForkArguments;
use price::PriceArguments;
use ride::RideArguments;
use solver::SolverArguments;
use transport::TransportArguments;

/// What studies Scanloop: campaigns of random courses, the matrix of faults, prices, benches, design analyses.
#[derive(Debug, Parser)]
#[command(name = "scanloop-lab", bin_name = "scanloop-lab", version, max_term_width = 100)]
struct Cli {
    /// Which system on this machine is meant; studies have systems of their own.
    #[arg(long, global = true, value_name = "NAME", env = runtime::SYSTEM_ID_VARIABLE, hide = true)]
    system_id: Option<String>,
    #[command(subcommand)]
    command: Command,
}

/// First words of the half of `docs/commands.md`.
const WORDS: &str = include_str!("reference/commands.md");
/// What the commands print with `--json`, for the page of the commands.
const JSON_KEYS: &str = include_str!("reference/json.txt");

#[derive(Debug, Subcommand)]
enum Command {
    /// Drive random courses through the in-process pipeline on all cores and judge how they end.
    ///
    /// Without `--family` it drives the mixed campaign: six of ten courses have obstacles at rest, the others are
    /// symmetric, blocked, have an obstacle that appears close ahead, or one that moves. `--family hostile` chooses all
    /// hostile families, `--family curved` courses with bends, `--family reversing` turns in three. A judge that knows the
    /// truth and nothing of the stages decides whether a course is passable, a stop was right, and a contact with a moving body is excused (docs/campaign.md). A course is bad as well if in
    /// any scan the robot could not come to rest without contact. Each bad course is a file that `run` replays, in the
    /// folder of its cause; `gaps.svg` shows the share passed over the width of the gap. Exit code 3 after a contact
    /// that is not excused, 1 if another course was bad.
    Campaign(CampaignArguments),
    /// Inject each fault in each phase of a drive, and judge what the loop makes of it.
    ///
    /// Faults of samples and of the robot are driven in simulated time on all cores; processes that die, hang or flood
    /// are real, in systems of their own. A cell passes if nothing is touched, the drive ends as its fault allows, and
    /// the fault is detected in time, or has no effect on the wheels. `docs/faults.md` lists the faults. Exit code 1 if
    /// a cell fails.
    Faults(FaultsArguments),
    /// Drive a recorded drive on from one of its scans, with something changed.
    ///
    /// Robot, stages and random numbers have the state of that scan. With changed keys or a new obstacle, the journals are
    /// followed until the first output that is another one: that scan is printed, and from there the drive continues in
    /// lock-step, in one process. A program in place of a stage drives from the scan itself. Without a change, a drive that
    /// was recorded in lock-step repeats to the bit; exit code 1 if it does not. Exit code 2 for a drive of a robot that is
    /// not emulated.
    Fork(ForkArguments),
    /// Measure by driving what latency, scan rate and pose uncertainty cost in centimetres.
    ///
    /// Under each condition the robot drives through gaps between two boxes, which are bisected to 1 cm, and towards a
    /// box that closes the track suddenly. The drives run in one process, in simulated time, on all cores. The picture
    /// `price.svg` shows the figures. Exit code 3 if the robot touched a box.
    Price(PriceArguments),
    /// Measure how well courses are driven, compared with the optimum that sees what the robot saw.
    ///
    /// The drives run in one process, in simulated time, on all cores. The regret is the objective J of the drive over
    /// that of the optimum; J has fixed weights (docs/ride.md). Exit code 1 if a regret is below 0.99: then the bench
    /// is wrong.
    Ride(RideArguments),
    /// Measure how far the estimated pose is from the true one, and whether its covariance says so.
    ///
    /// The drives run in one process, in simulated time, on all cores. NEES is the squared error over its covariance, 3 in
    /// the mean when the covariance is right; NIS is the same for what is measured. The odometer without a filter is
    /// measured in the same drives.
    Estimator(EstimatorArguments),
    /// Measure the cost of one solve of the optimal control problem, on recorded initial states.
    ///
    /// For each Hessian, each QP solver and each number of intervals it reports median, 99th percentile and maximum of
    /// the time per SQP step, feedback phase and converged solve [us]. It also reports iterations, failures and heap
    /// allocations per solve. The weights are those of an earlier comparison of solvers (docs/solver.md), not those of
    /// a run. The feedback phase is the work that remains when the measured state arrives: move the linearised model to
    /// it, condense, solve one quadratic program.
    Solver(SolverArguments),
    /// Compare two drives, or two builds: where and how they differ, and whether one is slower.
    ///
    /// Two recordings are compared along their way, not by time: where they part, then time, stops, clearance, ride and
    /// latency. Of two folders of recordings the means are compared, with 99 % intervals; drives of the same seeds are
    /// compared one by one. Files of `bench latency --json`, and two commands that run in turns, are compared with a
    /// confidence interval and the smallest visible difference. Commands print JSON with
    /// the figure that `--metric` names; with `--metric wall` their run time is compared.
    Compare(CompareArguments),
    /// What four hops between five processes cost over other transports, as ratios to ours.
    ///
    /// Every contender runs the same chain of processes, in turns: each round starts each chain once. Intervals hold
    /// with 99 %; where one contains 1 no difference was seen. Peers that are not built are skipped with the command
    /// that builds them.
    Transport(TransportArguments),
    /// Answer a design question: observability, correlation of the controls, number of intervals, odometry drift.
    #[command(subcommand)]
    Analyse(AnalyseCommand),
    /// Print the half of `docs/commands.md` that is about this executable.
    Reference,
    /// List what may be typed at a place of a command line; shells start this.
    #[command(hide = true)]
    Complete(CompleteArguments),
    /// Write the man pages of these commands; `scanloop man` starts this.
    #[command(hide = true)]
    Man(ManArguments),
    /// Run a process of a bench; the benches start these.
    #[command(hide = true)]
    Service {
        /// hop, load or echo-ROLE.
        name: String,
    },
}

/// Runs the command line and returns its exit code.
pub fn main() -> ExitCode {
    commands::program(run)
}

fn run() -> anyhow::Result<Exit> {
    let cli: Cli = console::output::arguments();
    runtime::check_log_filter()?;
    if let Command::Service { name } = &cli.command {
        runtime::start_logging();
        return service(name).map(|()| Exit::Done);
    }
    if matches!(cli.command, Command::Transport(_) | Command::Solver(_)) {
        limits::require_room_for_a_system()?;
        runtime::start_logging();
        runtime::start_terminal();
    }
    limits::require_files(limits::SPARE_FILES)?;
    match &cli.command {
        Command::Campaign(arguments) => campaign::campaign(arguments),
        Command::Faults(arguments) => faults::faults(arguments),
        Command::Fork(arguments) => fork::fork(arguments),
        Command::Price(arguments) => price::price(arguments),
        Command::Ride(arguments) => ride::ride(arguments),
        Command::Estimator(arguments) => estimator::estimator(arguments),
        Command::Solver(arguments) => solver::solver(arguments),
        Command::Compare(arguments) => compare::compare(arguments),
        Command::Transport(arguments) => transport::transport(arguments),
        Command::Analyse(command) => analyse::analyse(command),
        Command::Reference => {
            data(&reference::of_laboratory(Cli::command(), WORDS, JSON_KEYS)).map(|_| Exit::Done)
        }
        Command::Complete(arguments) => print_candidates(Cli::command(), arguments),
        Command::Man(arguments) => man(arguments).map(|()| Exit::Done),
        Command::Service { name } => service(name).map(|()| Exit::Done),
    }
}

/// Writes the page of this executable, and those of its commands under the names that `scanloop` gives them.
fn man(arguments: &ManArguments) -> anyhow::Result<()> {
    let (own, mut pages) = (Cli::command(), Vec::new());
    let surface = with_handed_over(commands::cli::Cli::command(), &own, "", &mut pages);
    write_pages(surface, &arguments.folder, |name| {
        pages
            .iter()
            .any(|page| name.strip_prefix(page).is_some_and(|rest| rest.is_empty() || rest.starts_with('-')))
    })?;
    write_pages(own, &arguments.folder, |name| name == "scanloop-lab")
}

/// The command line `surface` with what is handed over as `own` has it; `pages` gets the names of these commands.
fn with_handed_over(
    surface: clap::Command,
    own: &clap::Command,
    around: &str,
    pages: &mut Vec<String>,
) -> clap::Command {
    let name = format!("{around}{}-", surface.get_name());
    surface.mut_subcommands(|command| {
        match own.find_subcommand(command.get_name()).filter(|_| laboratory::is_handed_over(&command)) {
            Some(theirs) => {
                pages.push(format!("{name}{}", command.get_name()));
                theirs.clone()
            }
            None => with_handed_over(command, own, &name, pages),
        }
    })
}

fn service(name: &str) -> anyhow::Result<()> {
    if let Some(ended) = empty_stages::run(name) {
        return ended;
    }
    match name {
        load::SERVICE => load::run(),
        "hop" => hops::hop().map_err(|error| match error {
            hops::HopError::NotInAChain => Failure::bad_input(error),
            other => other.into(),
        }),
        _ => Err(Failure::bad_input(format!("unknown service `{name}`: expected hop, load or echo-ROLE"))),
    }
}
