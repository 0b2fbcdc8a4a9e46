//! The results of a run: report, latencies, summary and picture, the recorder that collects what they need, and drives compared.

pub mod compare;
pub mod latency;
pub mod picture;
pub mod recorder;
mod report;
pub mod ride;
pub mod summary;

pub use report::*;
