//! `report.json`: what a run did, as data.
//!
//! The fields are a public interface: they are extended, never changed. Keys end with their unit;
//! the figures of a distribution have the unit of their key. The file is written under a temporary name and renamed,
//! so a reader sees all of it or none. Equal runs give equal bytes in `trajectory`: numbers are printed with the
//! digits that read back to the same bits.

mod parts;
mod write;

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use crate::ride::RideFigures;
pub use audit::ledger::{DelayRow, LedgerReport, LedgerRow, ScanReport};
use console::user_file::{self, DATA_BYTES};
pub use emulator::referee::Landing;
pub use emulator::{JudgedBy, Outcome};
use figures::Figures;
use handover::swap::Certificate;
use serde::{Deserialize, Deserializer, Serialize};
use vehicle::Surroundings;

use self::write::join_leaves;

pub use self::parts::{
    BlockingReport, CompanionReport, DifferenceReport, DriverChange, GoalChange, MarginReport,
    RecordingReport, ScannerReport, ScannerStatus,
};

/// Version of the fields; it grows when a field changes its meaning, not when one is added.
pub const SCHEMA: u32 = 1;

/// The whole report of one run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Report {
    /// [`SCHEMA`].
    pub schema: u32,
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// What the scanner sees outside of the track.
    pub surroundings: Surroundings,
    /// How the run ended.
    pub outcome: Outcome,
    /// What decided that. With `estimate`, figures of the drive and `trajectory` are estimated, and what only the truth
    /// knows is left out.
    pub judged_by: JudgedBy,
    /// Why it ended so; empty when the outcome is reason enough.
    pub reason: String,
    /// Whether time was simulated.
    pub lockstep: bool,
    /// The random id of the run, part of the names of its shared memory.
    pub run_id: String,
    /// Whether another orchestrator began the run. The report then covers the time since the run was adopted; only what
    /// the robot counts covers all of it.
    pub adopted: bool,
    /// The first scan that the report of an adopted run covers.
    pub adopted_from_scan: Option<u64>,
    /// Driven time [s].
    pub duration_s: f64,
    /// What became of every scan.
    pub scans: ScanReport,
    /// What became of every sample.
    pub ledger: LedgerReport,
    /// Where the time went [us].
    pub latency_us: LatencyReport,
    /// Motion of the robot.
    pub drive: DriveReport,
    /// The clearance that the driven plans kept, by its parts [m].
    pub margin_m: MarginReport,
    /// How it was driven, from the first drive command to 1.75 m before the goal; `Some(None)` when it did not get there,
    /// `None` without a truth.
    #[serde(skip_serializing_if = "Option::is_none", deserialize_with = "present")]
    pub ride: Option<Option<RideFigures>>,
    /// What became of each goal.
    pub goals: Vec<Landing>,
    /// Goals that changed while the robot drove.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub goal_changes: Vec<GoalChange>,
    /// When another drove than before; first the controller does.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub driver_changes: Vec<DriverChange>,
    /// How the scanner was.
    pub scanner: ScannerReport,
    /// The obstacle of the last stop that had one.
    pub blocking: Option<BlockingReport>,
    /// Where the scenario differs from the description of the robot.
    pub differences: Vec<DifferenceReport>,
    /// How the controller solved its problems.
    pub controller: ControllerReport,
    /// How often each reason blocked the wheels, commands and the actuator's own blocks by name.
    pub stop_reasons: BTreeMap<String, u64>,
    /// What the estimator's self-check of the calibration found.
    pub self_check: SelfCheckReport,
    /// What the estimator learned of the robot until the end, and the standard deviation, by the keys of [`shared_types::LEARNED`].
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub learned: BTreeMap<String, [f64; 2]>,
    /// The processes that filled the roles.
    pub processes: Vec<ProcessReport>,
    /// Processes beside the loop.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub companions: Vec<CompanionReport>,
    /// Swaps of processes, in the order in which they ended.
    pub swaps: Vec<Certificate>,
    /// The recording of the run; `None` when it was not recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording: Option<RecordingReport>,
    /// Files with the last seconds before a death, a rollback, a collision or a stop.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub incidents: Vec<std::path::PathBuf>,
    /// Hash of all samples per topic in lock-step: equal runs have equal samples.
    pub digests: BTreeMap<String, String>,
    /// Number of first rows that `trajectory` lacks because the run was too long to keep them.
    pub trajectory_rows_dropped: u64,
    /// Time, position and yaw per scan: t [s], x [m], y [m], yaw [rad].
    pub trajectory: Vec<[f64; 4]>,
}

