//! The estimator as a stage of the loop: odometry and actuation in, pose out.

use shared_types::{
    Actuation, AnySample, Fault, Odometry, Pose, Role, Sample, SampleType, Stage, StageEvent, Stopwatch,
};
use vehicle::Invalid;

use crate::{Estimator, EstimatorConfig, EstimatorState};

/// The stage.
#[derive(Debug, Clone)]
pub struct EstimatorStage {
    estimator: Estimator,
    period_ns: u64,
    /// Without the state of the process before, the correction of the odometry is lost, and with it the position.
    is_lost: bool,
    last: Option<Odometry>,
    pose: Option<Pose>,
}

impl Stage for EstimatorStage {
    type Settings = EstimatorConfig;
    type Invalid = Invalid;
    type Output = Pose;
    type State = EstimatorState;

    const ROLE: Role = Role::Estimator;
    const ANSWERS: &'static [&'static SampleType] = &[Odometry::TYPE];
    const NOTES: &'static [&'static SampleType] = &[Actuation::TYPE];

    fn begin(settings: EstimatorConfig, period_ns: u64) -> Result<Self, Invalid> {
        let estimator = Estimator::new(&settings)?;
        Ok(Self { estimator, period_ns, is_lost: false, last: None, pose: None })
    }

    fn resume(&mut self, state: &EstimatorState) -> bool {
        let is_usable = self.estimator.resume(state).is_ok();
        self.is_lost &= !is_usable;
        is_usable
    }

    fn state(&self) -> Option<EstimatorState> {
        Some(self.estimator.state()).filter(|state| state.initialised.is_set())
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        if let Some(actuation) = sample.get::<Actuation>() {
            self.estimator.note(actuation, now_ns);
        } else if let Some(odometry) = sample.get::<Odometry>().filter(|_| !self.is_lost) {
            self.pose = self.estimator.step(odometry, None, now_ns);
        }
    }

    fn output(&mut self, _: u64, _: &Stopwatch<'_>) -> Option<Pose> {
        self.pose.take()
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        if let StageEvent::StateLost { .. } = event {
            tracing::error!("no fresh state to resume from: no pose will be published");
            self.is_lost = true;
        }
        false
    }

    fn keep(&mut self, sample: AnySample<'_>) {
        self.last = sample.get().copied().filter(|_| !self.is_lost);
    }

    fn rehearse(&mut self, due_ns: u64, _: &dyn Fn() -> u64) {
        if let Some(last) = &self.last {
            self.estimator.rehearse(last, self.period_ns, due_ns);
        }
    }

    fn refusal(&self) -> Option<&Fault> {
        self.estimator.refusal()
    }

    fn contains(&self, sample: AnySample<'_>) -> bool {
        sample.get().is_some_and(|odometry| !self.estimator.is_newer(odometry))
    }
}
