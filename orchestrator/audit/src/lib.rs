//! What became of each sample: the observed topics, the account of all scans, the digests.

pub mod digest;
pub mod ledger;
pub mod samples;
