//! Recomputes described obstacles.

use obstacles::{Config, ObstacleDetector, ObstaclesState};
use shared_types::{JournalEntry, JournalKind, Obstacles, Pose, Role, Scan, Topic};

use super::journal::{Missing, Stage};
use crate::Drive;

/// The process of an obstacle detector.
pub(super) struct Detector<'d> {
    detector: ObstacleDetector,
    scan: Option<&'d Scan>,
    pose: Option<&'d Pose>,
}

impl<'d> Stage<'d> for Detector<'d> {
    type Output = Obstacles;
    type State = ObstaclesState;
    const ROLE: Role = Role::Obstacles;

    fn begin(drive: &'d Drive) -> anyhow::Result<Self> {
        let config: Config = drive.table(Role::Obstacles, "obstacles")?;
        Ok(Self { detector: ObstacleDetector::new(config)?, scan: None, pose: None })
    }

    fn resume(&mut self, state: &ObstaclesState) -> bool {
        self.detector.resume(state).is_ok()
    }

    fn take(&mut self, entry: &JournalEntry, drive: &'d Drive) {
        if entry.topic == Topic::Scan as u16 {
            self.scan = drive.scans.of_number(entry.incarnation, entry.value);
        } else {
            self.pose = drive.poses.of_number(entry.incarnation, entry.value);
        }
    }

    fn follow(&mut self, _: JournalKind, _: u64) -> Result<(), Missing> {
        Ok(())
    }

    fn output(&mut self, _: u64) -> Result<Obstacles, Missing> {
        let (scan, pose) = self.scan.zip(self.pose).ok_or(Missing)?;
        Ok(self.detector.step(scan, pose))
    }
}
