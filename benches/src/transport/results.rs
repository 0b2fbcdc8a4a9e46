//! Results of a comparison, as JSON.

use figures::{Distribution, Figures};
use hops::{Block, ChainPlan, Contender, HOPS, Payload, WaitPolicy};
use serde::Serialize;

use super::TransportArguments;
use super::ratio::{CONFIDENCE, Ratio, Rounds, ratio};

/// Everything at one rate.
#[derive(Debug, Serialize)]
pub(super) struct Results {
    pub(super) profile: &'static str,
    pub(super) rate_hz: f64,
    pub(super) hops: usize,
    pub(super) payload_bytes: Bytes,
    pub(super) scheduling: &'static str,
    pub(super) cpus: Vec<usize>,
    pub(super) load: bool,
    pub(super) policy: &'static str,
    pub(super) rounds: u64,
    pub(super) confidence: f64,
    pub(super) transports: Vec<Row>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) polling: Vec<Row>,
    pub(super) skipped: Vec<Skipped>,
}

/// Size of messages: the same on all hops, or one each.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Bytes {
    /// On all hops.
    Same(usize),
    /// On each.
    Each([usize; HOPS]),
}

/// One contender under one policy.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    pub(super) name: &'static str,
    pub(super) policy: &'static str,
    pub(super) latency_us: Figures,
    pub(super) sent: u64,
    pub(super) lost: u64,
    pub(super) ratio_p50: f64,
    pub(super) ratio_p50_interval: [f64; 2],
    pub(super) verdict_p50: &'static str,
    pub(super) ratio_p99: f64,
    pub(super) ratio_p99_interval: [f64; 2],
    pub(super) verdict_p99: &'static str,
}

/// A contender that was not measured.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Skipped {
    pub(super) name: &'static str,
    pub(super) reason: String,
}

/// All blocks of one contender under one policy.
#[derive(Debug)]
pub(super) struct Measured {
    pub(super) contender: Contender,
    pub(super) policy: WaitPolicy,
    pub(super) blocks: Vec<Block>,
}

impl Measured {
    fn rounds(&self) -> Rounds {
        let blocks: Vec<Vec<u64>> = self.blocks.iter().map(|block| block.arrived_ns().collect()).collect();
        Rounds::new(&blocks)
    }

    fn row(&self, ours: &Rounds) -> Row {
        let is_ours = self.contender == Contender::Iceoryx2;
        let rounds = self.rounds();
        let ratio_of = |share| if is_ours { Ratio::ONE } else { ratio(ours, &rounds, share) };
        let verdict = |ratio: &Ratio| if is_ours { "reference" } else { ratio.verdict().name() };
        let (p50, p99) = (ratio_of(0.5), ratio_of(0.99));
        Row {
            name: self.contender.name(),
            policy: self.policy.name(),
            latency_us: figures(&self.blocks),
            sent: self.blocks.iter().map(|block| block.latencies_ns.len() as u64).sum(),
            lost: self.blocks.iter().map(Block::lost).sum(),
            ratio_p50: p50.value,
            ratio_p50_interval: [p50.low, p50.high],
            verdict_p50: verdict(&p50),
            ratio_p99: p99.value,
            ratio_p99_interval: [p99.low, p99.high],
            verdict_p99: verdict(&p99),
        }
    }
}

impl Results {
    /// The comparison of what was measured at one rate.
    pub(super) fn of(
        arguments: &TransportArguments,
        base: &ChainPlan,
        rate_hz: f64,
        measured: &[Measured],
        skipped: Vec<Skipped>,
    ) -> Self {
        let policies = arguments.policies();
        let rows = |policy: WaitPolicy| -> Vec<Row> {
            let of_policy: Vec<&Measured> =
                measured.iter().filter(|measured| measured.policy == policy).collect();
            let ours = of_policy.iter().find(|measured| measured.contender == Contender::Iceoryx2);
            let Some(ours) = ours.map(|ours| ours.rounds()) else { return Vec::new() };
            of_policy.iter().map(|measured| measured.row(&ours)).collect()
        };
        Self {
            profile: figures::PROFILE,
            rate_hz,
            hops: HOPS,
            payload_bytes: match arguments.payload {
                Payload::Pipeline => Bytes::Each(arguments.payload.bytes()),
                Payload::Block(bytes) => Bytes::Same(bytes),
            },
            scheduling: base.scheduling.name(),
            cpus: if base.cpus.is_empty() { hops::processors() } else { base.cpus.clone() },
            load: arguments.load,
            policy: policies[0].name(),
            rounds: arguments.rounds,
            confidence: CONFIDENCE,
            transports: rows(policies[0]),
            polling: policies.get(1).map(|policy| rows(*policy)).unwrap_or_default(),
            skipped,
        }
    }
}

/// The five figures of all messages that have arrived.
pub(super) fn figures(blocks: &[Block]) -> Figures {
    let mut all = Distribution::of_times();
    blocks.iter().flat_map(Block::arrived_ns).for_each(|latency| all.record(latency));
    all.figures()
}
