//! Errors that can be computed by hand, and how they grow over many seeds.

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
        reckoning.step(step as u64 * 1_000_000, [&state(step), &state(step + 1)], way_m, 1.0, 1e-3);
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
        reckoning.step(0, [&state, &next], 1e-3, 1.0, 1e-3);
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
    let robot =
        Robot { odometry_longitudinal: Some(0.0), odometry_lateral_rate: Some(0.053), ..Robot::default() };
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
        let mut reckoning =
            reckoning(Robot { odometry_lateral_rate: Some(0.1), odometry_drift: drift, ..Robot::default() });
        (0..1000).for_each(|_| reckoning.step(0, [&rest, &rest], 0.0, 1.0, 1e-3));
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
        reckoning.step(step * 1_000_000, [&at(step), &at(step + 1)], 1e-3, 1.0, 1e-3);
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

/// Encoders and a gyro without random errors.
fn exact() -> Robot {
    let robot = Robot { encoder_slip_m: Some(0.0), gyro_noise_rad: Some(0.0), ..encoders() };
    Robot { gyro_bias_walk_radps: Some(0.0), odometry_longitudinal: Some(0.0), ..robot }
}

#[test]
fn a_gyro_measures_its_turn_on_bias_at_rest_too_and_a_share_more_of_each_turn() {
    let rest = State::default();
    let mut still = reckoning(Robot { gyro_bias_radps: Some(0.001), gyro_scale: Some(0.005), ..exact() });
    (0..10_000).for_each(|_| still.step(0, [&rest, &rest], 0.0, 1.0, 1e-3));
    assert!((still.yaw() - 0.01).abs() < 1e-12, "0.001 rad/s for 10 s: {}", still.yaw());
    let turned = State { yaw: 2.0, ..State::default() };
    let mut turning = reckoning(Robot { gyro_scale: Some(0.005), ..exact() });
    turning.step(0, [&rest, &turned], 0.0, 1.0, 1e-3);
    assert!((turning.yaw() - 2.01).abs() < 1e-12, "{}", turning.yaw());
    turning.turn(-2.0);
    assert!(turning.yaw().abs() < 1e-12, "turned back by hand: {}", turning.yaw());
}

#[test]
fn encoders_count_what_the_wheels_turn_and_the_source_knows_the_way_over_ground() {
    let source = Robot { odometry_longitudinal: Some(0.0), ..Robot::default() };
    for (robot, expected_m) in [(exact(), 1.25), (source, 1.0)] {
        let mut reckoning = reckoning(robot);
        for step in 0..1000 {
            let [before, after] =
                [step, step + 1].map(|step| State { x: f64::from(step) * 1e-3, ..State::default() });
            // A fifth of the turning is slip: 1.25 turns per way.
            reckoning.step(0, [&before, &after], 1e-3, 1.25, 1e-3);
        }
        assert!((reckoning.reported().x - expected_m).abs() < 1.1e-3, "{}", reckoning.reported().x);
    }
}
