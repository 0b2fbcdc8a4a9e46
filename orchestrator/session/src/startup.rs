//! Start-up of a session, and the options of a run.

use std::path::PathBuf;

use agent::link::HubLink;
use emulator::JudgedBy;
use runtime::{Bus, Shutdown, StopWord};
use shared_types::Directive;
use supervision::fleet::Fleet;
use supervision::supervisor::Event;

use crate::own_processes::OwnProcesses;

/// Options of a run, apart from scenario and system.
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

/// What a session starts from: a new system, or one that another orchestrator left.
pub(crate) struct Startup {
    pub(crate) bus: Bus,
    pub(crate) stop_word: StopWord,
    pub(crate) fleet: Fleet,
    pub(crate) companions: OwnProcesses,
    /// Receives signals since before the first file was made.
    pub(crate) shutdown: Shutdown,
    pub(crate) events: Vec<Event>,
    pub(crate) directive: Directive,
    /// 0 when another orchestrator has started the run.
    pub(crate) first_scan: u64,
    /// What decides the outcome; `None` until the robot is connected.
    pub(crate) judged_by: Option<JudgedBy>,
    /// The bridge to the other hosts of the system.
    pub(crate) link: Option<HubLink>,
}
