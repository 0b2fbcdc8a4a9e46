//! Compares a process that is never in charge, the shadow, with the live one.
//!
//! Both receive the same samples and answer the same scans, so they are compared scan by scan: the content of their
//! outputs, and how long they take. Nothing acts on the outputs of the shadow. Assumption: both fill the stamps of
//! their samples correctly.
//!
//! Scans count from the first output of the shadow on; when it never has one, from its start.

mod report;

use std::collections::BTreeMap;

use figures::bootstrap;
use shared_types::Role;

use crate::swap::agreement::{OutputSummary, differences, quantities};
use crate::swap::{LATE_NS, Party, SwapOutput};

pub use report::{QuantityDifference, ShadowOutcome, ShadowReport, Timing};

/// Scans that wait for the other output: a shadow that is late by as many is still compared.
const OPEN: u64 = 16;
/// Scans that are kept for intervals at most; of more, every second, third and so on is kept.
const MAX_SCANS: u64 = 20_000;

/// Collects the outputs of both.
#[derive(Debug, Clone)]
pub struct Study {
    role: Role,
    period_ns: u64,
    thin: u64,
    open: BTreeMap<u64, [Option<SwapOutput>; 2]>,
    first: Option<u64>,
    newest_live: u64,
    /// First and last number of an output of the shadow, and how many scans it has answered in all.
    sequences: [u64; 2],
    distinct: u64,
    last_output_ns: u64,
    missed_before: u64,
    /// Holds the counts.
    report: ShadowReport,
    differences: Vec<Vec<f64>>,
    largest: Vec<f64>,
    reactions_ns: Vec<[f64; 2]>,
    computes_ns: Vec<[f64; 2]>,
}

impl Study {
    /// A study of a role over about `scans` scans.
    pub fn new(role: Role, period_ns: u64, scans: u64) -> Self {
        let count = quantities(role).len();
        Self {
            role,
            period_ns,
            thin: scans.div_ceil(MAX_SCANS).max(1),
            open: BTreeMap::new(),
            first: None,
            newest_live: 0,
            sequences: [0; 2],
            distinct: 0,
            last_output_ns: 0,
            missed_before: 0,
            report: ShadowReport { role: role.name().to_owned(), ..ShadowReport::default() },
            differences: vec![Vec::new(); count],
            largest: vec![0.0; count],
            reactions_ns: Vec::new(),
            computes_ns: Vec::new(),
        }
    }

    /// Adds an output that was received at `now_ns`.
    pub fn output(&mut self, now_ns: u64, party: Party, output: SwapOutput) {
        let scan = output.scan;
        match party {
            Party::New => {
                self.last_output_ns = now_ns;
                self.report.invalid += u64::from(output.content.is_err());
                // Only scans near the newest one of the live process can be compared.
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
            self.report.repeated += u64::from(again);
            self.distinct += u64::from(!again);
        }
        while let Some(entry) = self.open.first_entry()
            && *entry.key() + OPEN < self.newest_live
        {
            let (scan, pair) = entry.remove_entry();
            self.close(scan, pair);
        }
    }

    /// When the newest output of the shadow was received [ns]; 0 when there was none.
    pub fn last_output_ns(&self) -> u64 {
        self.last_output_ns
    }

    /// The report; takes up to a second for many scans.
    pub fn report(mut self) -> ShadowReport {
        for (scan, pair) in std::mem::take(&mut self.open) {
            // The shadow may be about to answer the newest one.
            if scan < self.newest_live || pair.iter().all(Option::is_some) {
                self.close(scan, pair);
            }
        }
        let mut report = self.report;
        // Outputs of an actuator without a command have numbers too and answer no scan.
        let [first, last] = self.sequences;
        let counted = if self.role == Role::Actuator || self.distinct == 0 { 0 } else { last - first + 1 };
        report.repeated = report.repeated.max(counted.saturating_sub(self.distinct));
        if self.first.is_none() {
            report.scans = self.missed_before;
        }
        report.answered_share = report.answered as f64 / report.scans.max(1) as f64;
        let differences = quantities(self.role).iter().zip(self.differences.iter().zip(&self.largest));
        let differences = differences.map(|((quantity, unit), (values, max_abs))| {
            let (mean, mean_interval) = bootstrap::mean(values);
            let (quantity, unit) = ((*quantity).to_owned(), (*unit).to_owned());
            QuantityDifference { quantity, unit, mean, mean_interval, max_abs: *max_abs }
        });
        report.differences = differences.collect();
        report.reaction_ms = timing(&self.reactions_ns);
        report.compute_ms = timing(&self.computes_ns);
        report
    }

    /// Compares the outputs for a scan that is complete, or too old to become so.
    fn close(&mut self, scan: u64, [live, shadow]: [Option<SwapOutput>; 2]) {
        let Some(live) = live.filter(|_| self.first.is_some_and(|first| scan >= first)) else { return };
        self.report.scans += 1;
        let Some(shadow) = shadow else { return };
        self.report.answered += 1;
        let kept = self.report.answered.is_multiple_of(self.thin);
        self.time(&live, &shadow, kept);
        let (Ok(live), Ok(shadow)) = (&live.content, &shadow.content) else { return };
        self.report.compared += 1;
        self.compare(live, shadow, kept);
    }

    fn time(&mut self, live: &SwapOutput, shadow: &SwapOutput, kept: bool) {
        let reaction_ns =
            [live, shadow].map(|output| output.published_ns.saturating_sub(output.scan_published_ns));
        self.report.late += u64::from(reaction_ns[1] > (self.period_ns / 2).max(LATE_NS));
        if kept {
            self.reactions_ns.push(reaction_ns.map(|time| time as f64));
            self.computes_ns.push([live, shadow].map(|output| output.compute_ns as f64));
        }
    }

    fn compare(&mut self, live: &OutputSummary, shadow: &OutputSummary, kept: bool) {
        let Some(differences) = differences(live, shadow) else {
            self.report.kind_differs += 1;
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
