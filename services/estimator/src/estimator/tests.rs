//! The order of samples, what the gate refuses, and what survives; the figures of the source stand in [`figures`].

use proptest::prelude::*;
use shared_types::{ActuationKind, Alarm, Header, Sample};
use vehicle::{Control, Description};

use super::*;
use crate::NoiseProfile;
use crate::config::FilterKind;
use crate::correction::CorrectionMode;

mod drift;
mod figures;
mod possible;

const PERIOD_NS: u64 = 100_000_000;

/// The default settings for a robot that follows at once.
fn scaled() -> EstimatorConfig {
    EstimatorConfig { profile: NoiseProfile::Scaled, ..at_once() }
}

fn at_once() -> EstimatorConfig {
    EstimatorConfig { vehicle: Description::default().without_lag(), ..EstimatorConfig::default() }
}

fn source() -> EstimatorConfig {
    EstimatorConfig { profile: NoiseProfile::Source, ..at_once() }
}

fn header(scan: u64) -> Header {
    Header {
        incarnation: 1,
        scan_id: scan,
        sequence: scan,
        acquired_ns: scan * PERIOD_NS,
        ..Header::default()
    }
}

fn actuation(scan: u64, control: Control) -> Actuation {
    let mut header = header(scan);
    header.stage_mut(Role::Actuator).published_ns = scan * PERIOD_NS + PERIOD_NS / 3;
    Actuation {
        header,
        kind: ActuationKind::Drive.wire(),
        answers: 1,
        desired_velocity_mps: control.velocity,
        desired_steering_rad: control.steering,
        ..Actuation::default()
    }
}

fn odometry(scan: u64, x: f64, speed: f64) -> Odometry {
    Odometry { header: header(scan), x_m: x, speed_mps: speed, ..Odometry::default() }
}

fn ideal() -> EstimatorConfig {
    EstimatorConfig { correction: Some(CorrectionMode::Off), ..at_once() }
}

/// An estimator of a robot that drives straight at 1 m/s, after `scans` samples.
fn straight(config: &EstimatorConfig, scans: u64) -> (Estimator, Option<Pose>) {
    let mut estimator = Estimator::new(config).unwrap();
    estimator.note(&actuation(0, Control { velocity: 1.0, steering: 0.0 }), 0);
    let pose = (1..=scans)
        .map(|scan| estimator.step(&odometry(scan, 0.1 * scan as f64, 1.0), None, at(scan)))
        .last();
    (estimator, pose.flatten())
}

fn at(scan: u64) -> u64 {
    scan * PERIOD_NS + PERIOD_NS / 3
}

#[test]
fn the_first_odometry_is_the_first_estimate() {
    let mut estimator = Estimator::new(&at_once()).unwrap();
    let sample = Odometry { x_m: 1.5, y_m: -0.25, yaw_rad: 0.1, ..odometry(1, 0.0, 0.0) };
    let pose = estimator.step(&sample, None, at(1)).unwrap();
    assert_eq!((pose.x_m, pose.y_m, pose.yaw_rad, pose.speed_mps), (1.5, -0.25, 0.1, 0.0));
    assert_eq!((pose.header.scan_id, pose.header.acquired_ns, pose.predicted_ns), (1, PERIOD_NS, at(1)));
    assert_eq!((pose.predicted_x_m, pose.covariance[0], pose.covariance[4]), (1.5, 1e-4, 4e-4));
}

#[test]
fn the_prediction_ends_when_the_command_would_act() {
    let vehicle = Description { command_delay_s: 0.01, ..ideal().vehicle };
    let config = EstimatorConfig { vehicle, ..ideal() };
    let (_, pose) = straight(&config, 20);
    let pose = pose.unwrap();
    assert_eq!(pose.predicted_ns, at(20) + 10_000_000);
    assert!(
        (pose.predicted_x_m - pose.x_m - (pose.predicted_ns - 20 * PERIOD_NS) as f64 * 1e-9).abs() < 1e-9
    );
    let (mut estimator, _) = straight(&ideal(), 5);
    let late = estimator.step(&odometry(6, 0.6, 1.0), None, at(600)).unwrap();
    assert_eq!(late.predicted_ns, 6 * PERIOD_NS + 1_000_000_000, "an hour is not looked ahead");
}

