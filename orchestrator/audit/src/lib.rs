//! What became of each sample: the observed topics, the ledger of scans, the sample audit, the digests.

pub mod digest;
pub mod ledger;
pub mod samples;
