//! One drive, with what its estimate and its odometer were off.

use std::io::Write as _;

use console::new_file::NewFile;
use emulator::Outcome;
use estimator::FilterSettings;
use estimator::correction::{CorrectionState, Planar};
use plan::Plan;
use shared_types::Odometry;

use super::scans;
use super::tally::Tally;

/// What one drive was.
#[derive(Debug, Clone)]
pub(super) struct Drive {
    pub(super) outcome: Outcome,
    pub(super) estimate: Tally,
    pub(super) odometer: Tally,
    /// Scans for which the estimator gave no pose.
    pub(super) without_pose: u64,
    /// What was learned and is wrong at the end: steering offset [rad], factor of the velocity, fraction of the distance.
    pub(super) unlearned: [f64; 3],
}

/// The odometer without a filter: the reported pose with the correction of the estimator.
struct Odometer {
    settings: FilterSettings,
    correction: Option<CorrectionState>,
}

/// Drives a plan to its end, and writes its scans to a file if there is one.
///
/// # Errors
/// A setting that is not allowed, exit code 2; errors of the file system.
pub(super) fn drive(plan: &Plan, scans: Option<NewFile>) -> anyhow::Result<Drive> {
    let settings = plan.clone().simulated();
    let mut odometer = Odometer { settings: settings.tuning.estimator.settings()?, correction: None };
    let (mut of_estimate, mut of_odometer, mut without_pose) = (Tally::default(), Tally::default(), 0);
    let (mut text, mut unlearned) = (String::new(), [0.0; 3]);
    let truth = plan.scenario.robot.values(plan.scenario.seed);
    let sent = settings.tuning.actuator.calibration.correction().velocity_factor;
    let end = pipeline::drive(&settings, |step| {
        if scans.is_some() {
            if text.is_empty() {
                text = scans::heading(&step.scan);
            }
            text += &scans::line(step);
        }
        of_odometer.add_place(odometer.follow(&step.odometry), &step.truth);
        match &step.pose {
            Some(pose) => {
                of_estimate.add_pose(pose, &step.truth);
                let [_, distance, _, offset_rad, _, velocity] = pose.learned;
                unlearned = [
                    offset_rad - truth.steering_offset_rad,
                    sent / (1.0 + velocity) / truth.velocity_factor - 1.0,
                    distance - truth.odometry_longitudinal,
                ];
            }
            None => without_pose += 1,
        }
    })?;
    if let Some(mut file) = scans {
        file.write_all(text.as_bytes())?;
        file.finish()?;
    }
    Ok(Drive { outcome: end.outcome, estimate: of_estimate, odometer: of_odometer, without_pose, unlearned })
}

impl Odometer {
    /// Yaw, x and y after a sample.
    fn follow(&mut self, odometry: &Odometry) -> [f64; 3] {
        let Odometry { x_m, y_m, yaw_rad, speed_mps, dt_s, .. } = *odometry;
        let reported = Planar { yaw: yaw_rad, x: x_m, y: y_m };
        let correct = |state: &mut CorrectionState| {
            state.correct(&self.settings.drift, reported, speed_mps, dt_s, None)
        };
        let corrected = self.correction.as_mut().map(correct);
        if corrected.is_none() {
            self.correction = Some(CorrectionState::begin(reported, speed_mps));
        }
        let Planar { yaw, x, y } = corrected.unwrap_or(reported);
        [yaw, x, y]
    }
}