#[test]
fn the_lead_contains_the_delay_and_the_share_of_the_steering_lag() {
    let lead = |lead_share| {
        let config = EstimatorConfig { lead_share, vehicle: Description::default(), ..ideal() };
        straight(&config, 20).1.unwrap().predicted_ns - at(20)
    };
    assert_eq!((lead(0.0), lead(0.5), lead(1.0)), (20_000_000, 70_000_000, 120_000_000));
}

#[test]
fn a_lost_sample_is_a_longer_prediction() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let pose = estimator.step(&odometry(9, 0.9, 1.0), None, at(9)).unwrap();
    assert!((pose.x_m - 0.9).abs() < 1e-9 && pose.innovation[1].abs() < 1e-9);
    assert!((pose.predicted_x_m - (0.9 + 0.1 / 3.0)).abs() < 1e-8);
}

#[test]
fn samples_that_are_not_newer_give_no_pose_and_change_nothing() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let before = estimator.state();
    for scan in [5, 4, 1] {
        assert!(estimator.step(&odometry(scan, 7.0, 1.0), None, at(6)).is_none());
    }
    let mut renumbered = odometry(6, 0.6, 1.0);
    renumbered.header.sequence = 3;
    assert!(estimator.step(&renumbered, None, at(6)).is_none());
    assert_eq!(estimator.state().skipped, 4);
    assert_eq!(EstimatorState { skipped: 0, ..estimator.state() }, before);
    assert!(estimator.step(&odometry(6, 0.6, 1.0), None, at(6)).is_some());
    let mut restarted = odometry(7, 0.7, 1.0);
    (restarted.header.incarnation, restarted.header.sequence) = (2, 1);
    assert!(estimator.step(&restarted, None, at(7)).is_some(), "a new producer numbers from 1");
}

#[test]
fn numbers_that_are_none_give_no_pose() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let before = estimator.state();
    for wild in [f64::NAN, f64::INFINITY, -1e300] {
        let sample = odometry(6, 0.6, 1.0);
        assert!(estimator.step(&Odometry { x_m: wild, ..sample }, None, at(6)).is_none());
        assert!(estimator.step(&Odometry { yaw_rad: wild, ..sample }, None, at(6)).is_none());
        assert_eq!(estimator.refusal().map(|fault| fault.finding().0), Some("yaw_rad"));
    }
    assert!(estimator.step(&odometry(6, 2.1e4, 1.0), None, at(6)).is_none(), "no track is that long");
    assert_eq!(EstimatorState { invalid: 0, ..estimator.state() }, before);
    let pose = estimator.step(&odometry(6, 0.6, f64::NAN), None, at(6)).unwrap();
    assert_eq!(estimator.refusal(), None);
    assert_eq!(pose.speed_mps, 1.0, "without a measured speed the desired one holds");
}

#[test]
fn stamps_from_the_future_do_not_shut_out_the_present() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let mut future = odometry(6, 0.6, 1.0);
    future.header.acquired_ns = u64::MAX;
    let mut command = actuation(6, Control { velocity: 0.2, steering: 0.06 });
    command.header.stage_mut(Role::Actuator).published_ns = u64::MAX;
    assert!(estimator.step(&future, Some(&command), at(6)).is_none());
    let slower = actuation(6, Control { velocity: 0.5, steering: 0.0 });
    let pose = estimator.step(&odometry(7, 0.6667, 0.5), Some(&slower), at(7)).unwrap();
    assert_eq!(pose.speed_mps, 0.5);
    assert!(pose.innovation[1].abs() < 1e-4, "a third of the last period at 1 m/s, two thirds at 0.5 m/s");
}

#[test]
fn an_outlier_is_refused_and_the_prediction_is_kept() {
    let (mut estimator, _) = straight(&ideal(), 20);
    let pose = estimator.step(&odometry(21, 3.0, 1.0), None, at(21)).unwrap();
    assert!((pose.x_m - 2.1).abs() < 1e-9 && pose.nis > GATE[2]);
    assert_eq!(pose.rejected, 1);
    let next = estimator.step(&odometry(22, 2.2, 1.0), None, at(22)).unwrap();
    assert!((next.x_m - 2.2).abs() < 1e-9 && next.rejected == 1);
}

#[test]
fn an_estimate_that_fits_nothing_any_more_begins_anew() {
    let (mut estimator, _) = straight(&ideal(), 20);
    for scan in 21..25 {
        let pose = estimator.step(&odometry(scan, 1.0 + 0.1 * scan as f64, 1.0), None, at(scan)).unwrap();
        assert!((pose.x_m - 0.1 * scan as f64).abs() < 1e-9);
    }
    let pose = estimator.step(&odometry(25, 3.5, 1.0), None, at(25)).unwrap();
    assert_eq!((pose.x_m, pose.rejected, estimator.state().restarts), (3.5, 5, 1));
}

