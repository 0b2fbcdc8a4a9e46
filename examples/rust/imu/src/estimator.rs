//! An estimator of your own that takes its yaw from an inertial sensor.
//!
//! It replaces the yaw of the odometry by the integrated yaw rate of the sensor, moves the distance that the odometer
//! has counted in that direction, and hands the result to the estimator of the product. Where a sample of the sensor is
//! missing, the increment of the odometry takes its place. With the argument `odometry` the sensor is not used at all.

mod imu;

use std::collections::VecDeque;
use std::process::ExitCode;

use estimator::{Estimator, EstimatorConfig};
use imu::Imu;
use runtime::{Handover, NamedTopic, Process};
use shared_types::{Actuation, Odometry, Pose, Role};

/// A problem that ends the process.
type Problem = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    runtime::start_logging();
    let uses_imu = std::env::args().nth(1).as_deref() != Some("odometry");
    match run(uses_imu) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(uses_imu: bool) -> Result<(), Problem> {
    let mut process = Process::attach(Role::Estimator)?;
    let mut estimator = Estimator::new(&process.settings::<EstimatorConfig>("estimator")?)?;
    let odometry = process.input::<Odometry>()?;
    let actuation = process.input::<Actuation>()?;
    let imu = process.open::<Imu>("imu")?;
    let poses = process.output::<Pose>()?;
    // The integrated yaw can't be resumed from the state of the estimator: a successor stops the robot.
    let lost = !matches!(process.resume::<estimator::EstimatorState>()?, Handover::FirstStart);
    if !process.start()? {
        return Ok(());
    }
    let mut reckoning = Reckoning::default();
    let mut actuated = 0;
    while process.wait(None)? {
        loop {
            while let Some(newer) = actuation.take() {
                actuated = newer.header.scan_id;
                estimator.note(&newer, process.clock().now_ns());
            }
            let Some(scan_id) = odometry.next_scan() else { break };
            // In lock-step, wait for the actuation of the scan before: the result must not depend on when it arrives.
            if process.clock().is_simulated() && actuated < scan_id.saturating_sub(1) {
                break;
            }
            let Some(measured) = odometry.take() else { break };
            let corrected = if uses_imu { reckoning.correct(&measured, &imu)? } else { *measured };
            if lost {
                continue;
            }
            if let Some(mut pose) = estimator.step(&corrected, None, process.clock().now_ns()) {
                poses.publish(&mut pose)?;
                process.save(&pose.header, &estimator.state())?;
            }
        }
    }
    Ok(())
}

/// The pose by the distance of the odometer and the yaw rate of the sensor.
#[derive(Default)]
struct Reckoning {
    /// Position [m]; `None` before the first sample.
    place_m: Option<[f64; 2]>,
    /// Yaw by the samples of the sensor [rad].
    yaw_rad: f64,
    /// Yaw increments of the odometry that no sample of the sensor has replaced yet: scan, increment [rad].
    unmeasured: VecDeque<(u64, f64)>,
    /// Yaw of the sample before [rad].
    last_rad: f64,
}

impl Reckoning {
    /// The odometry with the yaw of the sensor. A sample that comes late replaces the increment that stood in for it.
    fn correct(&mut self, measured: &Odometry, imu: &NamedTopic<Imu>) -> Result<Odometry, Problem> {
        let scan_id = measured.header.scan_id;
        let Some([x_m, y_m]) = self.place_m else {
            (self.yaw_rad, self.last_rad) = (measured.yaw_rad, measured.yaw_rad);
            self.place_m = Some([measured.x_m, measured.y_m]);
            return Ok(*measured);
        };
        self.unmeasured.push_back((scan_id, measured.dyaw_rad));
        while let Some(sample) = imu.up_to(scan_id)? {
            // Of a sample that was lost, the increment of the odometry stays in the sum.
            let is_it = |(scan, _): &(u64, f64)| *scan == sample.header.scan_id;
            if let Some(index) = self.unmeasured.iter().position(is_it) {
                let lost = self.unmeasured.drain(..=index).rev().skip(1);
                self.yaw_rad += lost.map(|(_, turned_rad)| turned_rad).sum::<f64>();
                self.yaw_rad += sample.yaw_rate_radps * sample.dt_s;
            }
        }
        let yaw_rad = self.yaw_rad + self.unmeasured.iter().map(|(_, turned_rad)| turned_rad).sum::<f64>();
        let mean_rad = f64::midpoint(self.last_rad, yaw_rad);
        let forward_m = measured.dx_m * measured.yaw_rad.cos() + measured.dy_m * measured.yaw_rad.sin();
        let distance_m = measured.dx_m.hypot(measured.dy_m).copysign(forward_m);
        let [dx_m, dy_m] = [distance_m * mean_rad.cos(), distance_m * mean_rad.sin()];
        let dyaw_rad = yaw_rad - self.last_rad;
        (self.place_m, self.last_rad) = (Some([x_m + dx_m, y_m + dy_m]), yaw_rad);
        Ok(Odometry { x_m: x_m + dx_m, y_m: y_m + dy_m, yaw_rad, dx_m, dy_m, dyaw_rad, ..*measured })
    }
}
