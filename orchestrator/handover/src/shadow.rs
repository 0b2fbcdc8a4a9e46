//! A process that runs beside the live one without ever being in charge, and what can be said of it at the end.
//!
//! Both get the same samples and answer the same scans, so they are compared scan by scan: what they say, and how
//! long they take. Nobody acts on what the shadow says. Assumption: both fill the stamps of their samples truly.
//!
//! Scans count from the first output of the shadow on; when it never has one, from its start.

mod table;

use std::collections::BTreeMap;

use figures::bootstrap;
use serde::{Deserialize, Serialize};
use shared_types::Role;

use crate::swap::agreement::{OutputSummary, differences, quantities};
use crate::swap::{LATE_NS, Output, Party};

/// Scans that wait for the other output; a shadow may be late by that many and still be compared.
const OPEN: u64 = 16;
/// Most scans that are kept for intervals; of more, every second, third and so on is kept.
const KEPT: u64 = 20_000;

/// How a shadow ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShadowOutcome {
    /// It ran as long as asked.
    #[default]
    Completed,
    /// It was ended early by the one who asked for it.
    Interrupted,
    /// The run ended first.
    RunEnded,
    /// The process ended by itself, or could not be started.
    Died,
    /// It gave no output in the last second, or never.
    Silent,
}

impl ShadowOutcome {
    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Interrupted => "interrupted",
            Self::RunEnded => "run ended",
            Self::Died => "died",
            Self::Silent => "silent",
        }
    }

    /// Whether the process was there to the end.
    pub const fn is_good(self) -> bool {
        matches!(self, Self::Completed | Self::Interrupted | Self::RunEnded)
    }
}

/// What a shadow did, `shadow --json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ShadowReport {
    /// Name of the role.
    pub role: String,
    /// Implementation or command of the live process.
    pub live: String,
    /// Implementation or command of the shadow.
    pub shadow: String,
    /// How it ended.
    pub outcome: ShadowOutcome,
    /// Why it ended so; empty when all went as asked.
    pub reason: String,
    /// Scans that the live process answered meanwhile.
    pub scans: u64,
    /// Of these, answered by the shadow.
    pub answered: u64,
    /// `answered / scans`.
    pub answered_share: f64,
    /// Answered by the shadow later than half a period (3 ms at least) after the scan.
    pub late: u64,
    /// Outputs that readers would drop: layout, numbers that are not finite, values that cannot be.
    pub invalid: u64,
    /// Outputs beyond the first for a scan, those that nobody could take in time included.
    pub repeated: u64,
    /// Scans on which both gave a valid output.
    pub compared: u64,
    /// Of these, scans on which one drove and the other did not.
    pub kind_differs: u64,
    /// Shadow minus live, quantity by quantity.
    pub differences: Vec<Difference>,
    /// From the publication of the scan to that of the output [ms].
    pub reaction_ms: Timing,
    /// From the inputs to the result [ms].
    pub compute_ms: Timing,
}

/// One quantity, shadow minus live.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Difference {
    /// What is compared.
    pub quantity: String,
    /// Unit of all numbers here.
    pub unit: String,
    /// Mean difference.
    pub mean: f64,
    /// 95 % interval of the mean; nothing with fewer than 20 scans.
    pub mean_interval: Option<[f64; 2]>,
    /// Largest magnitude.
    pub max_abs: f64,
}

/// How long both took.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Half of the live outputs were faster.
    pub live_p50: f64,
    /// 99 in 100 live outputs were faster.
    pub live_p99: f64,
    /// Half of the outputs of the shadow were faster.
    pub shadow_p50: f64,
    /// 99 in 100 outputs of the shadow were faster.
    pub shadow_p99: f64,
    /// Shadow over live, medians.
    pub ratio_p50: f64,
    /// 95 % interval of the ratio of the medians; nothing with fewer than 20 scans.
    pub ratio_p50_interval: Option<[f64; 2]>,
    /// Shadow over live, 99th percentiles.
    pub ratio_p99: f64,
    /// 95 % interval of the ratio of the 99th percentiles.
    pub ratio_p99_interval: Option<[f64; 2]>,
}

/// Collects the outputs of both.
#[derive(Debug, Clone)]
pub struct Study {
    role: Role,
    period_ns: u64,
    thin: u64,
    open: BTreeMap<u64, [Option<Output>; 2]>,
    first: Option<u64>,
    newest_live: u64,
    /// First and last number of an output of the shadow, and how many scans it has answered in all.
    sequences: [u64; 2],
    distinct: u64,
    last_output_ns: u64,
    missed_before: u64,
    counts: Counts,
    differences: Vec<Vec<f64>>,
    largest: Vec<f64>,
    reactions_ns: Vec<[f64; 2]>,
    computes_ns: Vec<[f64; 2]>,
}

#[derive(Debug, Clone, Default)]
struct Counts {
    scans: u64,
    answered: u64,
    late: u64,
    invalid: u64,
    repeated: u64,
    compared: u64,
    kind_differs: u64,
}

impl Study {
    /// A study of a role that is to see about `scans` scans.
    pub fn new(role: Role, period_ns: u64, scans: u64) -> Self {
        let count = quantities(role).len();
        Self {
            role,
            period_ns,
            thin: scans.div_ceil(KEPT).max(1),
            open: BTreeMap::new(),
            first: None,
            newest_live: 0,
            sequences: [0; 2],
            distinct: 0,
            last_output_ns: 0,
            missed_before: 0,
            counts: Counts::default(),
            differences: vec![Vec::new(); count],
            largest: vec![0.0; count],
            reactions_ns: Vec::new(),
            computes_ns: Vec::new(),
        }
    }

