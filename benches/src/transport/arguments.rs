//! Options of `scanloop bench transport`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use commands::bench::latency::arguments::bytes;
use commands::bench::scheduling::SchedulingArguments;
use console::output::folder;
use hops::{BLOCK_BYTES, Contender, Payload, WaitPolicy};

/// Arguments of `transport`.
#[derive(Debug, Args)]
pub(crate) struct TransportArguments {
    /// Transports to measure besides `iceoryx2`: iceoryx2-listener, floor, floor-futex, unix-socket, zenoh, zenoh-shm,
    /// zeromq, dora. Without it all.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub peers: Vec<Contender>,
    /// Messages per second, 0.5 to 5000; each rate has a table.
    #[arg(long, value_name = "HZ", value_delimiter = ',', default_values_t = [10.0, 1000.0], value_parser = rate)]
    pub rate: Vec<f64>,
    /// Size of a message: `pipeline` for the samples of the loop, or 1k, 4k, 16k, 64k, 256k, 1M, 4M on every hop.
    #[arg(long, value_name = "BYTES", default_value = "pipeline", value_parser = payload)]
    pub payload: Payload,
    /// Time for which each transport sends at each rate, over all rounds [s].
    #[arg(long, value_name = "S", default_value_t = 30.0, value_parser = duration)]
    pub duration: f64,
    /// Number of messages that each transport sends at each rate, over all rounds; instead of `--duration`.
    #[arg(long, value_name = "N", conflicts_with = "duration", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub samples: Option<u64>,
    /// Number of rounds; each starts new processes for every transport.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(3..=100))]
    pub rounds: u64,
    /// Scheduling policy and processors of all processes.
    #[command(flatten)]
    pub scheduling: SchedulingArguments,
    /// Keep all processors busy during the measurement.
    #[arg(long)]
    pub load: bool,
    /// How processes wait; without it `block` for all transports, and `poll` for those that can.
    #[arg(long, value_name = "HOW")]
    pub policy: Option<Waiting>,
    /// Print JSON to standard output.
    #[arg(long)]
    pub json: bool,
    /// Folder for `transport.json` and `transport.csv`, the figures of every round.
    #[arg(long, value_name = "DIR", value_parser = folder())]
    pub out: Option<PathBuf>,
    /// Replace files in the folder that this program did not write.
    #[arg(long)]
    pub force: bool,
}

/// How processes wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Waiting {
    /// They sleep until a message wakes them.
    Block,
    /// They poll for 0.2 ms before and after a message is due, and sleep otherwise.
    Poll,
}

impl TransportArguments {
    /// The policies, that of the main table first.
    pub(super) fn policies(&self) -> Vec<WaitPolicy> {
        match self.policy {
            None => vec![WaitPolicy::Block, WaitPolicy::Poll],
            Some(Waiting::Block) => vec![WaitPolicy::Block],
            Some(Waiting::Poll) => vec![WaitPolicy::Poll],
        }
    }

    /// The contenders in the order of the table; what all are compared with is always there.
    pub(super) fn contenders(&self) -> Vec<Contender> {
        let wanted = |contender: &Contender| {
            *contender == Contender::Iceoryx2 || self.peers.is_empty() || self.peers.contains(contender)
        };
        Contender::ALL.into_iter().filter(wanted).collect()
    }

    /// Messages that each contender sends in one round.
    pub(super) fn samples_per_round(&self, rate_hz: f64) -> u64 {
        let all = self.samples.unwrap_or((self.duration * rate_hz).round() as u64);
        all.div_ceil(self.rounds).max(1)
    }
}

fn rate(text: &str) -> Result<f64, String> {
    within(text, 0.5, 5000.0)
}

fn duration(text: &str) -> Result<f64, String> {
    within(text, 0.01, 86_400.0)
}

fn within(text: &str, low: f64, high: f64) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(format!("a number from {low} to {high} is allowed")),
    }
}

fn payload(text: &str) -> Result<Payload, String> {
    if text == "pipeline" {
        return Ok(Payload::Pipeline);
    }
    match bytes(text) {
        Some(bytes) if BLOCK_BYTES.contains(&bytes) => Ok(Payload::Block(bytes)),
        _ => Err(format!("`pipeline` or one of {BLOCK_BYTES:?} bytes (1k to 4M) is allowed")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_sizes_are_read_with_and_without_unit() {
        for (text, expected) in [
            ("pipeline", Payload::Pipeline),
            ("1024", Payload::Block(1024)),
            ("64k", Payload::Block(65_536)),
            ("4M", Payload::Block(4_194_304)),
        ] {
            assert_eq!(payload(text), Ok(expected), "{text}");
        }
        for text in ["", "k", "1000", "8M", "-1k", "99999999999999999999M"] {
            assert!(payload(text).is_err(), "{text}");
        }
    }
}