#[test]
fn after_a_long_gap_the_estimate_is_the_measurement() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let pose = estimator.step(&odometry(60, 1.25, 0.0), None, at(60)).unwrap();
    assert_eq!((pose.x_m, pose.speed_mps, estimator.state().restarts), (1.25, 0.0, 1));
}

/// A successor has the state of scan 5; the wheels were blocked at scan 7, which it did not receive.
#[test]
fn after_a_gap_the_measured_speed_wins_over_the_predicted_one_and_nothing_is_suspected() {
    let (mut estimator, _) = straight(&ideal(), 5);
    let pose = estimator.step(&odometry(15, 0.8, 0.0), None, at(15)).unwrap();
    assert_eq!((pose.x_m, pose.speed_mps, pose.rejected, pose.alarm), (0.8, 0.0, 0, 0));
    for scan in 16..30 {
        let pose = estimator.step(&odometry(scan, 0.8, 0.0), None, at(scan)).unwrap();
        assert!((pose.x_m - 0.8).abs() < 1e-9 && pose.rejected == 0 && pose.alarm == 0, "{scan}: {pose:?}");
    }
}

#[test]
fn a_jump_in_a_gap_that_the_robot_cannot_have_driven_is_refused() {
    for (x, yaw) in [(2.0, 0.0), (0.1, 0.0), (0.8, 1.0)] {
        let (mut estimator, _) = straight(&ideal(), 5);
        let sample = Odometry { yaw_rad: yaw, ..odometry(9, x, 1.0) };
        assert_eq!(estimator.step(&sample, None, at(9)).unwrap().rejected, 1, "{x} {yaw}");
    }
}

/// The estimate after a lost sample, of a robot at 1 m/s whose measurements have a noise of 20 mm and 10 mrad.
fn refused_after_a_lost_sample(x_m: f64, yaw_rad: f64) -> u64 {
    let (mut estimator, _) = straight(&ideal(), 5);
    let sample = Odometry { yaw_rad, ..odometry(7, x_m, 1.0) };
    estimator.step(&sample, None, at(7)).unwrap().rejected
}

#[test]
fn the_reach_after_a_gap_ends_five_standard_deviations_beyond_the_way() {
    // From 0.5 m and 1 m/s: 0.2 m in 0.2 s, and 0.1 m of noise to either side, as the robot can't drive back.
    let [beyond, before] = [0.7 + 0.1, 0.5 - 0.1];
    assert_eq!([beyond - 0.005, beyond + 0.005].map(|x_m| refused_after_a_lost_sample(x_m, 0.0)), [0, 1]);
    assert_eq!([before + 0.005, before - 0.005].map(|x_m| refused_after_a_lost_sample(x_m, 0.0)), [0, 1]);
    // At most 0.12 rad times 1.08 times 5.397 1/m in 0.2 m, and 0.05 rad of noise.
    let turn = 0.2 * 0.12 * 1.08 * 5.397 + 0.05;
    assert_eq!([turn - 0.003, turn + 0.003].map(|yaw| refused_after_a_lost_sample(0.7, yaw)), [0, 1]);
    assert_eq!([turn - 0.003, turn + 0.003].map(|yaw| refused_after_a_lost_sample(0.7, -yaw)), [0, 1]);
}

#[test]
fn the_reach_follows_the_noise_of_the_measurement() {
    let config = EstimatorConfig { measurement_noise: Some([1e-4, 1.6e-3, 1.6e-3]), ..ideal() };
    let refused = |x_m| {
        let (mut estimator, _) = straight(&config, 5);
        estimator.step(&odometry(7, x_m, 1.0), None, at(7)).unwrap().rejected
    };
    // Five times 40 mm beyond 0.7 m.
    assert_eq!([0.895, 0.905].map(refused), [0, 1]);
}

