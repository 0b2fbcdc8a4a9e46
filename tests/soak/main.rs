//! `soak`: thousands of swaps, kills and stops in several systems at once, until one of them shows a fault.
//! `soak operator`: random actions of an operator, one live drive after the other.
//! `soak recordings`: recorded drives with faults, swaps and restarts, each replayed to the bit.
//! `soak long`: hours of driving with scanner faults, swaps and, in real time, kills.
//! `soak page`: hours of driving in real time with the live page open in a browser.
//!
//! The program is its own `scanloop`: the processes that it starts are itself.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use clap::{Args, Parser, Subcommand};
use scanloop_tests::long_drive::{LongDrive, LongTally, MAX_DRIVE_S, drive};
use scanloop_tests::operator::{place, quantile, trial};
use scanloop_tests::page_hours::watch;
use scanloop_tests::recordings::{self, KINDS, RecordingKind, ReplayTally};
use scanloop_tests::soak::{Tally, faults, swap_in_lockstep, swap_live};

/// Swaps, kills and stops processes at random moments, and checks what must hold after each.
#[derive(Debug, Parser)]
struct Arguments {
    /// Everything that is done: of 100 events 80 are swaps in lock-step, 10 in real time, 7 kills, 3 stops.
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    events: usize,
    /// Swaps in lock-step, instead of their share.
    #[arg(long, value_name = "N")]
    lockstep_swaps: Option<usize>,
    /// Swaps in real time, instead of their share.
    #[arg(long, value_name = "N")]
    live_swaps: Option<usize>,
    /// Kills, instead of their share.
    #[arg(long, value_name = "N")]
    kills: Option<usize>,
    /// Stops, instead of their share.
    #[arg(long, value_name = "N")]
    stops: Option<usize>,
    /// Systems of each kind side by side, 1 to 16.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=16))]
    jobs: u8,
    /// Threads that keep processors busy all the time.
    #[arg(long, value_name = "N", default_value_t = 0)]
    load: u8,
    /// Seed of what happens when.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Another campaign.
    #[command(subcommand)]
    campaign: Option<Campaign>,
}

/// Other campaigns.
#[derive(Debug, Subcommand)]
enum Campaign {
    /// Random actions of an operator during live drives; exit code 1 when one does not end as it must.
    Operator(OperatorArguments),
    /// Recorded drives with faults, swaps and restarts; exit code 1 when a replay finds a difference.
    Recordings(RecordingsArguments),
    /// Hours of driving with faults under way; exit code 1 when something grows or is unexplained.
    Long(LongArguments),
    /// Hours of driving with the live page open in a browser; exit code 1 when the memory of server or page grows.
    Page {
        /// Time with the page open [h].
        #[arg(long, value_name = "H", default_value_t = 1.0)]
        hours: f64,
    },
}

/// Arguments of `long`.
#[derive(Debug, Args)]
struct LongArguments {
    /// Driven time in all [h].
    #[arg(long, value_name = "H", default_value_t = 24.0)]
    hours: f64,
    /// Scans per second; without it 10, or 100 with `--live` [Hz].
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// In real time, with kills and stops of processes.
    #[arg(long)]
    live: bool,
    /// Seed of the first drive; the others count on from it.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// Arguments of `recordings`.
#[derive(Debug, Args)]
struct RecordingsArguments {
    /// Recordings, of all kinds in turns.
    #[arg(long, value_name = "N", default_value_t = 100)]
    count: u64,
    /// Drives side by side, 1 to 16.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=16))]
    jobs: u8,
    /// Seed of the first; the others count on from it.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
}

/// Arguments of `operator`.
#[derive(Debug, Args)]
struct OperatorArguments {
    /// Live drives, one after the other.
    #[arg(long, value_name = "N", default_value_t = 500)]
    trials: u64,
    /// Seed of the first; the others count on from it.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Keep the files of good trials too.
    #[arg(long)]
    keep: bool,
}

fn main() -> std::process::ExitCode {
    if std::env::args().nth(1).is_some_and(|argument| argument == "--system-id" || argument == "service") {
        return commands::main();
    }
    let arguments = Arguments::parse();
    let Ok(executable) = std::env::current_exe() else {
        eprintln!("error: the path of this program is not known");
        return std::process::ExitCode::FAILURE;
    };
    let executable = executable.to_string_lossy().into_owned();
    match &arguments.campaign {
        Some(Campaign::Operator(arguments)) => return operator(arguments, &executable),
        Some(Campaign::Recordings(arguments)) => return replays(arguments, &executable),
        Some(Campaign::Long(arguments)) => return long(arguments, &executable),
        Some(Campaign::Page { hours }) => return page(*hours, &executable),
        None => {}
    }
    for _ in 0..arguments.load {
        std::thread::spawn(|| {
            loop {
                std::hint::spin_loop();
            }
        });
    }
    let started = Instant::now();
    let (tally, failed) = soak(&arguments, &executable);
    println!("{} events in {:.0} s: {tally:#?}", tally.events(), started.elapsed().as_secs_f64());
    if failed > 0 {
        eprintln!("error: {failed} of the systems showed a fault, see above");
        return std::process::ExitCode::FAILURE;
    }
    std::process::ExitCode::SUCCESS
}

/// All trials, with a line for each.
fn operator(arguments: &OperatorArguments, executable: &str) -> std::process::ExitCode {
    place::enter();
    let (mut stops_s, mut blocked_ms, mut failed) = (Vec::new(), Vec::new(), 0);
    for seed in arguments.seed..arguments.seed.saturating_add(arguments.trials) {
        let judged = trial(executable, seed, arguments.keep);
        println!("{judged}");
        stops_s.extend(&judged.stops_s);
        blocked_ms.extend(&judged.blocked_ms);
        failed += usize::from(!judged.problems.is_empty());
    }
    for (what, values) in
        [("duration of stop [s]", &mut stops_s), ("wheels blocked after [ms]", &mut blocked_ms)]
    {
        let [p50, p90, p99, max] = [0.5, 0.9, 0.99, 1.0].map(|share| quantile(values, share));
        println!("{what}: count {}, p50 {p50:.3}, p90 {p90:.3}, p99 {p99:.3}, max {max:.3}", values.len());
    }
    println!("{} trials, {failed} failed", arguments.trials);
    if failed > 0 { std::process::ExitCode::FAILURE } else { std::process::ExitCode::SUCCESS }
}

/// All recordings, with a line for each, and one for each kind.
fn replays(arguments: &RecordingsArguments, executable: &str) -> std::process::ExitCode {
    let RecordingsArguments { count, jobs, seed } = *arguments;
    let next = AtomicU64::new(0);
    let tallies = Mutex::new(BTreeMap::<RecordingKind, ReplayTally>::new());
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let number @ 0.. = next.fetch_add(1, Ordering::Relaxed)
                    && number < count
                {
                    let kind = KINDS[number as usize % KINDS.len()];
                    let (tally, printed) = recordings::check(executable, kind, seed + number);
                    println!("seed {} {kind:?}: {tally}", seed + number);
                    if tally.same == 0 || tally.skipped > 0 {
                        print!("{printed}");
                    }
                    *tallies.lock().expect("no thread has panicked").entry(kind).or_default() += tally;
                }
            });
        }
    });
    let mut all = ReplayTally::default();
    for (kind, tally) in tallies.into_inner().expect("no thread has panicked") {
        println!("{kind:?}: {tally}");
        all += tally;
    }
    println!("all: {all}");
    let is_good = all.same == all.recordings && all.skipped * 1000 <= all.samples;
    if is_good { std::process::ExitCode::SUCCESS } else { std::process::ExitCode::FAILURE }
}

