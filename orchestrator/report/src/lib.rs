//! What a run is told by: the report, where the time went, the summary, the picture.

pub mod latency;
pub mod picture;
pub mod recorder;
mod report;
pub mod summary;

pub use report::*;