#[test]
fn a_sample_that_comes_late_is_no_evidence_and_one_that_is_on_time_is() {
    for (late_ns, refused) in [(0, 1), (40_000_000, 1), (60_000_000, 0), (2_000_000_000, 0)] {
        let mut estimator = Estimator::new(&ideal()).unwrap();
        for scan in 1..=20 {
            estimator.step(&odometry(scan, 0.1 * scan as f64, 1.0), None, at(scan)).unwrap();
            estimator.note(&actuation(scan, Control { velocity: 1.0, steering: 0.0 }), at(scan));
        }
        // A tenth less than the way of 0.1 m, and 20 mm of noise five times: it may have stood.
        let pose = estimator.step(&odometry(21, 1.92, 0.0), None, at(21) + late_ns).unwrap();
        assert_eq!(pose.rejected, refused, "{late_ns} ns late");
    }
}

#[test]
fn scans_that_are_always_late_become_evidence() {
    let mut estimator = Estimator::new(&ideal()).unwrap();
    let late_ns = |scan| if scan > 5 { 80_000_000 } else { 0 };
    for scan in 1..=40 {
        estimator.step(&odometry(scan, 0.1 * scan as f64, 1.0), None, at(scan) + late_ns(scan)).unwrap();
        estimator.note(&actuation(scan, Control { velocity: 1.0, steering: 0.0 }), at(scan));
    }
    let pose = estimator.step(&odometry(41, 3.92, 0.0), None, at(41) + late_ns(41)).unwrap();
    assert_eq!(pose.rejected, 1);
}

#[test]
fn yaw_passes_the_half_turn_without_a_jump() {
    let mut estimator = Estimator::new(&ideal()).unwrap();
    for scan in 1..=60 {
        // At 5 mrad per sample and a gain of 0.18 the estimate of a robot that should stand lags by up to 27 mrad.
        let yaw = wrap_angle(3.0 + 0.005 * scan as f64);
        let sample = Odometry { yaw_rad: yaw, ..odometry(scan, 0.0, 0.0) };
        let pose = estimator.step(&sample, None, at(scan)).unwrap();
        assert!(wrap_angle(pose.yaw_rad - yaw).abs() < 0.027, "{scan}: {}", pose.yaw_rad);
        assert!(pose.innovation[0].abs() < 0.03);
    }
}

#[test]
fn the_printed_noise_has_the_printed_gains() {
    let (_, pose) = straight(&EstimatorConfig { correction: Some(CorrectionMode::Off), ..source() }, 200);
    let pose = pose.unwrap();
    // y is coupled with yaw by the distance driven, a little.
    for (index, expected) in [(0, 0.27), (4, 0.27), (8, 0.92)] {
        assert!((pose.gain[index] - expected).abs() < 0.01, "{index}: {}", pose.gain[index]);
    }
}

#[test]
fn a_resumed_estimator_continues_with_the_same_bits() {
    let (mut original, _) = straight(&EstimatorConfig::default(), 30);
    let mut resumed = Estimator::new(&EstimatorConfig::default()).unwrap();
    assert_eq!(resumed.resume(&original.state()), Ok(()));
    for scan in 31..60 {
        let sample = odometry(scan, 0.0999 * scan as f64, 0.99);
        assert_eq!(original.step(&sample, None, at(scan)), resumed.step(&sample, None, at(scan)));
    }
    for spoil in [
        (|state| state.covariance[4] = -1.0) as fn(&mut EstimatorState),
        |state| state.estimate[1] = f64::NAN,
        |state| state.motion.count = 99,
        |state| state.correction.x_m = f64::INFINITY,
    ] {
        let mut state = original.state();
        spoil(&mut state);
        assert!(resumed.resume(&state).is_err());
    }
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![8 => -50.0..50.0f64, 1 => any::<f64>(), 1 => Just(f64::NAN)]
}

proptest! {
    #[test]
    fn whatever_comes_in_poses_are_finite_and_covariances_positive_definite(
        steps in proptest::collection::vec(
            (0..8u64, any_number(), any_number(), any_number(), any_number(), any_number(), 0..3u32), 1..60),
        printed: bool,
    ) {
        let mut estimator = Estimator::new(&if printed { source() } else { EstimatorConfig::default() }).unwrap();
        let mut scan = 1;
        for (skip, x, y, yaw, speed, steering, kind) in steps {
            scan += skip;
            let sample = Odometry { y_m: y, yaw_rad: yaw, ..odometry(scan, x, speed) };
            let mut actuation = actuation(scan, Control { velocity: speed / 50.0, steering: steering / 500.0 });
            actuation.kind = kind;
            if let Some(mut pose) = estimator.step(&sample, Some(&actuation), at(scan)) {
                pose.header.layout = Pose::LAYOUT;
                prop_assert_eq!(pose.check(), Ok(()));
                let covariance = Matrix3::from_row_slice(&pose.covariance);
                prop_assert_eq!(covariance, covariance.transpose());
                prop_assert!(covariance.symmetric_eigenvalues().min() > 0.0);
                prop_assert!(pose.nis >= 0.0 && pose.yaw_rad.abs() <= std::f64::consts::PI);
            }
            prop_assert_eq!(estimator.state().check(), Ok(()));
        }
    }
}

