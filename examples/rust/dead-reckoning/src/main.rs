//! An estimator of your own: it believes the odometer, and predicts with constant speed and yaw rate.
//!
//! It does not correct or filter the reported pose. The default robot's odometer does not report 1 % of the distance, so
//! the robot misses the goal by that much. The estimator has no state, so it saves none.

use std::convert::Infallible;
use std::process::ExitCode;

use runtime::stage::NoSettings;
use shared_types::{AnySample, Odometry, Pose, Role, Sample, SampleType, Stage, Stopwatch};

fn main() -> ExitCode {
    runtime::stage::main::<DeadReckoning>()
}

/// The estimator: the pose that answers the newest odometry.
#[derive(Clone, Default)]
struct DeadReckoning(Option<Pose>);

impl Stage for DeadReckoning {
    type Settings = NoSettings;
    type Invalid = Infallible;
    type Output = Pose;
    type State = [u8; 0];

    const ROLE: Role = Role::Estimator;
    const ANSWERS: &'static [&'static SampleType] = &[Odometry::TYPE];

    fn begin(_: NoSettings, _: u64) -> Result<Self, Infallible> {
        Ok(Self::default())
    }

    fn take(&mut self, sample: AnySample<'_>, now_ns: u64) {
        self.0 = sample.get().map(|measured| pose_of(measured, now_ns));
    }

    fn output(&mut self, _: u64, _: &Stopwatch<'_>) -> Option<Pose> {
        self.0.take()
    }
}

/// The reported pose, and its prediction for `now_ns`, when the answer to this scan acts.
fn pose_of(measured: &Odometry, now_ns: u64) -> Pose {
    let Odometry { header, x_m, y_m, yaw_rad, speed_mps, .. } = *measured;
    let yaw_rate_radps = if measured.dt_s > 0.0 { measured.dyaw_rad / measured.dt_s } else { 0.0 };
    let ahead_s = now_ns.saturating_sub(header.acquired_ns) as f64 * 1e-9;
    let (sin, cos) = yaw_rad.sin_cos();
    Pose {
        header: header.answer(),
        yaw_rad,
        x_m,
        y_m,
        speed_mps,
        yaw_rate_radps,
        predicted_ns: now_ns,
        predicted_yaw_rad: yaw_rad + yaw_rate_radps * ahead_s,
        predicted_yaw_rate_radps: yaw_rate_radps,
        predicted_x_m: x_m + speed_mps * cos * ahead_s,
        predicted_y_m: y_m + speed_mps * sin * ahead_s,
        predicted_speed_mps: speed_mps,
        ..Pose::default()
    }
}
