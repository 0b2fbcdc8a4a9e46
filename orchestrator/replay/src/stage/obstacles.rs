//! Recomputes described obstacles.

use obstacles::{Config, ObstacleDetector, ObstaclesState};
use shared_types::{Obstacles, Role};

use super::{Findings, Origin, Window, each_process};
use crate::{Drive, Options};

pub(super) fn replay(drive: &Drive, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let config: Config = drive.table(Role::Obstacles, "obstacles")?;
    let window = Window::of(drive, options);
    let role = Role::Obstacles;
    each_process::<Obstacles, ObstaclesState>(
        role,
        &drive.obstacles,
        drive,
        options,
        findings,
        |outputs: &[&Obstacles], origin, findings| {
            let mut detector = ObstacleDetector::new(config)?;
            if let Origin::State(_, state) = &origin {
                detector.resume(state)?;
            }
            for (index, output) in outputs.iter().enumerate() {
                if output.header.scan_id > window.to {
                    return Ok(outputs.len());
                }
                let scan = drive.input(&drive.scans, Role::Robot, &output.header);
                let pose = drive.input(&drive.poses, Role::Estimator, &output.header);
                let replayed = scan.zip(pose).map(|(scan, pose)| detector.step(scan, pose));
                let Some(replayed) = replayed else { return Ok(index) };
                if window.holds(&output.header, findings) {
                    findings.compare(*output, replayed, role, drive, options);
                }
            }
            Ok(outputs.len())
        },
    )
}
