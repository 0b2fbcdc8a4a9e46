//! The emulated odometry: the true motion with the errors that (7.36)-(7.40) correct, or wheel encoders and a gyro.
//!
//! (7.39) and (7.40) correct a reported increment by v dt R(yaw) (df, ds), with ds growing at the rate dds (7.38).
//! The odometer of `odometry_model = "source"` has exactly this error:
//! true increment = reported + v dt R(yaw) (df, ds). The error accumulates; noise does not: it is white on the reported
//! pose. Yaw has noise only, and may be off by a constant from some moment on, like a compass that passes a magnet. The
//! speed is the true one.
//!
//! With `"encoders"`, the distance comes from wheel encoders in steps of 1 mm, with the scale error df and slip, and the
//! yaw is the integral of a gyro with white noise, a scale error and a bias that walks at random from its turn-on value.
//! The reported position is integrated from these two, so its error accumulates in all components. The speed is the
//! counted distance since the sample before, divided by the time between them. The encoders measure the distance over
//! ground, also of blocked wheels, times the turns of the wheels per way: more than one where they slip or one is smaller.
//! A car's is that of its reference point: it adds what the turn about the straight axle moves it to the side.
//! The lateral error, the jump and the white noise act on top.

use nalgebra::Vector2;
use shared_types::Odometry;
use vehicle::State;
use vehicle::frame::{heading, to_track, wrap_angle};

use crate::history::Node;
use crate::noise::{NoiseStream, Purpose};
use crate::scenario::{DriftGrowth, Noise, OdometryModel, Robot, Scenario, Values};

/// Distance between two pulses of the wheel encoders [m].
const PULSE_M: f64 = 1e-3;

/// The accumulated error of the odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reckoning {
    seed: u64,
    drift: DriftGrowth,
    values: Values,
    /// ds of (7.38).
    pub(crate) lateral: f64,
    pub(crate) reported: Vector2<f64>,
    /// Integral of the yaw rate that was measured, full turns counted [rad].
    pub(crate) yaw: f64,
    /// What the bias of the gyro has walked since the start [rad/s].
    pub(crate) bias: f64,
    /// Distance that the wheels have measured, before it is counted in pulses [m].
    pub(crate) wheels_m: f64,
}

impl Reckoning {
    /// No error yet: the reported position is that of the start.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            seed: scenario.seed,
            drift: scenario.robot.odometry_drift,
            values: scenario.robot_values(),
            lateral: 0.0,
            reported: Vector2::new(scenario.start.x_m, scenario.start.y_m),
            yaw: scenario.start.yaw_rad,
            bias: 0.0,
            wheels_m: 0.0,
        }
    }

    /// The reported position without noise [m].
    pub fn reported(&self) -> Vector2<f64> {
        self.reported
    }

    /// The reported yaw without noise, full turns counted [rad].
    pub fn yaw(&self) -> f64 {
        self.yaw
    }

    /// Distance counted by the wheel encoders [m].
    pub fn encoder_m(&self) -> f64 {
        (self.wheels_m / PULSE_M).floor() * PULSE_M
    }

    /// The lateral error of (7.38) is zero at the first report, which was `elapsed_s` seconds ago.
    ///
    /// Source note: (7.38) does not say when ds is zero. A correction can only count from the first report; if the error
    /// counted from the start of the robot, one scan period before, the difference would be dds T of the whole distance.
    pub(crate) fn begin(&mut self, elapsed_s: f64) {
        if self.drift == DriftGrowth::Time {
            self.lateral = self.values.odometry_lateral_rate * elapsed_s;
        }
    }

    /// Measures the turn of a robot that is turned by hand [rad].
    pub fn turn(&mut self, turn_rad: f64) {
        self.yaw += turn_rad * (1.0 + self.values.gyro_scale);
    }

    /// Follows one plant step from `start_ns` on, of `duration` seconds over `distance` metres, negative backwards, in which
    /// the wheels made `turns_per_way`, [`Plant::turns_per_way`](crate::plant::Plant::turns_per_way).
    ///
    /// The errors of encoders and gyro are drawn for the time at which the step begins.
    pub fn step(
        &mut self,
        start_ns: u64,
        [before, after]: [&State; 2],
        distance: f64,
        turns_per_way: f64,
        duration: f64,
    ) {
        match self.values.odometry_model {
            OdometryModel::Source => {
                let increment = Vector2::new(after.x - before.x, after.y - before.y);
                let yaw = (before.yaw + after.yaw) / 2.0;
                let missed = to_track(yaw, self.values.odometry_longitudinal, self.lateral);
                self.reported += increment - missed * distance;
                self.yaw = after.yaw;
            }
            OdometryModel::Encoders => {
                self.integrate(start_ns, after.yaw - before.yaw, distance, turns_per_way, duration);
            }
        }
        if distance != 0.0 || self.drift == DriftGrowth::Time {
            self.lateral += self.values.odometry_lateral_rate * duration;
        }
    }

    /// Integrates what encoders and gyro measure while the robot turns by `turn` over `distance`.
    fn integrate(&mut self, start_ns: u64, turn: f64, distance: f64, turns_per_way: f64, duration: f64) {
        let Values { odometry_longitudinal, encoder_slip_m, gyro_noise_rad, .. } = self.values;
        let Values { gyro_bias_walk_radps, gyro_bias_radps, gyro_scale, .. } = self.values;
        let mut noise = NoiseStream::new(self.seed, Purpose::Encoders, start_ns);
        let root_s = duration.sqrt();
        let (yaw, counted_m) = (self.yaw, self.encoder_m());
        self.yaw += turn * (1.0 + gyro_scale)
            + (gyro_bias_radps + self.bias) * duration
            + gyro_noise_rad * root_s * noise.normal();
        self.bias += gyro_bias_walk_radps * root_s * noise.normal();
        self.wheels_m += distance * turns_per_way * (1.0 - odometry_longitudinal)
            + encoder_slip_m * distance.abs().sqrt() * noise.normal();
        let mean = f64::midpoint(yaw, self.yaw);
        let (counted_m, axle_m) = (self.encoder_m() - counted_m, self.values.parameters().straight_axle_m());
        if axle_m == 0.0 || distance == 0.0 {
            self.reported += heading(mean) * counted_m;
        } else {
            // The reference point swings out about an axle that rolls straight on.
            let sin = (axle_m * turn / distance).clamp(-1.0, 1.0);
            self.reported += to_track(mean, (1.0 - sin * sin).sqrt(), sin) * counted_m;
        }
        self.reported -= to_track(mean, 0.0, self.lateral) * distance;
    }
}

