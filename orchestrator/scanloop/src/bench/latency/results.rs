//! The result of the bench, as the JSON that it prints.

use figures::Figures;
use report::{PerStage, ScanReport};
use serde::Serialize;

use super::machine::Machine;

/// Version of the fields; it grows when a field changes its meaning, not when one is added.
pub(crate) const SCHEMA: u32 = 1;

/// The whole result; keys end with their unit.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct LatencyResults {
    /// [`SCHEMA`].
    pub schema: u32,
    /// The Cargo profile that the executable was built with.
    pub profile: &'static str,
    /// Scans per second by the schedule [Hz].
    pub rate_hz: f64,
    /// Driven time [s].
    pub duration_s: f64,
    /// `real` or `none`.
    pub compute: &'static str,
    /// Bytes on each hop; null for the pipeline's own samples.
    pub payload_bytes: Option<usize>,
    /// How the drive ended; `timeout` is as asked for.
    pub outcome: String,
    /// Why.
    pub reason: String,
    /// What became of the scans.
    #[serde(flatten)]
    pub scans: ScanReport,
    /// Unexplained samples of all topics.
    pub residual: u64,
    /// Faults that the sample audit found.
    pub faults: Vec<String>,
    /// Actuations that carry the stamps of all stages.
    pub complete_chains: u64,
    /// From the publication of a scan to that of its actuation.
    pub scan_to_actuation_us: Figures,
    /// The same from when the scan was due, including lost scans: corrected for coordinated omission.
    pub scan_to_actuation_corrected_us: Figures,
    /// From the front beam of a scan to its actuation.
    pub data_age_us: Figures,
    /// Scan to actuation without compute: wake-ups, bus, publications.
    pub transport_us: Figures,
    /// Compute of each stage.
    pub stages_us: PerStage,
    /// From the publication of the predecessor until a stage has taken its inputs.
    pub hops_us: PerStage,
    /// From a stage's result until it was published.
    pub publications_us: PerStage,
    /// How late the robot woke for a scan.
    pub robot_lateness_us: Figures,
    /// How late an idle process wakes, measured before the run.
    pub wake_up_noise_us: Figures,
    /// Time for the stamps of one stage and scan.
    pub stamps_us_per_stage: f64,
    /// The smallest difference to a like run that `bench compare` detects with 90 % probability; null for too short a
    /// run.
    pub smallest_visible_us: Smallest,
    /// The machine.
    pub machine: Machine,
    /// Scans of a stretch of the run.
    pub interval_scans: u64,
    /// Lines of a HdrHistogram log: all series in stretches of the run [ns].
    pub intervals: Vec<String>,
}

/// Smallest differences that are detected [us].
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(crate) struct Smallest {
    /// Of the medians of scan to actuation.
    pub p50: Option<f64>,
    /// Of its 99 %.
    pub p99: Option<f64>,
}
