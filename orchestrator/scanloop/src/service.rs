//! `scanloop service NAME`: the built-in implementations.

use console::exit::{Exit, Failure};
use supervision::entry::IMPLEMENTATIONS;

use crate::bench::latency;

/// Runs one built-in implementation until it is asked to end.
///
/// # Errors
/// An unknown name, a process that was started by hand (both exit code 2), and errors of the process itself.
pub(crate) fn run(name: &str) -> anyhow::Result<Exit> {
    runtime::start_logging();
    if let Some(ended) = latency::echo::run(name).or_else(|| latency::noise::run(name)) {
        return ended.map(|()| Exit::Done);
    }
    match name {
        "emulator" => emulator::service::run()?,
        "ekf" => estimator::service::run()?,
        "ellipses" => obstacles::service::run()?,
        "nmpc" => nmpc::service::run()?,
        "actuation" => actuation::service::run()?,
        // No role of the loop: a process of `scanloop bench transport`.
        "hop" => hops::hop().map_err(|error| match error {
            hops::HopError::NotInAChain => Failure::bad_input(error),
            other => other.into(),
        })?,
        _ => {
            let known: Vec<&str> = IMPLEMENTATIONS.iter().map(|(name, _)| *name).collect();
            return Err(Failure::bad_input(format!(
                "unknown implementation `{name}`: expected one of {}",
                known.join(", ")
            )));
        }
    }
    Ok(Exit::Done)
}
