//! `scanloop-lab transport`: the same chain of processes over this bus, over a floor, and over other transports.
//!
//! Contenders take turns in rounds, each round beginning with another one, and every block starts its processes anew.
//! So the state of the machine and the memory layout of a start affect all alike. A contender that can't be measured
//! is left out with the reason. The chain itself is the crate `hops`.

mod arguments;
mod ratio;
mod results;
mod table;

use std::path::PathBuf;

use anyhow::Context;
use commands::bench::scheduling::{self, Scheduling};
use console::answer;
use console::exit::{Exit, Failure};
use console::out_folder::OutFolder;
use console::output::data;
use console::progress::Steps;
use hops::{ChainPlan, Contender, HopError, WaitPolicy};
use runtime::Shutdown;

pub(crate) use self::arguments::TransportArguments;
use self::results::{Measured, Results, Skipped, figures};
use crate::load::Load;

/// The files of the results.
const DATA: &str = "transport.json";
const TABLE: &str = "transport.csv";

/// Measures all contenders at all rates and prints the comparison.
///
/// # Errors
/// Options that this machine can't meet, and a chain of this bus that does not run.
pub(crate) fn transport(arguments: &TransportArguments) -> anyhow::Result<Exit> {
    let files = |out: &PathBuf| OutFolder::claim(out, &[DATA, TABLE], arguments.force);
    let files = arguments.out.as_ref().map(files).transpose()?;
    let base = plan(arguments, &Scheduling::read(&arguments.scheduling)?)?;
    let shutdown = Shutdown::on_signals()?;
    let (contenders, skipped) = contenders(arguments);
    let load = if arguments.load { Some(Load::start()?) } else { None };
    let mut all = Vec::new();
    let mut csv = String::from("rate_hz,policy,name,round,sent,lost,p50_us,p99_us,max_us\n");
    for &rate_hz in &arguments.rate {
        let (mut contenders, mut skipped) = (contenders.clone(), skipped.clone());
        let stop = || shutdown.requested();
        let measured = match rounds(arguments, &base, rate_hz, &mut contenders, &mut skipped, &stop) {
            Err(error) if matches!(error.downcast_ref(), Some(HopError::Interrupted)) => {
                note("interrupted");
                return Ok(Exit::NotReached);
            }
            measured => measured?,
        };
        add_rows(&mut csv, rate_hz, &measured);
        let results = Results::of(arguments, &base, rate_hz, &measured, skipped);
        answer!(arguments.json, "{}{}", if all.is_empty() { "" } else { "\n" }, table::text(&results))?;
        all.push(results);
    }
    drop(load);
    let json = match all.as_slice() {
        [one] => serde_json::to_string_pretty(one)?,
        several => serde_json::to_string_pretty(several)?,
    };
    if let Some(files) = files {
        files.write(DATA, json.as_bytes())?;
        files.write(TABLE, csv.as_bytes())?;
    }
    if arguments.json {
        data(&json)?;
    }
    Ok(Exit::Done)
}

/// Contenders that can be measured, and those that can't, with the reason.
fn contenders(arguments: &TransportArguments) -> (Vec<Contender>, Vec<Skipped>) {
    let mut skipped = Vec::new();
    let present = |contender: &Contender| match hops::missing(*contender) {
        Some(reason) => {
            skipped.push(Skipped { name: contender.name(), reason });
            false
        }
        None => true,
    };
    let contenders = arguments.contenders().into_iter().filter(present).collect();
    (contenders, skipped)
}

/// All rounds at one rate. A contender that fails is moved to the skipped ones.
fn rounds(
    arguments: &TransportArguments,
    base: &ChainPlan,
    rate_hz: f64,
    contenders: &mut Vec<Contender>,
    skipped: &mut Vec<Skipped>,
    stop: &dyn Fn() -> bool,
) -> anyhow::Result<Vec<Measured>> {
    let mut measured: Vec<Measured> = Vec::new();
    for policy in arguments.policies() {
        for &contender in contenders.iter() {
            if contender.can(policy) {
                measured.push(Measured { contender, policy, blocks: Vec::new() });
            } else if arguments.policies().len() == 1 {
                let reason = format!("waits in its own way: --policy {} is not for it", policy.name());
                skipped.push(Skipped { name: contender.name(), reason });
            }
        }
    }
    let plan = ChainPlan {
        rate_hz,
        // A fifth of a second warms caches and connections at any rate; slow rates get some messages at least.
        warm_up: (rate_hz / 5.0).ceil().max(3.0) as u64,
        samples: arguments.samples_per_round(rate_hz),
        ..base.clone()
    };
    let mut steps = Steps::new(arguments.rounds * measured.len() as u64, "chains");
    for round in 0..arguments.rounds as usize {
        for turn in 0..measured.len() {
            let place = (round + turn) % measured.len();
            let Measured { contender, policy, .. } = measured[place];
            steps.step(&format!(": {rate_hz} Hz, {}, {}", contender.name(), policy.name()));
            if !contenders.contains(&contender) {
                continue;
            }
            match hops::measure(&ChainPlan { contender, policy, ..plan.clone() }, stop) {
                Ok(block) => measured[place].blocks.push(block),
                Err(HopError::Interrupted) => return Err(HopError::Interrupted.into()),
                Err(error) if contender == Contender::Iceoryx2 => {
                    return Err(Failure::process(format!("the chain of our own bus does not run: {error}")));
                }
                Err(error) => {
                    skipped.push(Skipped { name: contender.name(), reason: error.to_string() });
                    contenders.retain(|other| *other != contender);
                }
            }
        }
    }
    measured.retain(|measured| contenders.contains(&measured.contender));
    Ok(measured)
}

/// What all chains have in common.
fn plan(arguments: &TransportArguments, scheduling: &Scheduling) -> anyhow::Result<ChainPlan> {
    Ok(ChainPlan {
        contender: Contender::Iceoryx2,
        payload: arguments.payload,
        rate_hz: 1.0,
        warm_up: 0,
        samples: 0,
        policy: WaitPolicy::Block,
        scheduling: class(scheduling),
        cpus: scheduling.cpus.clone(),
        program: std::env::current_exe().context("the path of this program")?,
        arguments: vec!["service".to_owned(), "hop".to_owned()],
    })
}

/// The policy of processes that belong to no system.
fn class(scheduling: &Scheduling) -> hops::SchedulingClass {
    match scheduling.policy {
        Some(scheduling::SchedulingPolicy::Fifo) => hops::SchedulingClass::Fifo,
        Some(scheduling::SchedulingPolicy::Other) | None => hops::SchedulingClass::Other,
    }
}

fn note(text: &str) {
    runtime::print(runtime::Priority::Notice, text);
}

fn add_rows(csv: &mut String, rate_hz: f64, measured: &[Measured]) {
    for Measured { contender, policy, blocks } in measured {
        for (round, block) in blocks.iter().enumerate() {
            let of_round = figures(std::slice::from_ref(block));
            csv.push_str(&format!(
                "{rate_hz},{},{},{},{},{},{},{},{}\n",
                policy.name(),
                contender.name(),
                round + 1,
                block.latencies_ns.len(),
                block.lost(),
                of_round.p50,
                of_round.p99,
                of_round.max
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn real_time_processes_of_both_benches_have_one_priority() {
        assert_eq!(hops::PRIORITY.cast_unsigned(), runtime::Realtime::default().priority);
    }
}