#[test]
fn a_state_with_variances_that_none_can_have_is_refused() {
    let (estimator, _) = straight(&EstimatorConfig::default(), 5);
    let sound = estimator.state();
    assert_eq!(sound.check(), Ok(()));
    for variance in [1e200, -1.0] {
        let mut covariance = sound.covariance;
        covariance[4] = variance;
        let mut learned = sound.learned;
        learned.velocity_variance = variance;
        assert!(EstimatorState { covariance, ..sound }.check().is_err(), "{variance}");
        assert!(EstimatorState { learned, ..sound }.check().is_err(), "{variance}");
    }
}

#[test]
fn lost_samples_are_no_evidence_against_the_calibration() {
    // Outages: the robot blocks its wheels and stands; the actuations that say so are lost as well.
    for lost in [2, 4, 6, 8] {
        let mut estimator = Estimator::new(&EstimatorConfig {
            correction: Some(CorrectionMode::Off),
            ..EstimatorConfig::default()
        })
        .unwrap();
        let (mut x_m, mut scan) = (0.0, 0);
        for outage in 0..20 {
            for since in 0..4_i32 {
                scan += 1;
                // It drives off again.
                let speed = 0.9 * (1.0 - 0.5_f64.powi(since + 1));
                x_m += 0.1 * speed;
                let pose = estimator.step(&odometry(scan, x_m, speed), None, at(scan)).unwrap();
                let alarm = Alarm::try_from(pose.alarm).unwrap();
                assert_eq!(alarm, Alarm::None, "outage {outage} of {lost} scans, {:?}", pose.suspect);
                estimator.note(&actuation(scan, Control { velocity: 0.9, steering: 0.0 }), at(scan));
            }
            scan += lost;
        }
    }
}

#[test]
fn the_linear_filter_keeps_yaw_and_place_apart() {
    // Each is a scalar filter: P + Q, K = P / (P + R), (1 - K) P, (7.9)-(7.13).
    let config = EstimatorConfig { filter: FilterKind::Linear, ..source() };
    let (estimator, _) = straight(&config, 8);
    let covariance = estimator.state().covariance;
    let noise = [(0.1, 1.0), (0.1, 1.0), (100.0, 10.0)];
    for (axis, (process, measured)) in noise.into_iter().enumerate() {
        let after = (1..8).fold(measured, |variance: f64, _| {
            let before = variance + process;
            before * measured / (before + measured)
        });
        assert!((covariance[4 * axis] - after).abs() < 1e-12, "{axis}: {} {after}", covariance[4 * axis]);
    }
    assert!([1, 2, 3, 5, 6, 7].iter().all(|place| covariance[*place] == 0.0), "{covariance:?}");
    let partial = EstimatorConfig { measure: vec![crate::observability::Measured::X], ..config.clone() };
    assert!(partial.validate().is_err());
    let two = vec![crate::observability::Measured::X, crate::observability::Measured::Y];
    assert_eq!(EstimatorConfig { measure: two, ..config }.validate().unwrap_err().key, "filter");
}

/// Ranges that are all too short look like an odometer that counts too much; the odometer is known to 0.6 % of the distance.
#[test]
fn a_distance_that_contradicts_the_stated_odometer_stops_the_robot() {
    for (share, is_stopped) in [(0.03, false), (-0.03, false), (0.05, true), (-0.05, true)] {
        let mut estimator = Estimator::new(&at_once()).unwrap();
        estimator.step(&odometry(1, 0.0, 0.0), None, PERIOD_NS);
        estimator.state.reckoning.unreported[1] = share;
        let scan = Scan { header: header(1), ..Scan::of(shared_types::ScanGeometry::URG_04LX) };
        estimator.see(&scan);
        let alarm = estimator.state.self_check.alarm;
        assert_eq!(alarm == Alarm::Stop.wire(), is_stopped, "{share}");
        assert_eq!(estimator.laser_events()[3], u64::from(is_stopped), "{share}");
    }
}
