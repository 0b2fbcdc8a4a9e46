//! Poses that no robot can have are not published, whatever the table `[vehicle]` describes.

use shared_types::Suspect;

use super::*;

/// Drives for some seconds under a steering angle that changes, with an odometer that knows nothing of the vehicle.
fn drive(vehicle: Description, velocity: f64, steering: f64) -> (Estimator, Vec<Pose>) {
    let config = EstimatorConfig { vehicle, ..EstimatorConfig::default() };
    let mut estimator = Estimator::new(&config).unwrap();
    let mut poses = Vec::new();
    for scan in 1..=30 {
        let sign = if scan % 8 < 4 { 1.0 } else { -1.0 };
        let control = Control { velocity, steering: sign * steering };
        let sample = odometry(scan, 0.1 * velocity * scan as f64, velocity);
        poses.extend(estimator.step(&sample, Some(&actuation(scan - 1, control)), at(scan)));
    }
    (estimator, poses)
}

fn vehicle(numbers: [f64; 5]) -> Description {
    let [mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2] = numbers;
    Description { mass_kg, rear_m, front_m, stiffness_n_per_rad, inertia_kgm2, ..Description::default() }
}

#[test]
fn a_vehicle_that_turns_round_by_itself_ends_in_the_alarm_that_stops_the_robot() {
    // Heavy and short, with most of it in front: from 0.009 m/s on its yaw rate grows by exp(120 t).
    let (estimator, poses) = drive(vehicle([1e6, 0.001, 0.003, 1e4, 0.001]), 0.8, 0.05);
    assert_eq!(poses.len(), 30);
    assert!(poses.iter().all(is_possible));
    let first = poses.iter().position(|pose| pose.alarm == Alarm::Stop.wire()).expect("the alarm to stop");
    assert!(poses[first..].iter().all(|pose| pose.alarm == Alarm::Stop.wire()));
    assert!(poses[first..].iter().all(|pose| pose.suspect == Suspect::Vehicle.wire()));
    assert!(poses[first].rejected > 0 && estimator.state().invalid > 0);
    assert_eq!(poses[first].predicted_x_m, poses[first].x_m, "where it is measured, without a prediction");
}

#[test]
fn the_stiffest_tyres_are_followed_without_an_alarm() {
    let (estimator, poses) = drive(vehicle([14.695, 0.1924, 0.1776, 1e6, 0.5024]), 0.8, 0.0);
    assert!(poses.iter().all(|pose| pose.alarm == 0 && pose.sideslip_rad.abs() < 1e-3));
    assert_eq!((poses.len(), estimator.state().invalid), (30, 0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_pose_is_possible_or_not_published(
        exponents in prop::array::uniform5(-3.0..=6.0f64), velocity in 0.02..=2.0f64, steering in -0.12..=0.12f64, lags in any::<bool>(),
    ) {
        let described = vehicle(exponents.map(|exponent| 10f64.powf(exponent).clamp(1e-3, 1e6)));
        let (estimator, poses) = drive(if lags { described } else { described.without_lag() }, velocity, steering);
        prop_assert_eq!(poses.len(), 30);
        prop_assert!(poses.iter().all(is_possible));
        prop_assert!(estimator.state().check().is_ok());
    }
}
