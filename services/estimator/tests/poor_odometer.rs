//! Robots of others: an odometer that turns by half a degree in each second of driving, counts 1 % too much and slips, and a
//! scanner with 3 cm of noise. Only what stands around says where they are.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use actuation::Actuator;
use emulator::scenario::{ScenarioObstacle, Shape};
use emulator::{Emulator, Scenario};
use estimator::{Estimator, EstimatorConfig};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shared_types::{Command, CommandKind, Header, Level, Odometry, Pose, Role, Scan, SolveStatus, Truth};
use vehicle::frame::{to_robot, to_track, wrap_angle};
use vehicle::{Surroundings, Track};

const PERIOD_NS: u64 = 100_000_000;

/// What is wrong with the odometer.
#[derive(Debug, Clone, Copy)]
struct Errors {
    turn_radps: f64,
    scale: f64,
    slip_m: f64,
}

const POOR: Errors = Errors { turn_radps: 8.7e-3, scale: 0.01, slip_m: 0.01 };

const GOOD: Errors = Errors { turn_radps: 0.0, scale: 0.0, slip_m: 0.003 };

/// An odometer with errors, made from the true motion.
struct Odometer {
    errors: Errors,
    generator: Pcg64,
    truth: Truth,
    seen: [f64; 3],
}

impl Odometer {
    fn report(&mut self, truth: &Truth) -> Odometry {
        let before = std::mem::replace(&mut self.truth, *truth);
        let moved = to_robot(before.yaw_rad, truth.x_m - before.x_m, truth.y_m - before.y_m);
        let way_m = moved.norm();
        let normal = (0..12).map(|_| self.generator.random::<f64>()).sum::<f64>() - 6.0;
        let ahead_m = moved.x * (1.0 + self.errors.scale) + self.errors.slip_m * way_m.sqrt() * normal;
        let turn = wrap_angle(truth.yaw_rad - before.yaw_rad)
            + if way_m > 1e-4 { self.errors.turn_radps * 0.1 } else { 0.0 };
        let [yaw, x, y] = self.seen;
        let step = to_track(yaw, ahead_m, moved.y);
        self.seen = [yaw + turn, x + step.x, y + step.y];
        let [yaw_rad, x_m, y_m] = self.seen;
        Odometry {
            yaw_rad,
            x_m,
            y_m,
            speed_mps: truth.speed_mps * (1.0 + self.errors.scale),
            ..Odometry::default()
        }
    }
}

/// A box from corner to corner.
fn boxed(x_m: [f64; 2], y_m: [f64; 2]) -> ScenarioObstacle {
    let shape = Shape::Box { length_m: x_m[1] - x_m[0], width_m: y_m[1] - y_m[0], yaw_rad: 0.0 };
    ScenarioObstacle::fixed(shape, f64::midpoint(x_m[0], x_m[1]), f64::midpoint(y_m[0], y_m[1]))
}

/// Two walls with pieces of others across beside the way, at uneven distances.
fn rooms() -> Vec<ScenarioObstacle> {
    let mut walls = vec![
        boxed([-3.0, 16.0], [2.35, 2.45]),
        boxed([-3.0, 16.0], [-2.45, -2.35]),
        boxed([-3.1, -3.0], [-2.4, 2.4]),
        boxed([16.0, 16.1], [-2.4, 2.4]),
    ];
    for x_m in [-1.5, 1.7, 5.6, 9.3, 12.8] {
        walls.push(boxed([x_m + 0.2, x_m + 0.35], [1.7, 2.35]));
        walls.push(boxed([x_m - 0.2, x_m - 0.05], [-2.35, -1.7]));
    }
    walls
}

/// How far the estimate is off.
#[derive(Debug, Clone, Copy, Default)]
struct End {
    off_m: [f64; 2],
    yaw_rad: f64,
    bias_radps: f64,
    alarm: u32,
}

