//! The emulated odometry: the true motion with the errors that (7.36)-(7.40) correct, or wheel encoders and a gyro.
//!
//! (7.39) and (7.40) correct a reported increment by v dt R(yaw) (df, ds), with ds growing at the rate dds (7.38).
//! The odometer of `odometry_model = "source"` has exactly this error:
//! true increment = reported + v dt R(yaw) (df, ds). The error accumulates; noise does not: it is white on the reported
//! pose. Yaw has noise only, and may be off by a constant from some moment on, like a compass that passes a magnet. The
//! speed is the true one.
//!
//! With `"encoders"`, the distance comes from wheel encoders in steps of 1 mm, with the scale error df and slip, and the
//! yaw is the integral of a gyro with white noise and a bias that walks at random. The reported position is integrated
//! from these two, so its error accumulates in all components. The speed is the counted distance since the sample
//! before, divided by the time between them. The encoders measure the distance over ground, also of blocked wheels.
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
    /// Bias of the gyro [rad/s].
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

    /// Follows one plant step from `start_ns` on, of `duration` seconds over `distance` metres, negative backwards.
    ///
    /// The errors of encoders and gyro are drawn for the time at which the step begins.
    pub fn step(&mut self, start_ns: u64, before: &State, after: &State, distance: f64, duration: f64) {
        match self.values.odometry_model {
            OdometryModel::Source => {
                let increment = Vector2::new(after.x - before.x, after.y - before.y);
                let yaw = (before.yaw + after.yaw) / 2.0;
                let missed = to_track(yaw, self.values.odometry_longitudinal, self.lateral);
                self.reported += increment - missed * distance;
                self.yaw = after.yaw;
            }
            OdometryModel::Encoders => {
                self.integrate(start_ns, after.yaw - before.yaw, distance, duration);
            }
        }
        if distance != 0.0 || self.drift == DriftGrowth::Time {
            self.lateral += self.values.odometry_lateral_rate * duration;
        }
    }

    /// Integrates what encoders and gyro measure while the robot turns by `turn` over `distance`.
    fn integrate(&mut self, start_ns: u64, turn: f64, distance: f64, duration: f64) {
        let Values { odometry_longitudinal, encoder_slip_m, gyro_noise_rad, gyro_bias_walk_radps, .. } =
            self.values;
        let mut noise = NoiseStream::new(self.seed, Purpose::Encoders, start_ns);
        let root_s = duration.sqrt();
        let (yaw, counted_m) = (self.yaw, self.encoder_m());
        self.yaw += turn + self.bias * duration + gyro_noise_rad * root_s * noise.normal();
        self.bias += gyro_bias_walk_radps * root_s * noise.normal();
        self.wheels_m += distance * (1.0 - odometry_longitudinal)
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
mod tests {
    use super::*;
    use vehicle::VehicleModel;

    fn reckoning(robot: Robot) -> Reckoning {
        Reckoning::new(&Scenario { robot, ..Scenario::default() })
    }

    #[test]
    fn the_odometry_of_a_car_is_that_of_its_reference_point() {
        let model = Some(VehicleModel::Bicycle);
        let robot = Robot { model, odometry_model: Some(OdometryModel::Encoders), ..Robot::default() };
        let robot = Robot { odometry_longitudinal: Some(0.0), encoder_slip_m: Some(0.0), ..robot };
        let robot = Robot { gyro_noise_rad: Some(0.0), gyro_bias_walk_radps: Some(0.0), ..robot };
        let mut reckoning = reckoning(robot);
        // A quarter of a circle with 1 m radius of the straight axle, 0.1924 m behind the reference point.
        let (steps, arm_m) = (1000, 0.1924_f64);
        let turn = std::f64::consts::FRAC_PI_2 / f64::from(steps);
        for step in 0..steps {
            let state = |step: i32| State { yaw: turn * f64::from(step), ..State::default() };
            let way_m = turn * 1.0_f64.hypot(arm_m);
            reckoning.step(step as u64 * 1_000_000, &state(step), &state(step + 1), way_m, 1e-3);
        }
        let expected = Vector2::new(1.0 - arm_m, 1.0 + arm_m);
        assert!((reckoning.reported() - expected).norm() < 3e-3, "{}", reckoning.reported());
    }

    /// Drives straight along a yaw at 1 m/s for `seconds`, in milliseconds.
    fn straight(reckoning: &mut Reckoning, yaw: f64, seconds: f64) -> Vector2<f64> {
        let steps = (seconds * 1000.0).round() as usize;
        let mut state = State { yaw, ..State::default() };
        for _ in 0..steps {
            let forward = to_track(yaw, 1e-3, 0.0);
            let next = State { x: state.x + forward.x, y: state.y + forward.y, ..state };
            reckoning.step(0, &state, &next, 1e-3, 1e-3);
            state = next;
        }
        Vector2::new(state.x, state.y)
    }

    #[test]
    fn one_percent_of_the_way_is_missed() {
        let mut reckoning = reckoning(Robot { odometry_longitudinal: Some(0.01), ..Robot::default() });
        straight(&mut reckoning, 0.0, 10.0);
        assert!((reckoning.reported() - Vector2::new(9.9, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn the_lateral_error_grows_with_the_square_of_time_across_the_heading() {
        let robot = Robot {
            odometry_longitudinal: Some(0.0),
            odometry_lateral_rate: Some(0.053),
            ..Robot::default()
        };
        let mut reckoning = reckoning(robot);
        let place = straight(&mut reckoning, std::f64::consts::FRAC_PI_2, 2.0);
        // dds t^2 / 2 = 0.106 m to the left is missed; left of a robot that faces along y is -x. The sum over
        // steps of ds before its growth is smaller by half a step: 0.053 * 2 s * 0.5 ms = 5.3e-5 m.
        assert!((reckoning.reported() - place - Vector2::new(0.106, 0.0)).norm() < 6e-5);
    }

    #[test]
    fn at_standstill_the_lateral_share_grows_only_where_it_grows_with_time() {
        let rest = State::default();
        for (drift, expected) in [(DriftGrowth::Moving, 0.0), (DriftGrowth::Time, 0.1)] {
            let mut reckoning = reckoning(Robot {
                odometry_lateral_rate: Some(0.1),
                odometry_drift: drift,
                ..Robot::default()
            });
            (0..1000).for_each(|_| reckoning.step(0, &rest, &rest, 0.0, 1e-3));
            assert!((reckoning.lateral - expected).abs() < 1e-12);
            assert_eq!(reckoning.reported(), Vector2::zeros());
        }
    }

    #[test]
    fn noise_is_white_on_the_pose_and_increments_are_differences() {
        let noise = Noise { odometry_m: 0.02, odometry_rad: 0.01, ..Noise::default() };
        let mut odometer = Odometer::new(&Scenario { noise, ..Scenario::default() });
        let (mut sum, mut last) = ([0.0; 3], None::<Odometry>);
        for scan in 1..=4000 {
            let state = State { yaw: 3.1, ..State::default() };
            let node = Node {
                time_ns: scan * 100_000_000,
                state,
                speed: 0.0,
                steering: 0.0,
                reported: Vector2::new(3.0, -1.0),
                reported_yaw: state.yaw,
                encoder_m: 0.0,
            };
            let mut odometry = Odometry::default();
            odometer.report(scan, node.time_ns, &node, &mut odometry);
            sum[0] += (odometry.x_m - 3.0).powi(2);
            sum[1] += (odometry.y_m + 1.0).powi(2);
            sum[2] += wrap_angle(odometry.yaw_rad - 3.1).powi(2);
            match last {
                None => assert_eq!((odometry.dx_m, odometry.dt_s), (0.0, 0.0)),
                Some(last) => {
                    assert_eq!(odometry.dx_m, odometry.x_m - last.x_m);
                    assert!((odometry.dt_s - 0.1).abs() < 1e-12);
                    assert!(odometry.dyaw_rad.abs() < 0.2, "increments of yaw cross the half turn");
                }
            }
            last = Some(odometry);
        }
        // The standard error of a deviation from 4000 samples is 1.1 %; five of them.
        for (sum, expected) in sum.iter().zip([0.02, 0.02, 0.01]) {
            assert!(((sum / 4000.0).sqrt() / expected - 1.0).abs() < 0.056);
        }
    }

    fn encoders() -> Robot {
        Robot { odometry_model: Some(OdometryModel::Encoders), ..Robot::default() }
    }

    /// Error of the position along and across and of the yaw after 20 m straight ahead in 20 s.
    fn error_after_20_m(robot: Robot, seed: u64) -> [f64; 3] {
        let mut reckoning = Reckoning::new(&Scenario { robot, seed, ..Scenario::default() });
        for step in 0..20_000 {
            let at = |step: u64| State { x: step as f64 * 1e-3, ..State::default() };
            reckoning.step(step * 1_000_000, &at(step), &at(step + 1), 1e-3, 1e-3);
        }
        [reckoning.reported().x - 20.0, reckoning.reported().y, reckoning.yaw()]
    }

    #[test]
    fn encoders_count_whole_millimetres_of_what_the_scale_leaves() {
        let robot = Robot { encoder_slip_m: Some(0.0), gyro_noise_rad: Some(0.0), ..encoders() };
        let robot = Robot { gyro_bias_walk_radps: Some(0.0), ..robot };
        let mut reckoning = reckoning(robot);
        straight(&mut reckoning, 0.0, 1.0);
        // 0.99 m are measured, to the last pulse.
        let counted = reckoning.encoder_m();
        assert!((counted - 0.99).abs() < 1.1e-3 && (counted / PULSE_M).fract().abs() < 1e-9, "{counted}");
        assert!((reckoning.reported().x - counted).abs() < 1e-9);
        straight(&mut reckoning, 0.0, 9.0);
        assert!((reckoning.reported().x - 9.9).abs() < 1.1e-3);
    }

    #[test]
    fn errors_of_encoders_and_gyro_accumulate_to_three_centimetres_after_twenty_metres() {
        let robot = Robot { odometry_longitudinal: Some(0.0), ..encoders() };
        let errors: Vec<[f64; 3]> = (0..200).map(|seed| error_after_20_m(robot, seed)).collect();
        let deviation = |index: usize| {
            (errors.iter().map(|error| error[index] * error[index]).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let [along, across, yaw] = [0, 1, 2].map(deviation);
        eprintln!("along {along:.4} m, across {across:.4} m, yaw {yaw:.5} rad");
        // 5 mm sqrt(20) = 22.4 mm; yaw: 2e-4 sqrt(20) = 8.9e-4 and 2e-5 sqrt(20^3 / 3) = 1.03e-3 rad, together 1.36e-3;
        // across: 2e-4 sqrt(20^3 / 3) = 10.3 mm and 2e-5 sqrt(20^5 / 20) = 8 mm, together 13 mm.
        // The standard error of a deviation from 200 samples is 5 %; four of them.
        assert!((along / 0.0224 - 1.0).abs() < 0.2, "{along}");
        assert!((across / 0.0131 - 1.0).abs() < 0.2, "{across}");
        assert!((yaw / 1.36e-3 - 1.0).abs() < 0.2, "{yaw}");
    }

    #[test]
    fn the_speed_of_encoders_is_the_counted_distance_over_the_time_between_samples() {
        let mut odometer = Odometer::new(&Scenario { robot: encoders(), ..Scenario::default() });
        let mut speeds = Vec::new();
        for (scan, encoder_m) in [(1, 0.0), (2, 0.05), (3, 0.149), (5, 0.349)] {
            let node = Node {
                time_ns: scan * 100_000_000,
                state: State::default(),
                speed: 9.0,
                steering: 0.0,
                reported: Vector2::zeros(),
                reported_yaw: 0.0,
                encoder_m,
            };
            let mut odometry = Odometry::default();
            odometer.report(scan, node.time_ns, &node, &mut odometry);
            speeds.push(odometry.speed_mps);
        }
        let expected = [0.0, 0.5, 0.99, 1.0];
        assert!(
            speeds.iter().zip(expected).all(|(speed, expected)| (speed - expected).abs() < 1e-9),
            "{speeds:?}"
        );
    }

    #[test]
    fn the_lateral_error_acts_on_top_of_encoders() {
        let robot = Robot { odometry_lateral_rate: Some(0.053), encoder_slip_m: Some(0.0), ..encoders() };
        let robot = Robot { gyro_noise_rad: Some(0.0), gyro_bias_walk_radps: Some(0.0), ..robot };
        let mut reckoning = reckoning(robot);
        straight(&mut reckoning, 0.0, 2.0);
        assert!((reckoning.reported().y + 0.106).abs() < 6e-5, "{}", reckoning.reported().y);
    }
}