    /// Takes an output in that was seen at `now_ns`.
    pub fn output(&mut self, now_ns: u64, party: Party, output: Output) {
        let scan = output.scan;
        match party {
            Party::New => {
                self.last_output_ns = now_ns;
                self.counts.invalid += u64::from(output.content.is_err());
                // Only scans that the live one has just answered, or is about to, can be compared.
                if self.newest_live == 0 || scan.abs_diff(self.newest_live) > OPEN {
                    return;
                }
                if self.first.is_none() {
                    self.first = Some(scan);
                    self.sequences[0] = output.sequence;
                }
                self.sequences[1] = self.sequences[1].max(output.sequence);
            }
            Party::Old => {
                self.missed_before += u64::from(self.first.is_none());
                self.newest_live = self.newest_live.max(scan);
            }
        }
        let place = &mut self.open.entry(scan).or_default()[usize::from(party == Party::New)];
        let again = place.is_some();
        place.get_or_insert(output);
        if party == Party::New {
            self.counts.repeated += u64::from(again);
            self.distinct += u64::from(!again);
        }
        while let Some(entry) = self.open.first_entry()
            && *entry.key() + OPEN < self.newest_live
        {
            let (scan, pair) = entry.remove_entry();
            self.close(scan, pair);
        }
    }

    /// When the newest output of the shadow was seen [ns]; 0 when there was none.
    pub fn last_output_ns(&self) -> u64 {
        self.last_output_ns
    }

    /// All that can be said; takes up to a second for many scans.
    pub fn report(mut self) -> ShadowReport {
        for (scan, pair) in std::mem::take(&mut self.open) {
            // The shadow may be about to answer the newest one.
            if scan < self.newest_live || pair.iter().all(Option::is_some) {
                self.close(scan, pair);
            }
        }
        let Counts { scans, answered, late, invalid, repeated, compared, kind_differs } = self.counts;
        // What an actuator says by itself has numbers too and answers nothing.
        let [first, last] = self.sequences;
        let counted = if self.role == Role::Actuator || self.distinct == 0 { 0 } else { last - first + 1 };
        let repeated = repeated.max(counted.saturating_sub(self.distinct));
        let scans = if self.first.is_none() { self.missed_before } else { scans };
        let differences = quantities(self.role).iter().zip(self.differences.iter().zip(&self.largest));
        ShadowReport {
            role: self.role.name().to_owned(),
            scans,
            answered,
            answered_share: answered as f64 / scans.max(1) as f64,
            late,
            invalid,
            repeated,
            compared,
            kind_differs,
            differences: differences
                .map(|((quantity, unit), (values, max_abs))| {
                    let (mean, mean_interval) = bootstrap::mean(values);
                    Difference {
                        quantity: (*quantity).to_owned(),
                        unit: (*unit).to_owned(),
                        mean,
                        mean_interval,
                        max_abs: *max_abs,
                    }
                })
                .collect(),
            reaction_ms: timing(&self.reactions_ns),
            compute_ms: timing(&self.computes_ns),
            ..ShadowReport::default()
        }
    }

    /// Nothing more will come for this scan.
    fn close(&mut self, scan: u64, [live, shadow]: [Option<Output>; 2]) {
        let Some(live) = live.filter(|_| self.first.is_some_and(|first| scan >= first)) else { return };
        self.counts.scans += 1;
        let Some(shadow) = shadow else { return };
        self.counts.answered += 1;
        let kept = self.counts.answered.is_multiple_of(self.thin);
        self.time(&live, &shadow, kept);
        let (Ok(live), Ok(shadow)) = (&live.content, &shadow.content) else { return };
        self.counts.compared += 1;
        self.compare(live, shadow, kept);
    }

    fn time(&mut self, live: &Output, shadow: &Output, kept: bool) {
        let reaction_ns =
            [live, shadow].map(|output| output.published_ns.saturating_sub(output.scan_published_ns));
        self.counts.late += u64::from(reaction_ns[1] > (self.period_ns / 2).max(LATE_NS));
        if kept {
            self.reactions_ns.push(reaction_ns.map(|time| time as f64));
            self.computes_ns.push([live, shadow].map(|output| output.compute_ns as f64));
        }
    }

    fn compare(&mut self, live: &OutputSummary, shadow: &OutputSummary, kept: bool) {
        let Some(differences) = differences(live, shadow) else {
            self.counts.kind_differs += 1;
            return;
        };
        for (index, difference) in differences.into_iter().enumerate() {
            self.largest[index] = self.largest[index].max(difference.abs());
            if kept {
                self.differences[index].push(difference);
            }
        }
    }
}

fn timing(pairs_ns: &[[f64; 2]]) -> Timing {
    let quantile_ms = |index: usize, quantile: f64| {
        let mut values: Vec<f64> = pairs_ns.iter().map(|pair| pair[index] * 1e-6).collect();
        bootstrap::quantile_of(&mut values, quantile)
    };
    let (ratio_p50, ratio_p50_interval) = bootstrap::ratio(pairs_ns, 0.5);
    let (ratio_p99, ratio_p99_interval) = bootstrap::ratio(pairs_ns, 0.99);
    Timing {
        live_p50: quantile_ms(0, 0.5),
        live_p99: quantile_ms(0, 0.99),
        shadow_p50: quantile_ms(1, 0.5),
        shadow_p99: quantile_ms(1, 0.99),
        ratio_p50,
        ratio_p50_interval,
        ratio_p99,
        ratio_p99_interval,
    }
}

#[cfg(test)]
mod tests;
