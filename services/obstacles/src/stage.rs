//! The obstacle detector as a stage of the loop: scan and pose in, ellipses out.

use shared_types::{
    AnySample, Obstacles, Pose, Role, Sample, SampleType, Scan, Stage, StageEvent, Stopwatch,
};
use vehicle::Invalid;

use crate::{ObstacleDetector, ObstaclesConfig, ObstaclesState};

/// The stage.
#[derive(Debug, Clone)]
pub struct DetectorStage {
    detector: ObstacleDetector,
    period_ns: u64,
    /// Without the state of the process before, an obstacle beside the robot that is out of view would be forgotten.
    is_lost: bool,
    scan: Option<Scan>,
    pose: Option<Pose>,
}

impl Stage for DetectorStage {
    type Settings = ObstaclesConfig;
    type Invalid = Invalid;
    type Output = Obstacles;
    type State = ObstaclesState;

    const ROLE: Role = Role::Obstacles;
    const ANSWERS: &'static [&'static SampleType] = &[Scan::TYPE, Pose::TYPE];

    fn begin(settings: ObstaclesConfig, period_ns: u64) -> Result<Self, Invalid> {
        let detector = ObstacleDetector::new(settings)?;
        Ok(Self { detector, period_ns, is_lost: false, scan: None, pose: None })
    }

    fn resume(&mut self, state: &ObstaclesState) -> bool {
        let is_usable = self.detector.resume(state).is_ok();
        self.is_lost &= !is_usable;
        is_usable
    }

    fn state(&self) -> Option<ObstaclesState> {
        Some(self.detector.state())
    }

    fn take(&mut self, sample: AnySample<'_>, _: u64) {
        if let Some(scan) = sample.get() {
            *self.scan.get_or_insert_default() = *scan;
        } else if let Some(pose) = sample.get() {
            *self.pose.get_or_insert_default() = *pose;
        }
    }

    fn output(&mut self, _: u64, _: &Stopwatch<'_>) -> Option<Obstacles> {
        let (scan, pose) = self.scan.as_ref().zip(self.pose.as_ref()).filter(|_| !self.is_lost)?;
        Some(self.detector.step(scan, pose))
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        if let StageEvent::StateLost { .. } = event {
            tracing::error!("no fresh state to resume from: no obstacles will be published");
            self.is_lost = true;
        }
        false
    }

    fn rehearse(&mut self, _: u64, _: &dyn Fn() -> u64) {
        if let Some((scan, pose)) = self.scan.as_ref().zip(self.pose.as_ref()) {
            self.detector.rehearse(scan, pose, self.period_ns);
        }
    }
}
