//! Descriptions of obstacles with a fault.

use runtime::{Process, join};
use shared_types::{Obstacles, Pose, Role, Scan};

use crate::Outcome;

/// Faults: `small`, `phantom`, `needs-returns`, `far-first`, `renumbers`, `forgets`, `unpaired`.
pub(crate) fn run(fault: &str) -> Outcome {
    let mut process = Process::attach(Role::Obstacles)?;
    let mut detector = obstacles::ObstacleDetector::new(process.settings::<obstacles::Config>("obstacles")?)?;
    let scans = process.input::<Scan>()?;
    let poses = process.input::<Pose>()?;
    let output = process.output::<Obstacles>()?;
    if !process.start()? {
        return Ok(());
    }
    let (mut last, mut count) = (Pose::default(), 0);
    while process.wait(None)? {
        let mut pairs = Vec::new();
        if fault == "unpaired" {
            while let Some(pose) = poses.take() {
                last = *pose;
            }
            while let Some(scan) = scans.take() {
                pairs.push((*scan, last));
            }
        } else {
            while let Some((scan, pose)) = join(&scans, &poses) {
                pairs.push((*scan, *pose));
            }
        }
        for (scan, pose) in pairs {
            if fault == "needs-returns" && scan.ranges_mm.iter().all(|range| *range == 0) {
                continue;
            }
            let mut description = detector.step(&scan, &pose);
            count += 1;
            spoil(fault, &mut description, count);
            output.publish(&mut description)?;
        }
    }
    Ok(())
}

fn spoil(fault: &str, description: &mut Obstacles, count: u32) {
    let mut list = description.list().to_vec();
    match fault {
        "small" => list.iter_mut().for_each(|item| (item.a_m, item.b_m) = (0.1, 0.1)),
        "phantom" if list.is_empty() => {
            list.push(shared_types::Obstacle { id: 1, a_m: 1.0, b_m: 1.0, ..Default::default() });
        }
        "far-first" => list.reverse(),
        "renumbers" => list.iter_mut().for_each(|item| item.id += 100 * count),
        "forgets" => list.retain(|item| item.unseen_s == 0.0),
        _ => {}
    }
    description.items = Default::default();
    description.count = list.len() as u32;
    description.items[..list.len()].copy_from_slice(&list);
}
