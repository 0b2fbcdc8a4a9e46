//! Scans, samples and refusals as `report.json` has them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::fault::Fault;
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
    /// Samples that the orchestrator polled too late to see; their readers counted them.
    pub unobserved: u64,
    /// Counts per topic and role that reads it.
    pub topics: Vec<LedgerRow>,
    /// Samples that a reader dropped or refused because of their content: by writer, reader and rule.
    pub refused: Vec<RefusedRow>,
    /// Faults sample by sample; at most a thousand.
    pub faults: Vec<Fault>,
}

/// Counts of one topic at one reader: `published = used + replaced + lost + in_flight + residual`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LedgerRow {
    /// Name of the topic.
    pub topic: String,
    /// Role that reads it.
    pub reader: String,
    /// Samples published, once per process that should receive them.
    pub published: u64,
    /// Samples used.
    pub used: u64,
    /// Samples that a rule drops: a newer one was used, too old, without authority, bad content.
    pub replaced: u64,
    /// Samples lost with a process that died.
    pub lost: u64,
    /// Samples on their way or waiting at the end.
    pub in_flight: u64,
    /// Unexplained samples; must be 0.
    pub residual: u64,
    /// Samples that came twice, not part of the sum; must be 0.
    pub duplicates: u64,
    /// Samples that came after a later one and were dropped, part of the residual; must be 0.
    pub reordered: u64,
}