/// What the estimator's self-check of the calibration found.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct SelfCheckReport {
    /// Number of alarms.
    pub alarms: u64,
    /// What the newest alarm suspects, `none` without one.
    pub suspect: String,
    /// The strongest alarm: `none`, `slow` or `stop`.
    pub alarm: String,
    /// Scan of the first alarm, 0 without one.
    pub first_scan: u64,
    /// Measurements that the gate of the filter refused.
    pub rejected: u64,
}

/// Distributions of times along the way from scan to actuation [us].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LatencyReport {
    /// From the publication of a scan to that of its actuation.
    pub scan_to_actuation: Figures,
    /// From the front beam of a scan to the publication of its actuation.
    pub data_age: Figures,
    /// Compute per stage, and everything else on the critical path as `transport`.
    pub stages: Stages,
    /// From the publication of the predecessor until the stage has taken its inputs.
    pub hops: PerStage,
    /// Awake before the predecessor published; overlaps with its work and is not on the critical path.
    pub waits: PerStage,
    /// From the result until it was published.
    pub publications: PerStage,
    /// Whether stamps come from a simulated clock; no time is recorded then.
    pub simulated: bool,
    /// Answers with stamps of all stages.
    pub complete_chains: u64,
    /// Answers without stamps of all stages; they count in the first two distributions only.
    pub incomplete_chains: u64,
    /// Delays beside the loop: of topics of your own, and of what companions read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub companions: Vec<DelayRow>,
}

/// Compute of each stage and the transport between them [us].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Stages {
    /// Compute per stage.
    #[serde(flatten)]
    pub compute: PerStage,
    /// Reaction time minus all compute on the critical path.
    pub transport: Figures,
}

/// One distribution per stage [us].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PerStage {
    /// Of the estimator.
    pub estimator: Figures,
    /// Of the obstacle description.
    pub obstacles: Figures,
    /// Of the controller.
    pub controller: Figures,
    /// Of the actuator.
    pub actuator: Figures,
}

impl PerStage {
    /// The distributions in the order of the data flow.
    pub fn each(&self) -> [&Figures; 4] {
        [&self.estimator, &self.obstacles, &self.controller, &self.actuator]
    }
}

/// Motion of the robot, by the truth or by the estimate.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct DriveReport {
    /// Distance of the robot's centre to the goal at the end [m].
    pub final_distance_m: f64,
    /// Speed over ground at the last scan [m/s].
    pub final_speed_mps: f64,
    /// Length of the driven path [m].
    pub path_length_m: f64,
    /// Largest lateral offset from the start [m].
    pub max_abs_lateral_m: f64,
    /// Smallest speed limit of all commands that drove; `None` when the controller states none [m/s].
    pub speed_limit_mps: Option<f64>,
    /// What only the truth knows; its keys stand with the others, or are left out.
    #[serde(flatten)]
    pub truth: Option<TrueDrive>,
}

/// What only the true state of the robot shows of a drive, as the referee of the emulator saw it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrueDrive {
    /// Smallest distance of the body to any obstacle or wall, negative when they overlapped; 1e9 without any [m].
    pub min_clearance_m: f64,
    /// Largest distance of the estimated to the true position at the same scan [m].
    pub estimate_error_max_m: f64,
    /// Root of the mean square of that distance [m].
    pub estimate_error_rms_m: f64,
    /// Share of scans in which the 95 % ellipse of the estimated position contained the true one; `None` without scans.
    pub covariance_coverage: Option<f64>,
    /// Longest time that the wheels turned without a new actuation [s].
    pub longest_blind_s: f64,
    /// Whether the body touched something while the wheels turned.
    pub collided: bool,
    /// Whether a moving obstacle touched the body while it stood still.
    pub struck: bool,
}