/// Drives until the hours are over, with a line for each drive.
fn long(arguments: &LongArguments, executable: &str) -> std::process::ExitCode {
    let LongArguments { hours, live, .. } = *arguments;
    let rate_hz = arguments.rate.unwrap_or(if live { 100.0 } else { 10.0 });
    let mut tally = LongTally::default();
    for seed in arguments.seed.. {
        let left_s = hours * 3600.0 - tally.driven_s;
        if left_s < 1.0 {
            break;
        }
        drive(
            executable,
            &LongDrive { seed, duration_s: left_s.clamp(30.0, MAX_DRIVE_S), rate_hz, live },
            &mut tally,
        );
        println!("seed {seed}: {tally}");
    }
    tally.problems.iter().for_each(|problem| eprintln!("error: {problem}"));
    if tally.problems.is_empty() { std::process::ExitCode::SUCCESS } else { std::process::ExitCode::FAILURE }
}

/// Drives with the page open.
fn page(hours: f64, executable: &str) -> std::process::ExitCode {
    let watched = watch(executable, 3600.0 * hours);
    println!("{watched}");
    watched.problems.iter().for_each(|problem| eprintln!("error: {problem}"));
    if watched.problems.is_empty() {
        std::process::ExitCode::SUCCESS
    } else {
        std::process::ExitCode::FAILURE
    }
}

/// All systems; what was done, and how many of them showed a fault.
fn soak(arguments: &Arguments, executable: &str) -> (Tally, usize) {
    let Arguments { events, seed, .. } = *arguments;
    let jobs = usize::from(arguments.jobs);
    let lockstep = arguments.lockstep_swaps.unwrap_or(events * 80 / 100);
    let live = arguments.live_swaps.unwrap_or(events * 10 / 100);
    let kills = arguments.kills.unwrap_or(events * 7 / 100);
    let stops = arguments.stops.unwrap_or(events * 3 / 100);
    let share = |count: usize, job: usize| count / jobs + usize::from(job < count % jobs);
    std::thread::scope(|scope| {
        let mut systems = Vec::new();
        for job in 0..jobs {
            let seed = seed.wrapping_mul(1000).wrapping_add(job as u64);
            let (lockstep, live) = (share(lockstep, job), share(live, job));
            let (kills, stops) = (share(kills, job), share(stops, job));
            systems.push(scope.spawn(move || swap_in_lockstep(executable, lockstep, seed)));
            systems.push(scope.spawn(move || swap_live(executable, live, seed)));
            systems.push(scope.spawn(move || faults(executable, kills, stops, seed)));
        }
        let (mut tally, mut failed) = (Tally::default(), 0);
        for system in systems {
            match system.join() {
                Ok(one) => tally += one,
                Err(_) => failed += 1,
            }
        }
        (tally, failed)
    })
}
