//! What is known of a run before it starts, and after it ended.

use audit::ledger::DelayRow;
use emulator::referee::Landing;
use handover::swap::Certificate;
use vehicle::{Course, Goals, Surroundings};

use crate::report::{LedgerReport, Outcome, ProcessReport, RecordingReport};

/// The properties of a run that are known before it starts.
#[derive(Debug, Clone, PartialEq)]
pub struct RunInfo {
    /// The random id of the run.
    pub run_id: String,
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// What the scanner sees outside of the track.
    pub surroundings: Surroundings,
    /// The course that the robot follows; there are no figures of the ride then.
    pub course: Option<Course>,
    /// Whether time is simulated, so that stamps are not times of this computer.
    pub lockstep: bool,
    /// Number of the first scan of the ledger: 1 for a whole run, 0 for the first one that is seen.
    pub first_scan: u64,
    /// Scan period [ns].
    pub period_ns: u64,
    /// The goals in their order; there are no figures of the ride with several.
    pub goals: Goals,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunResult {
    /// How it ended.
    pub outcome: Outcome,
    /// Why; empty when the outcome is reason enough.
    pub reason: String,
    /// What became of each goal.
    pub goals: Vec<Landing>,
    /// The processes that filled the roles.
    pub processes: Vec<ProcessReport>,
    /// The processes beside the loop.
    pub companions: Vec<crate::report::CompanionReport>,
    /// Swaps of processes.
    pub swaps: Vec<Certificate>,
    /// What became of every sample.
    pub ledger: LedgerReport,
    /// Delays at the ends of topics beside the loop.
    pub companion_delays: Vec<DelayRow>,
    /// The recording; `None` when the run was not recorded.
    pub recording: Option<RecordingReport>,
    /// Files with the last seconds before an incident.
    pub incidents: Vec<std::path::PathBuf>,
}