/// Clearance that stands for a scene without obstacles and walls [m].
pub const NO_OBSTACLE_M: f64 = 1e9;

impl Default for TrueDrive {
    fn default() -> Self {
        Self {
            min_clearance_m: NO_OBSTACLE_M,
            estimate_error_max_m: 0.0,
            estimate_error_rms_m: 0.0,
            covariance_coverage: None,
            longest_blind_s: 0.0,
            collided: false,
            struck: false,
        }
    }
}

/// A key that is there, whatever its value: a key that is left out takes the default.
fn present<'de, D: Deserializer<'de>, T: Deserialize<'de>>(value: D) -> Result<Option<T>, D::Error> {
    T::deserialize(value).map(Some)
}

/// How the controller solved its problems.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ControllerReport {
    /// Time per solved problem; empty in lock-step [us].
    pub solve_us: Figures,
    /// SQP iterations per solved problem.
    pub iterations: Figures,
    /// Commands by the status of their solution.
    pub status: BTreeMap<String, u64>,
    /// Commands by the level of the planner's fallback that they come from.
    pub level: BTreeMap<String, u64>,
}

/// One process of the run.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ProcessReport {
    /// The role it filled.
    pub role: String,
    /// Name of the implementation.
    pub implementation: String,
    /// Its last process id.
    pub pid: u32,
    /// How often it was started again.
    pub restarts: u32,
    /// Its state at the end.
    pub state: String,
}

impl Report {
    /// The report as text: one line per figure set and per row of the trajectory, so that people can read it.
    ///
    /// # Errors
    /// Never for values of these types; the serialiser's error otherwise.
    pub fn to_json(&self) -> serde_json::Result<String> {
        Ok(join_leaves(&serde_json::to_string_pretty(self)?))
    }

