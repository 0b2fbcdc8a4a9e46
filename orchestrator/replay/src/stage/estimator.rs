//! Recomputes poses.

use estimator::{Config, Estimator, EstimatorState};
use shared_types::{Actuation, Pose, Role};

use super::{Findings, Origin, Window, each_process};
use crate::{Drive, Options};

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let config: Config = drive.table(Role::Estimator, "estimator")?;
    let lead_ns = config.settings()?.lead_ns;
    let window = Window::of(drive, options);
    let mut actuations: Vec<&Actuation> = drive
        .actuations
        .samples
        .iter()
        .filter(|sample| drive.counts(Role::Actuator, &sample.header))
        .collect();
    actuations.sort_by_key(|actuation| published_ns(actuation));
    each_process::<Pose, EstimatorState>(
        Role::Estimator,
        &drive.poses,
        drive,
        options,
        findings,
        |poses: &[&Pose], origin, findings| {
            let mut estimator = Estimator::new(&config)?;
            let mut noted = 0;
            if let Origin::State(_, state) = &origin {
                estimator.resume(state)?;
            }
            for (index, pose) in poses.iter().enumerate() {
                if pose.header.scan_id > window.to {
                    return Ok(poses.len());
                }
                let stamps = pose.header.stage(Role::Estimator);
                // The time that the estimator read is in what it predicts.
                let now_ns = match drive.simulated {
                    true => stamps.computed_ns,
                    false => pose.predicted_ns.saturating_sub(lead_ns),
                };
                // Those that a restored state holds already are ignored by the estimator.
                while let Some(actuation) = actuations.get(noted) {
                    let is_before = match drive.simulated {
                        true => actuation.header.scan_id < pose.header.scan_id,
                        false => published_ns(actuation) < stamps.taken_ns,
                    };
                    if !is_before {
                        break;
                    }
                    if drive.has_received(pose.header.incarnation, &actuation.header) {
                        estimator.note(actuation, now_ns);
                    }
                    noted += 1;
                }
                let odometry = drive.input(&drive.odometries, Role::Robot, &pose.header);
                let replayed = odometry.and_then(|odometry| estimator.step(odometry, None, now_ns));
                let Some(replayed) = replayed else { return Ok(index) };
                if window.holds(&pose.header, findings) {
                    findings.compare(*pose, replayed, Role::Estimator, drive, options);
                }
            }
            Ok(poses.len())
        },
    )
}

fn published_ns(actuation: &Actuation) -> u64 {
    actuation.header.stage(Role::Actuator).published_ns
}
