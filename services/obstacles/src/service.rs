//! The process of the role `obstacles`: scan and pose in, ellipses out.

use runtime::{Handover, Process, join};
use shared_types::{Obstacles, Pose, Role, Scan};

use crate::{ObstacleDetector, ObstaclesConfig};

/// Runs until asked to end.
///
/// # Errors
/// Settings that are not allowed, and errors of the bus.
pub fn run() -> anyhow::Result<()> {
    let mut process = Process::attach(Role::Obstacles)?;
    let mut detector = ObstacleDetector::new(process.settings::<ObstaclesConfig>("obstacles")?)?;
    let scans = process.input::<Scan>()?;
    let poses = process.input::<Pose>()?;
    let obstacles = process.output::<Obstacles>()?;
    // Without the state of the process before, an obstacle beside the robot that is out of view would be forgotten.
    let mut lost = match process.resume()? {
        Handover::State(state) => detector.resume(&state).is_err(),
        Handover::FirstStart => false,
        Handover::Lost => true,
    };
    if lost {
        tracing::error!("no fresh state to resume from: no obstacles will be published");
    }
    if !process.start()? {
        return Ok(());
    }
    if let Some((scan_id, state)) = process.join()? {
        lost = detector.resume(&state).is_err();
        scans.skip_to(scan_id);
    }
    let (mut last, period_ns) = (None, process.period_ns());
    while process.wait_joined_preparing(&mut |_| {
        if let Some((scan, pose)) = &last {
            detector.rehearse(scan, pose, period_ns);
        }
    })? {
        while let Some((scan, pose)) = join(&scans, &poses) {
            if lost {
                continue;
            }
            let mut described = detector.step(&scan, &pose);
            obstacles.publish(&mut described)?;
            process.save(&described.header, &detector.state())?;
            last = Some((*scan, *pose));
        }
    }
    Ok(())
}
