//! Scans, samples and refusals as `report.json` has them.

use std::collections::BTreeMap;
use std::fmt;

use runtime::Delays;
use serde::{Deserialize, Serialize};
use shared_types::InputAccount;

use super::fault::DeliveryFault;
use super::refused::RefusedRow;

/// Counts of scans: `published = commanded + lost + unaccounted`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ScanReport {
    /// Scans published.
    pub published: u64,
    /// Scans that an actuation answered, the late ones included.
    pub commanded: u64,
    /// Scans answered more than a period after they were published, and after the next one.
    pub late: u64,
    /// Scans never answered.
    pub lost: u64,
    /// Scans without a fate; must be 0.
    pub unaccounted: u64,
    /// Scans that the scanner gave no ranges for; they are commanded or lost like any other.
    pub missing: u64,
    /// Answers to scans that had been answered already.
    pub duplicates: u64,
    /// How many scans were lost for which reason.
    pub lost_reasons: BTreeMap<String, u64>,
}

/// Result of the sample audit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LedgerReport {
    /// How often samples were reconciled.
    pub closings: u64,
    /// Samples that are missing without a reason; must be 0.
    pub residual: u64,
    /// Samples that came twice; must be 0.
    pub duplicates: u64,
    /// Samples that came after a later one; must be 0.
    pub reordered: u64,
    /// Samples with a number that no scan, or no sample of their writer, can have; must be 0.
    pub impossible: u64,
    /// Samples that the orchestrator polled too late to see; their readers counted them.
    pub unobserved: u64,
    /// Samples that were lost between two hosts, by reason: `link`, `age`, `clock`, `layout` or `newer`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub link_losses: BTreeMap<String, u64>,
    /// Counts per topic and role that reads it.
    pub topics: Vec<LedgerRow>,
    /// Counts per topic and process beside the loop: topics of your own, and what companions read of the loop.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub companions: Vec<LedgerRow>,
    /// Processes that fill no role and published on topics of the loop; their samples count nowhere.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub strangers: Vec<StrangerRow>,
    /// Samples that a reader dropped or refused because of their content: by writer, reader and rule.
    pub refused: Vec<RefusedRow>,
    /// Faults sample by sample; at most a thousand.
    pub faults: Vec<DeliveryFault>,
}

/// Counts of one topic at one reader: `published = used + replaced + lost + in_flight + residual`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LedgerRow {
    /// Name of the topic.
    pub topic: String,
    /// Role or companion that reads it.
    pub reader: String,
    /// Samples published, once per process that should receive them.
    pub published: u64,
    /// Samples used.
    pub used: u64,
    /// Samples that a rule drops: a newer one was used, too old, without authority, bad content.
    pub replaced: u64,
    /// Samples lost with a process that died, or between two hosts.
    pub lost: u64,
    /// Samples on their way or waiting at the end.
    pub in_flight: u64,
    /// Unexplained samples; must be 0.
    pub residual: u64,
    /// Samples that came twice, not part of the sum; must be 0.
    pub duplicates: u64,
    /// Samples that came after a later one and were dropped, part of the residual; must be 0.
    pub reordered: u64,
    /// How many were replaced, or lost between two hosts, for which reason: `newer`, `queue_full`, `age`, `authority`,
    /// `content`, `layout`, `link` or `clock`.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub reasons: BTreeMap<String, u64>,
}

/// Samples on a topic of the loop from a process that fills no role.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StrangerRow {
    /// Name of the topic.
    pub topic: String,
    /// The incarnation that the samples name.
    pub incarnation: u32,
    /// How many were seen.
    pub samples: u64,
}

/// Delays at one end of a topic beside the loop.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct DelayRow {
    /// Name of the topic.
    pub topic: String,
    /// Process that reads or writes it.
    pub process: String,
    /// Whether it writes it. Then the delay is from the publication of the scan to that of the sample, otherwise from the
    /// publication of the sample until it was taken.
    pub writes: bool,
    /// Samples measured.
    pub count: u64,
    /// Mean [us].
    pub mean_us: f64,
    /// Longest [us].
    pub max_us: f64,
}

impl fmt::Display for StrangerRow {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, incarnation, .. } = self;
        write!(
            formatter,
            "incarnation {incarnation} publishes on topic {topic} and fills no role: it is ignored"
        )
    }
}

impl LedgerRow {
    /// Adds the counts of another process of the same reader.
    pub(super) fn add(&mut self, other: &Self) {
        self.published += other.published;
        self.used += other.used;
        self.replaced += other.replaced;
        self.lost += other.lost;
        self.in_flight += other.in_flight;
        self.residual += other.residual;
        self.duplicates += other.duplicates;
        self.reordered += other.reordered;
        other.reasons.iter().for_each(|(reason, count)| self.count(reason, *count));
    }

    /// Adds the samples that one process has dropped or replaced by a rule.
    pub(super) fn replace(&mut self, account: &InputAccount) {
        for (reason, count) in account.by_rule() {
            self.replaced += count;
            self.count(reason, count);
        }
    }

    /// Adds samples to those of a reason.
    pub(super) fn count(&mut self, reason: &str, count: u64) {
        if count > 0 {
            *self.reasons.entry(reason.to_owned()).or_default() += count;
        }
    }
}

impl DelayRow {
    /// Adds the delays of another process at the same end.
    pub(super) fn add(&mut self, delays: &Delays) {
        let sum_us = self.mean_us * self.count as f64 + delays.sum_ns as f64 * 1e-3;
        self.count += delays.count;
        self.mean_us = sum_us / self.count.max(1) as f64;
        self.max_us = self.max_us.max(delays.max_ns as f64 * 1e-3);
    }
}
