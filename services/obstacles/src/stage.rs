//! The obstacle detector as a stage of the loop: scan and pose in, ellipses out.

use shared_types::{
    AnySample, Fault, Obstacles, Pose, Role, Sample, SampleType, Scan, ScanGeometry, Stage, StageEvent,
    Stopwatch,
};
use vehicle::Invalid;

use crate::{ObstacleDetector, ObstaclesConfig, ObstaclesState};

/// The stage.
#[derive(Debug, Clone)]
pub struct DetectorStage {
    detector: ObstacleDetector,
    /// The beams that are described.
    known: ScanGeometry,
    period_ns: u64,
    /// Without the state of the process before, an obstacle beside the robot that is out of view would be forgotten.
    is_lost: bool,
    scan: Option<Scan>,
    pose: Option<Pose>,
    /// Why the newest scan is not used.
    refusal: Option<Fault>,
}

impl Stage for DetectorStage {
    type Settings = ObstaclesConfig;
    type Invalid = Invalid;
    type Output = Obstacles;
    type State = ObstaclesState;

    const ROLE: Role = Role::Obstacles;
    const ANSWERS: &'static [&'static SampleType] = &[Scan::TYPE, Pose::TYPE];

    fn begin(settings: ObstaclesConfig, period_ns: u64) -> Result<Self, Invalid> {
        let known = settings.vehicle.scanner.geometry();
        let detector = ObstacleDetector::new(settings)?;
        Ok(Self { detector, known, period_ns, is_lost: false, scan: None, pose: None, refusal: None })
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
        if let Some(scan) = sample.get::<Scan>() {
            self.refusal = unknown(&scan.geometry(), &self.known);
            match self.refusal {
                None => self.scan.get_or_insert_default().assign(scan),
                Some(_) => self.scan = None,
            }
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

    fn refusal(&self) -> Option<&Fault> {
        self.refusal.as_ref()
    }

    fn rehearse(&mut self, _: u64, _: &dyn Fn() -> u64) {
        if let Some((scan, pose)) = self.scan.as_ref().zip(self.pose.as_ref()) {
            self.detector.rehearse(scan, pose, self.period_ns);
        }
    }
}

/// What differs between the beams of a scan and those that are described: the detector knows no others.
fn unknown(found: &ScanGeometry, known: &ScanGeometry) -> Option<Fault> {
    let ScanGeometry { count, first_rad, increment_rad } = *known;
    let differing = [
        ("beams", found.count as f64, count as f64),
        ("first_rad", found.first_rad, first_rad),
        ("increment_rad", found.increment_rad, increment_rad),
    ];
    let differs = |(_, found, known): &(_, f64, f64)| (found - known).abs() > 1e-9;
    let (field, value, _) = differing.into_iter().find(differs)?;
    Some(Fault::OutOfRange { field, value })
}
