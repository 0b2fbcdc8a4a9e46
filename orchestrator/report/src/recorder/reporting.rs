//! What was collected, as the report of the run and as its progress line.

use std::collections::BTreeMap;

use crate::ride::measure;
use audit::ledger::ScanReport;
use console::progress::View;

use super::{Recorder, RunResult};
use crate::report::{DriveReport, LatencyReport, Report, SCHEMA, TrueDrive};

impl Recorder {
    /// What the progress line shows of the loop.
    pub fn view(&self) -> View {
        let mut recent: Vec<u64> = self.recent.iter().map(|&(_, reaction_ns)| reaction_ns).collect();
        recent.sort_unstable();
        let reaction_ms = (!self.info.lockstep && !recent.is_empty()).then(|| {
            [recent[(recent.len() - 1) / 2], recent[recent.len() - 1]].map(|time| time as f64 * 1e-6)
        });
        let sent = self.actuation.as_ref().map_or(0.0, |actuation| actuation.desired_steering_rad);
        View {
            time_s: self.duration_s(),
            goal_distance_m: self.goal_distance_m(),
            speed_mps: match (&self.truth, &self.pose) {
                (Some(truth), _) => truth.speed_mps,
                (None, Some(pose)) => pose.speed_mps,
                (None, None) => 0.0,
            },
            steering_rad: self.truth.as_ref().map_or(sent, |truth| truth.steering_rad),
            reaction_ms,
            lockstep: self.info.lockstep,
            blocking: self.stopped_for(),
            scanner: self.stopped_for_scanner(),
        }
    }

    /// The report of the run.
    pub fn report(&self, result: &RunResult) -> Report {
        // The figures are of a line along x to one goal, known from the start.
        let is_line =
            self.info.course.is_none() && self.info.goals.all().len() == 1 && self.goal_changes.is_empty();
        let has_ride = self.estimated.is_none() && is_line && self.driver_changes.is_empty();
        Report {
            schema: SCHEMA,
            run_id: self.info.run_id.clone(),
            scenario: self.info.scenario.clone(),
            seed: self.info.seed,
            surroundings: self.info.surroundings,
            outcome: result.outcome,
            judged_by: self.judged_by(),
            reason: result.reason.clone(),
            lockstep: self.info.lockstep,
            adopted: self.info.first_scan == 0,
            adopted_from_scan: (self.info.first_scan == 0).then(|| self.ledger.first()),
            duration_s: self.duration_s(),
            scans: ScanReport { missing: self.missing, ..self.ledger.report() },
            ledger: result.ledger.clone(),
            latency_us: LatencyReport {
                companions: result.companion_delays.clone(),
                ..self.latencies.report()
            },
            drive: self.drive_report(),
            margin_m: self.margins.means(),
            ride: has_ride.then(|| measure(&self.ride.drive(), &self.info.goals.last())),
            goals: result.goals.clone(),
            goal_changes: self.goal_changes.clone(),
            driver_changes: self.driver_changes.clone(),
            scanner: self.scanner.report(),
            blocking: self.blocking.map(|(blocking, _)| blocking.into()),
            differences: Vec::new(),
            controller: self.tally.controller(),
            stop_reasons: self.tally.stops(),
            self_check: self.tally.self_check(),
            learned: self.tally.learned(),
            processes: result.processes.clone(),
            companions: result.companions.clone(),
            swaps: result.swaps.clone(),
            recording: result.recording.clone(),
            incidents: result.incidents.clone(),
            digests: BTreeMap::new(),
            trajectory_rows_dropped: self.rows.dropped(),
            trajectory: self.trajectory(),
        }
    }

    fn trajectory(&self) -> Vec<[f64; 4]> {
        self.rows.moments().map(|moment| [moment.time_s, moment.x_m, moment.y_m, moment.yaw_rad]).collect()
    }

    fn drive_report(&self) -> DriveReport {
        let report = DriveReport {
            final_distance_m: self.goal_distance_m().unwrap_or(0.0),
            speed_limit_mps: self.margins.speed_limit_mps(),
            ..DriveReport::default()
        };
        if let Some(estimated) = &self.estimated {
            return estimated.report(report);
        }
        let error = self.rows.error();
        let only_true = TrueDrive {
            estimate_error_max_m: error.max_m(),
            estimate_error_rms_m: error.rms_m(),
            covariance_coverage: error.coverage(),
            ..TrueDrive::default()
        };
        let Some(truth) = &self.truth else { return DriveReport { truth: Some(only_true), ..report } };
        DriveReport {
            final_speed_mps: truth.speed_mps,
            path_length_m: truth.path_length_m,
            max_abs_lateral_m: truth.max_abs_lateral_m,
            truth: Some(TrueDrive {
                min_clearance_m: truth.min_clearance_m,
                longest_blind_s: truth.longest_blind_s,
                collided: truth.collided == 1,
                struck: truth.struck == 1,
                ..only_true
            }),
            ..report
        }
    }
}