    /// Reads a report; fields it does not know are left out, missing ones have their defaults.
    ///
    /// # Errors
    /// When the file can't be read, or is not a report.
    pub fn read(path: &Path) -> io::Result<Self> {
        Ok(serde_json::from_slice(&user_file::read_bytes(path, DATA_BYTES)?)?)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn report() -> Report {
        Report {
            schema: SCHEMA,
            scenario: "corridor {".to_owned(),
            seed: 7,
            outcome: Outcome::Reached,
            differences: vec![DifferenceReport {
                key: "width_m".to_owned(),
                truth: 1.4.into(),
                believed: 0.4.into(),
            }],
            drive: DriveReport { truth: Some(TrueDrive::default()), ..DriveReport::default() },
            ride: Some(Some(RideFigures::default())),
            trajectory: vec![[0.0, 0.1, -0.2, 1.0 / 3.0], [0.1, 0.2, -0.2, 1e-17]],
            processes: vec![ProcessReport {
                role: "controller".to_owned(),
                pid: 12,
                ..ProcessReport::default()
            }],
            ..Report::default()
        }
    }

    #[test]
    fn rows_and_figures_stand_on_one_line_each() {
        let text = report().to_json().unwrap();
        assert!(
            text.contains(
                "\n    [0.0, 0.1, -0.2, 0.3333333333333333],\n    [0.1, 0.2, -0.2, 1e-17]\n  ]\n}\n"
            ),
            "{text}"
        );
        assert!(text.contains(
            "\n    \"scan_to_actuation\": { \"count\": 0, \"p50\": 0.0, \"p90\": 0.0, \"p99\": 0.0, \"p999\": 0.0, \"max\": 0.0 },\n"
        ));
        assert!(text.starts_with("{\n  \"schema\": 1,\n  \"scenario\": \"corridor {\",\n  \"seed\": 7,\n  \"surroundings\": \"hall\",\n  \"outcome\": \"reached\",\n"));
    }

    #[test]
    fn a_report_is_read_back_bit_by_bit() {
        let report = report();
        assert_eq!(serde_json::from_str::<Report>(&report.to_json().unwrap()).unwrap(), report);
    }

    #[test]
    fn all_keys_of_the_public_interface_are_there() {
        let value: serde_json::Value = serde_json::from_str(&report().to_json().unwrap()).unwrap();
        for pointer in [
            "/schema",
            "/scenario",
            "/seed",
            "/surroundings",
            "/outcome",
            "/judged_by",
            "/lockstep",
            "/duration_s",
            "/scans/published",
            "/scans/commanded",
            "/scans/late",
            "/scans/lost",
            "/scans/unaccounted",
            "/scans/lost_reasons",
            "/ledger/residual",
            "/ledger/topics",
            "/ledger/faults",
            "/latency_us/scan_to_actuation/p999",
            "/latency_us/stages/estimator/count",
            "/latency_us/stages/obstacles/count",
            "/latency_us/stages/controller/count",
            "/latency_us/stages/actuator/count",
            "/latency_us/stages/transport/count",
            "/drive/final_distance_m",
            "/drive/min_clearance_m",
            "/drive/path_length_m",
            "/drive/max_abs_lateral_m",
            "/drive/estimate_error_max_m",
            "/drive/estimate_error_rms_m",
            "/drive/covariance_coverage",
            "/drive/speed_limit_mps",
            "/drive/collided",
            "/margin_m/base",
            "/margin_m/pose",
            "/margin_m/latency",
            "/margin_m/model",
            "/margin_m/perception",
            "/ride/objective",
            "/ride/steering_total_variation_rad",
            "/ride/steering_second_difference_rad",
            "/ride/steering_step_max_rad",
            "/ride/lateral_acceleration_max_mps2",
            "/ride/lateral_jerk_max_mps3",
            "/ride/min_clearance_m",
            "/ride/time_s",
            "/scanner/valid_share",
            "/scanner/stuck_scans",
            "/scanner/degraded_scans",
            "/scanner/blind_scans",
            "/scanner/contradictory_scans",
            "/blocking",
            "/differences/0/key",
            "/differences/0/truth",
            "/differences/0/believed",
            "/controller/solve_us/p50",
            "/controller/iterations/max",
            "/controller/status",
            "/processes/0/role",
            "/processes/0/implementation",
            "/processes/0/pid",
            "/processes/0/restarts",
            "/processes/0/state",
            "/trajectory/1/3",
        ] {
            assert!(value.pointer(pointer).is_some(), "{pointer}");
        }
    }

    #[test]
    fn without_a_truth_the_keys_that_only_it_knows_are_left_out() {
        let of =
            |report: &Report| serde_json::from_str::<serde_json::Value>(&report.to_json().unwrap()).unwrap();
        let drive = DriveReport { final_distance_m: 0.04, ..DriveReport::default() };
        let blind = Report { judged_by: JudgedBy::Estimate, ride: None, drive, ..report() };
        let (with, without) = (of(&report()), of(&blind));
        assert_eq!((&with["judged_by"], &without["judged_by"]), (&"truth".into(), &"estimate".into()));
        let keys =
            |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
        let left_out: Vec<_> = (&keys(&with["drive"]) - &keys(&without["drive"])).into_iter().collect();
        let known = ["collided", "covariance_coverage", "estimate_error_max_m", "estimate_error_rms_m"];
        assert_eq!(left_out, [&known[..], &["longest_blind_s", "min_clearance_m", "struck"]].concat());
        assert_eq!((&keys(&with) - &keys(&without)).into_iter().collect::<Vec<_>>(), ["ride"]);
        assert_eq!(serde_json::from_str::<Report>(&blind.to_json().unwrap()).unwrap(), blind);
        // A drive that did not get to the goal has no ride, which is known.
        let short = Report { ride: Some(None), ..report() };
        assert!(of(&short)["ride"].is_null() && of(&short).get("ride").is_some());
        assert_eq!(serde_json::from_str::<Report>(&short.to_json().unwrap()).unwrap(), short);
    }

    #[test]
    fn exit_codes_are_those_of_the_public_interface() {
        let codes =
            |outcomes: &[Outcome]| outcomes.iter().map(|outcome| outcome.exit_code()).collect::<Vec<_>>();
        assert_eq!(codes(&[Outcome::Reached, Outcome::Collision, Outcome::Failed]), [0, 3, 4]);
        assert_eq!(
            codes(&[Outcome::Missed, Outcome::Timeout, Outcome::Stopped, Outcome::Interrupted]),
            [1; 4]
        );
    }
}
