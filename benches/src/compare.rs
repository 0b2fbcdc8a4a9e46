//! `scanloop-lab compare`: whether B is slower than A, with a confidence interval and the smallest visible
//! difference; of recordings, where drives part and how they differ, see `report::compare`.
//!
//! Two files were made one after the other, so their difference includes what changed on the machine in between.
//! Two commands are run in turns, which is the way to compare two builds. For the confidence of both see
//! `figures::difference`.

mod files;
mod turns;
mod verdict;

use std::path::PathBuf;

use ::report::compare as drives;
use clap::Args;
use console::answer;
use console::exit::{Exit, Failure};
use figures::difference::{MAX_ROUNDS, MIN_ROUNDS};
use serde::Serialize;
use serde_json::Value;

use self::verdict::Verdict;
use commands::print_json;

/// The metrics without `--metric`; the first one is the main result.
const METRICS: [&str; 2] = ["scan_to_actuation_us.p50", "scan_to_actuation_us.p99"];

/// Arguments of `compare`.
#[derive(Debug, Clone, Args)]
#[command(group = clap::ArgGroup::new("what").required(true).multiple(false))]
pub(crate) struct CompareArguments {
    /// Two recordings, two folders of recordings, or two results of `bench latency --json` with the same arguments.
    #[arg(num_args = 2, value_names = ["A", "B"], group = "what")]
    pub files: Vec<PathBuf>,
    /// Two shell commands that run in turns.
    #[arg(long, num_args = 2, value_names = ["CMD A", "CMD B"], group = "what")]
    pub ab: Vec<String>,
    /// Number of runs of each command, at least 8.
    #[arg(long, value_name = "N", default_value_t = 12)]
    pub rounds: usize,
    /// Figure to compare, as a path of keys like `stages_us.controller.p50`, or `wall` for the run time of a command in
    /// seconds; without it the median and the 99th percentile of scan to actuation.
    #[arg(long, value_name = "KEY.PATH")]
    pub metric: Option<String>,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
}

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct Comparison {
    #[serde(flatten)]
    first: Verdict,
    /// Further figures.
    others: Vec<Verdict>,
    /// The first figure of A and B in each round; empty for files.
    rounds: Vec<[f64; 2]>,
}

/// Compares and prints the result.
///
/// # Errors
/// Bad arguments and files, commands that fail.
pub(crate) fn compare(arguments: &CompareArguments) -> anyhow::Result<Exit> {
    if let [a, b] = arguments.files.as_slice()
        && (drives::is_drives(a) || drives::is_drives(b))
    {
        if let Some(metric) = &arguments.metric {
            let which = "recordings are compared in all figures";
            return Err(Failure::bad_input(format!("--metric {metric} is not allowed: {which}")));
        }
        let compared = drives::compare([a, b])?;
        answer!(arguments.json, "{}", drives::text(&compared))?;
        return print_json(arguments.json, &compared).map(|()| Exit::Done);
    }
    let metrics: Vec<String> = match &arguments.metric {
        Some(metric) => vec![metric.clone()],
        None => METRICS.map(str::to_owned).to_vec(),
    };
    let (verdicts, rounds) = match (arguments.files.as_slice(), arguments.ab.as_slice()) {
        ([a, b], _) => (files::compare([a, b], &metrics)?, Vec::new()),
        (_, commands @ [_, _]) => {
            if !(MIN_ROUNDS..=MAX_ROUNDS).contains(&arguments.rounds) {
                return Err(Failure::bad_input(format!(
                    "--rounds {} is not allowed: {MIN_ROUNDS} to {MAX_ROUNDS}; fewer give no 99 % confidence",
                    arguments.rounds
                )));
            }
            let turns = turns::compare(commands, arguments.rounds, &metrics)?;
            (turns.verdicts, turns.figures)
        }
        _ => return Err(Failure::bad_input("two files or two commands are needed")),
    };
    for Verdict { metric, a, b, text, .. } in &verdicts {
        answer!(arguments.json, "{metric:<32} A {a:.1}   B {b:.1}\n    {text}")?;
    }
    let mut verdicts = verdicts.into_iter();
    let Some(first) = verdicts.next() else {
        return Err(Failure::bad_input("a figure was not a finite number in every round"));
    };
    print_json(arguments.json, &Comparison { first, others: verdicts.collect(), rounds })?;
    Ok(Exit::Done)
}

/// The number at a path of keys and indices like `solvers.0.solve_us.p50`.
fn figure(json: &Value, metric: &str) -> Option<f64> {
    let pointer = format!("/{}", metric.replace('.', "/"));
    json.pointer(&pointer)?.as_f64()
}