/// Makes odometry samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Odometer {
    seed: u64,
    noise: Noise,
    jump_rad: f64,
    jump_ns: u64,
    model: OdometryModel,
    pub(crate) last: Option<Reported>,
}

/// A reported pose, noise included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reported {
    pub(crate) time_ns: u64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) yaw: f64,
    pub(crate) encoder_m: f64,
}

impl Odometer {
    /// An odometer that has not reported yet.
    pub fn new(scenario: &Scenario) -> Self {
        let Robot { odometry_jump_rad, odometry_jump_s, .. } = scenario.robot;
        Self {
            seed: scenario.seed,
            noise: scenario.noise,
            jump_rad: odometry_jump_rad,
            jump_ns: (odometry_jump_s * 1e9) as u64,
            model: scenario.robot_values().odometry_model,
            last: None,
        }
    }

    /// Fills all but the header with the reported pose at a node and the increments since the sample before, (7.36)
    /// and (7.37); `stamp_ns` is the time stamp of the sample.
    pub fn report(&mut self, scan_id: u64, stamp_ns: u64, node: &Node, odometry: &mut Odometry) {
        let mut noise = NoiseStream::new(self.seed, Purpose::Odometry, scan_id);
        let jump = if node.time_ns >= self.jump_ns { self.jump_rad } else { 0.0 };
        let reported = Reported {
            time_ns: stamp_ns,
            x: node.reported.x + self.noise.odometry_m * noise.normal(),
            y: node.reported.y + self.noise.odometry_m * noise.normal(),
            yaw: wrap_angle(node.reported_yaw + jump + self.noise.odometry_rad * noise.normal()),
            encoder_m: node.encoder_m,
        };
        let last = self.last.unwrap_or(reported);
        self.last = Some(reported);
        odometry.x_m = reported.x;
        odometry.y_m = reported.y;
        odometry.yaw_rad = reported.yaw;
        odometry.dx_m = reported.x - last.x;
        odometry.dy_m = reported.y - last.y;
        odometry.dyaw_rad = wrap_angle(reported.yaw - last.yaw);
        odometry.dt_s = reported.time_ns.saturating_sub(last.time_ns) as f64 * 1e-9;
        odometry.speed_mps = match self.model {
            OdometryModel::Source => node.speed,
            OdometryModel::Encoders if odometry.dt_s > 0.0 => {
                (reported.encoder_m - last.encoder_m) / odometry.dt_s
            }
            OdometryModel::Encoders => 0.0,
        };
    }
}

#[cfg(test)]
mod tests;
