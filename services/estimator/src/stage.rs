//! The estimator as a stage of the loop: odometry, actuation, scans and the samples of a gyro in, pose out.

use shared_types::{
    Actuation, AnySample, Fault, Odometry, Pose, Role, Sample, SampleType, Scan, Stage, StageEvent, Stopwatch,
};
use vehicle::Invalid;

use crate::gyro::{GyroFault, GyroSample};
use crate::laser::EVENTS;
use crate::{Estimator, EstimatorConfig, EstimatorState};

/// The stage.
#[derive(Debug, Clone)]
pub struct EstimatorStage {
    estimator: Estimator,
    period_ns: u64,
    /// Without the state of the process before, the correction of the odometry is lost, and with it the position.
    is_lost: bool,
    last: Option<Odometry>,
    /// The sample of the gyro whose fields come, and how many have come.
    gyro: (GyroSample, usize),
    pose: Option<Pose>,
}

impl EstimatorStage {
    /// The next field of a sample of the gyro; the last one completes it.
    fn note_field(&mut self, value: f64) {
        let (sample, count) = &mut self.gyro;
        *count += 1;
        match count {
            1 => sample.yaw_rate_radps = value,
            2 => {
                sample.dt_s = value;
                self.estimator.note_gyro(*sample);
            }
            _ => {}
        }
    }

    /// Names what a scan said against the pose or the scanner.
    fn log_laser(&self, scan: &Scan, before: &[u64; 6]) {
        for (event, (count, before)) in EVENTS.iter().zip(self.estimator.laser_events().iter().zip(before)) {
            if count > before {
                tracing::warn!(scan_id = scan.header.scan_id, count, "{event}");
            }
        }
    }

    /// Names why turns of the odometry were not replaced: the first of each kind, and then more and more rarely.
    fn log_gyro(&self, odometry: &Odometry, before: &[u64; 4]) {
        let kept = self.estimator.kept_turns();
        for (fault, (count, before)) in GyroFault::ALL.iter().zip(kept.into_iter().zip(before)) {
            if count > *before && count.is_power_of_two() {
                let scan_id = odometry.header.scan_id;
                tracing::warn!(scan_id, ?fault, count, "the odometry takes the place of the gyro");
            }
        }
    }
}

impl Stage for EstimatorStage {
    type Settings = EstimatorConfig;
    type Invalid = Invalid;
    type Output = Pose;
    type State = EstimatorState;

    const ROLE: Role = Role::Estimator;
    const ANSWERS: &'static [&'static SampleType] = &[Odometry::TYPE];
    const OWN_FIELDS: &'static [&'static str] = &["yaw_rate_radps", "dt_s"];
    const NOTES: &'static [&'static SampleType] = &[Actuation::TYPE];

    fn begin(settings: EstimatorConfig, period_ns: u64) -> Result<Self, Invalid> {
        let estimator = Estimator::new(&settings)?;
        Ok(Self { estimator, period_ns, is_lost: false, last: None, gyro: Default::default(), pose: None })
    }

    fn later(&self) -> &'static [&'static SampleType] {
        if self.estimator.sees() { &[Scan::TYPE] } else { &[] }
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
        } else if let Some(scan) = sample.get::<Scan>() {
            let before = self.estimator.laser_events();
            self.estimator.see(scan);
            self.log_laser(scan, &before);
        } else if let Some(odometry) = sample.get::<Odometry>().filter(|_| !self.is_lost) {
            let kept = self.estimator.kept_turns();
            self.pose = self.estimator.step(odometry, None, now_ns);
            self.log_gyro(odometry, &kept);
        }
    }

    fn output(&mut self, _: u64, _: &Stopwatch<'_>) -> Option<Pose> {
        self.pose.take()
    }

    fn follow(&mut self, event: StageEvent) -> bool {
        match event {
            StageEvent::StateLost { .. } => {
                tracing::error!("no fresh state to resume from: no pose will be published");
                self.is_lost = true;
                return false;
            }
            StageEvent::Own(scan_id) => self.gyro = (GyroSample { scan_id, ..GyroSample::default() }, 0),
            StageEvent::Number(bits) => self.note_field(f64::from_bits(bits)),
            _ => return false,
        }
        true
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