/// A drive of 11 m in bends, after `rest` scans at rest.
fn drive(
    bodies: Vec<ScenarioObstacle>,
    errors: Errors,
    config: &EstimatorConfig,
    rest: u64,
    seed: u64,
) -> End {
    let mut scenario = Scenario { seed, timeout_s: 60.0, obstacles: bodies, ..Scenario::default() };
    scenario.noise.range_m = 0.03;
    scenario.track = Track { y_m: [-2.0, 2.0], surroundings: Surroundings::Open, ..scenario.track };
    let mut robot = Emulator::new(&scenario, PERIOD_NS);
    let config =
        EstimatorConfig { track: scenario.track, odometry_longitudinal: Some(0.0), ..config.clone() };
    let mut estimator = Estimator::new(&config).unwrap();
    let mut actuator = Actuator::new(actuation::ActuatorConfig::default(), PERIOD_NS).unwrap();
    let (mut scan, mut truth) = (Scan::default(), Truth::default());
    let mut odometer = None;
    let (mut actuation, mut end) = (None, End::default());
    for scan_id in 1..=300 {
        let now_ns = robot.scan_ready_ns(scan_id);
        robot.advance_to(now_ns);
        robot.measure(scan_id, &mut scan, &mut Odometry::default(), &mut truth);
        let header = Header {
            scan_id,
            sequence: scan_id,
            acquired_ns: robot.acquired_ns(scan_id),
            ..Header::default()
        };
        let odometer = odometer.get_or_insert_with(|| Odometer {
            errors,
            generator: Pcg64::seed_from_u64(seed),
            truth,
            seen: [truth.yaw_rad, truth.x_m, truth.y_m],
        });
        let odometry = Odometry { header, ..odometer.report(&truth) };
        let pose = estimator.step(&odometry, actuation.as_ref(), now_ns).unwrap();
        scan.header = header;
        estimator.see(&scan);
        end = compare(&pose, &truth);
        if pose.x_m > 11.0 {
            break;
        }
        let target = 0.06 * (1.2 * pose.x_m).cos() * f64::from(u8::from(scan_id > rest));
        let steering_rad = (target - 0.05 * pose.y_m - 0.05 * pose.yaw_rad).clamp(-0.06, 0.06);
        let command = Command {
            header: pose.header,
            kind: if scan_id > rest { CommandKind::Drive } else { CommandKind::Stop }.wire(),
            level: Level::Converged.wire(),
            status: SolveStatus::Converged.wire(),
            verified: 1,
            velocity_mps: if scan_id > rest { 1.0 } else { 0.0 },
            steering_rad,
            ..Command::default()
        };
        let mut answer = actuator.answer(&command, now_ns);
        answer.header.stage_mut(Role::Actuator).published_ns = now_ns;
        robot.actuate(&answer);
        actuation = Some(answer);
    }
    end
}

fn compare(pose: &Pose, truth: &Truth) -> End {
    End {
        off_m: [pose.x_m - truth.x_m, pose.y_m - truth.y_m],
        yaw_rad: wrap_angle(pose.yaw_rad - truth.yaw_rad),
        bias_radps: pose.learned[0],
        alarm: pose.alarm,
    }
}

/// A box that crosses in front of the robot while it stands.
fn crossing() -> ScenarioObstacle {
    ScenarioObstacle { velocity_y_mps: 0.4, disappears_s: Some(6.0), ..boxed([2.5, 3.0], [-1.6, -1.1]) }
}

/// What the data sheet of such an odometer says.
fn described() -> EstimatorConfig {
    EstimatorConfig { gyro_bias_radps: 0.01, odometry_scale: 0.02, ..EstimatorConfig::default() }
}

/// Root of the mean square of the ends of ten seeds: to the side and ahead [m], yaw [rad], bias of the gyro [rad/s].
fn rms(bodies: &[ScenarioObstacle], errors: Errors, config: &EstimatorConfig, rest: u64) -> [f64; 4] {
    let mut squares = [0.0; 4];
    for seed in 1..=10 {
        let end = drive(bodies.to_vec(), errors, config, rest, seed);
        assert_eq!(end.alarm, 0, "{rest} {seed}: {end:?}");
        let [ahead_m, side_m] = end.off_m;
        let off = [side_m, ahead_m, end.yaw_rad, end.bias_radps + errors.turn_radps];
        squares = std::array::from_fn(|axis| squares[axis] + off[axis] * off[axis] / 10.0);
    }
    squares.map(f64::sqrt)
}

#[test]
fn between_walls_a_robot_with_a_poor_gyro_knows_where_it_is_also_after_a_rest_and_past_what_moves() {
    let with_body = [rooms(), vec![crossing()]].concat();
    // By the odometer alone it would be 0.53 m to the side and 96 mrad off. What turns it before the first scans are compared, at
    // once or after a rest, is the yaw of the first walls for good.
    for (bodies, rest, side_m, yaw_rad) in
        [(rooms(), 2, 0.045, 5e-3), (rooms(), 100, 0.01, 1.5e-3), (with_body, 50, 0.015, 2e-3)]
    {
        let [side, ahead, yaw, bias] = rms(&bodies, POOR, &described(), rest);
        assert!(side < side_m && yaw < yaw_rad, "{rest}: {side} {yaw}");
        assert!(ahead < 0.025 && bias < 4e-4, "{rest}: {ahead} {bias}");
    }
}

#[test]
fn a_good_gyro_is_not_taken_for_a_poor_one() {
    let [side, _, yaw, bias] = rms(&rooms(), GOOD, &EstimatorConfig::default(), 2);
    assert!(side < 0.01 && yaw < 1e-3 && bias < 2e-4, "{side} {yaw} {bias}");
}

/// What the laser can't show: without anything in view the odometer's errors are those of the pose.
#[test]
fn in_the_open_the_pose_is_that_of_the_odometer() {
    let end = drive(vec![], POOR, &EstimatorConfig::default(), 2, 1);
    // 11 s at 8.7 mrad/s turn by 0.096 rad; half of that over 11 m is 0.53 m.
    assert!((end.off_m[1] - 0.53).abs() < 0.03 && (end.yaw_rad - 0.096).abs() < 0.005, "{end:?}");
}
