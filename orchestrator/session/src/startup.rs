//! What a session begins with.

use std::path::PathBuf;

use runtime::{Bus, Shutdown, StopWord};
use shared_types::Directive;
use supervision::fleet::Fleet;
use supervision::supervisor::Event;

/// How a run is driven, apart from what.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// Simulated time.
    pub lockstep: bool,
    /// Driven time after which it ends [s].
    pub duration_s: Option<f64>,
    /// No progress line.
    pub quiet: bool,
    /// Where results are written; an absolute path.
    pub out: PathBuf,
}

/// What the one who drives a run begins with: nothing, or what another orchestrator left.
pub(crate) struct Startup {
    pub(crate) bus: Bus,
    pub(crate) word: StopWord,
    pub(crate) fleet: Fleet,
    /// Listens since before the first of them was made.
    pub(crate) shutdown: Shutdown,
    pub(crate) events: Vec<Event>,
    pub(crate) directive: Directive,
    /// 0 when another orchestrator has begun.
    pub(crate) first_scan: u64,
}
