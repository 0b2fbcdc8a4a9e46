//! The results of a run: report, latencies, summary and picture, and the recorder that collects what they need.

pub mod latency;
pub mod picture;
pub mod recorder;
mod report;
pub mod ride;
pub mod summary;

pub use report::*;
