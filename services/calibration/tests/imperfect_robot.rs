//! What the calibration of `--drive` makes of scenario `imperfect-robot`.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use calibration::file::{DriftPart, Origin, SteeringPart, VelocityPart};
use calibration::{CalibrationFile, drift, drive, steering, velocity};
use emulator::noise::{NoiseStream, Purpose};
use emulator::{Outcome, Scenario};
use pipeline::PipelineSettings;
use vehicle::Description;
use vehicle::correction::Calibration;

fn imperfect() -> Scenario {
    Scenario::parse(Scenario::shipped("imperfect-robot").unwrap(), "imperfect-robot").unwrap()
}

fn calibrated(scenario: &Scenario) -> CalibrationFile {
    let (origin, vehicle) = (Origin::default(), Description::default());
    let straight = velocity::fit(&drive::straight_runs(scenario, &vehicle, 1)).unwrap();
    let circles = steering::fit(&drive::circle_runs(scenario, &vehicle, 1), &vehicle).unwrap();
    let sines = drift::fit(&drive::sine_runs(scenario, &vehicle, 1), &vehicle).unwrap();
    CalibrationFile {
        velocity: Some(VelocityPart::of(&straight, origin.clone())),
        steering: Some(SteeringPart::of(&circles, origin.clone())),
        drift: Some(DriftPart::of(&sines, origin)),
        ..CalibrationFile::default()
    }
}

/// How a drive ended, and the root mean squares of what velocity [m/s] and steering angle [rad] were off.
fn tracking(settings: &PipelineSettings) -> (Outcome, f64, f64) {
    let (mut desired, mut squares, mut count) = (None, [0.0, 0.0], 0.0);
    let drive = pipeline::drive(settings, |step| {
        // The actuation of a scan is in force when the next scan is taken.
        if let Some((velocity, angle)) = desired.take()
            && step.truth.blocked == 0
        {
            let [by_velocity, by_angle]: [f64; 2] =
                [step.truth.speed_mps - velocity, step.truth.steering_rad - angle];
            squares = [squares[0] + by_velocity * by_velocity, squares[1] + by_angle * by_angle];
            count += 1.0;
        }
        desired = step
            .actuation
            .filter(|actuation| actuation.kind == shared_types::ActuationKind::Drive.wire())
            .map(|actuation| (actuation.desired_velocity_mps, actuation.desired_steering_rad));
    })
    .unwrap();
    (drive.outcome, f64::sqrt(squares[0] / count), f64::sqrt(squares[1] / count))
}

/// Without any calibration and with that of `--drive`.
fn compare(scenario: Scenario) -> [(Outcome, f64, f64); 2] {
    let robot = scenario.robot;
    let file = calibrated(&scenario);
    let mut without = PipelineSettings::of(scenario);
    without.tuning.actuator.calibration = Calibration::Identity;
    let mut with = without.clone();
    without.tuning.estimator.correction = Some(estimator::correction::CorrectionMode::Off);
    // It would end these drives before there is much to compare.
    without.tuning.estimator.self_check = false;
    with.tuning.actuator.calibration =
        Calibration::Custom(file.correction(&Calibration::Identity.correction()));
    with.tuning.estimator.odometry_longitudinal = file.drift.as_ref().map(|part| part.longitudinal.value);
    with.tuning.estimator.odometry_lateral_rate =
        file.drift.as_ref().map(|part| part.lateral_rate_per_s.value);
    let results = [tracking(&without), tracking(&with)];
    for (name, (outcome, velocity, angle)) in ["without", "with"].iter().zip(&results) {
        eprintln!("{robot:?} {name}: {outcome}, velocity {velocity:.5} m/s, steering {angle:.5} rad");
    }
    results
}

#[test]
fn the_imperfect_robot_reaches_its_goal_and_tracks_velocity_and_steering_five_times_better() {
    // With the play of the scenario, with none, and with 30 % more.
    for play in [0.006, 0.0, 0.0078] {
        let mut scenario = imperfect();
        scenario.robot.steering_backlash_rad = Some(play);
        let [without, with] = compare(scenario);
        assert_eq!(with.0, Outcome::Reached);
        assert!(5.0 * with.1 < without.1 && 5.0 * with.2 < without.2, "{play:?}: {with:?} {without:?}");
    }
}

#[test]
fn hidden_robots_miss_the_goal_without_calibration_and_reach_it_with_their_own() {
    // Within 30 % of the scenario's robot; the drift of the odometer is the source's.
    let mut random = NoiseStream::new(20, Purpose::Course, 0);
    let mut off = |value: f64| value * random.between(0.7, 1.3);
    for _ in 0..10 {
        let mut scenario = imperfect();
        scenario.robot.velocity_factor = Some(off(1.4));
        scenario.robot.steering_backlash_rad = Some(off(0.006));
        scenario.robot.odometry_longitudinal = Some(off(0.012));
        scenario.robot.odometry_lateral_rate = Some(off(0.053));
        let [without, with] = compare(scenario);
        assert!(without.0 != Outcome::Reached, "{without:?}");
        assert_eq!(with.0, Outcome::Reached);
        assert!(5.0 * with.1 < without.1 && 5.0 * with.2 < without.2, "{with:?} {without:?}");
    }
}
