//! Recomputes described obstacles.

use obstacles::{ObstacleDetector, ObstaclesConfig, ObstaclesState};
use shared_types::{JournalEntry, JournalKind, Obstacles, Pose, Role, Scan, Topic};

use super::journal::{Missing, Stage, Taking};
use crate::ReplayDrive;

/// The process of an obstacle detector.
pub(super) struct Detector {
    detector: ObstacleDetector,
    scan: Result<Scan, Missing>,
    pose: Result<Pose, Missing>,
}

impl Stage for Detector {
    type Output = Obstacles;
    type State = ObstaclesState;
    const ROLE: Role = Role::Obstacles;

    fn begin(drive: &ReplayDrive, incarnation: u32) -> anyhow::Result<Self> {
        let config: ObstaclesConfig = drive.table_of(incarnation, Role::Obstacles, "obstacles")?;
        let (scan, pose) = (Err(Missing::Input), Err(Missing::Input));
        Ok(Self { detector: ObstacleDetector::new(config)?, scan, pose })
    }

    fn resume(&mut self, state: &ObstaclesState) -> bool {
        self.detector.resume(state).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, taking: &Taking<'_>) {
        if entry.topic == Topic::Scan as u16 {
            self.scan = taking.sample(&taking.drive.scans, entry);
        } else {
            self.pose = taking.sample(&taking.drive.poses, entry);
        }
    }

    fn follow(&mut self, _: JournalKind, _: u64) -> Result<(), Missing> {
        Ok(())
    }

    fn output(&mut self, _: u64) -> Result<Obstacles, Missing> {
        let scan = self.scan.as_ref().map_err(|missing| *missing)?;
        let pose = self.pose.as_ref().map_err(|missing| *missing)?;
        Ok(self.detector.step(scan, pose))
    }
}
