//! Simulated drives: the figures of the source, accuracy, and consistency of the filter.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use vehicle::frame::to_track;
use vehicle::integrate::rk4;
use vehicle::{Parameters, State};

use super::*;
use crate::Measured;
use crate::config::SCALED_NOISE;

/// How the emulated robot of a test follows the desired values.
#[derive(Clone, Copy)]
struct Robot {
    steering_offset: f64,
    /// Odometry reckons with the steering angle desired, not with the true one.
    blind_to_offset: bool,
    odometry_longitudinal: f64,
    odometry_lateral_rate: f64,
    noise_m: f64,
    noise_rad: f64,
    /// The robot is moved by process noise of the profile `scaled`.
    matched: bool,
}

const PERFECT: Robot = Robot {
    steering_offset: 0.0,
    blind_to_offset: false,
    odometry_longitudinal: 0.0,
    odometry_lateral_rate: 0.0,
    noise_m: 0.0,
    noise_rad: 0.0,
    matched: false,
};

/// 2.5 % and 97.5 % quantiles of the chi-squared distribution with three degrees of freedom.
const NIS_BAND_95: [f64; 2] = [0.2158, 9.3484];

/// Errors of a run, in metres, over all samples.
#[derive(Debug, Clone, Copy, Default)]
struct Errors {
    raw_end: f64,
    end: f64,
    max: f64,
    /// Largest error after the first second, when the noise of the first report is averaged out.
    settled_max: f64,
    sum: f64,
    sum_of_squares: f64,
    yaw_max: f64,
    predicted_max: f64,
    nis_sum: f64,
    /// Samples whose NIS lies in the middle 95 % of the chi-squared distribution with three degrees of freedom.
    nis_in_band: f64,
    /// Largest error of what was measured, corrected but not filtered.
    unfiltered_max: f64,
    nees_sum: f64,
    count: f64,
}

impl Errors {
    /// Mean error [m].
    fn mean(&self) -> f64 {
        self.sum / self.count
    }
}

/// Standard normal numbers by Box and Muller.
pub(super) fn normal(generator: &mut Pcg64) -> f64 {
    let (radius, angle) = (1.0 - generator.random::<f64>(), generator.random::<f64>());
    (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
}

/// Drives a robot for `seconds` with the desired control at each scan and compares estimate and truth.
fn run(
    config: &EstimatorConfig,
    robot: Robot,
    seconds: u64,
    seed: u64,
    desired: impl Fn(f64) -> Control,
) -> Errors {
    let mut estimator = Estimator::new(config).unwrap();
    let mut generator = Pcg64::seed_from_u64(seed);
    let parameters = Parameters::default();
    let mut truth = State::default();
    let mut blind = State::default();
    let mut reported = nalgebra::Vector2::new(0.0, 0.0);
    let (mut lateral, mut errors) = (0.0, Errors::default());
    let mut realised: Option<Actuation> = None;
    // The robot drives from the start, so that the path of the source's figure is complete.
    let mut control = desired(0.0);
    for scan in 1..=10 * seconds + 1 {
        let noisy = |value: f64, deviation: f64, generator: &mut Pcg64| value + deviation * normal(generator);
        let odometry = Odometry {
            header: header(scan),
            x_m: noisy(reported.x, robot.noise_m, &mut generator),
            y_m: noisy(reported.y, robot.noise_m, &mut generator),
            yaw_rad: wrap_angle(noisy(
                if robot.blind_to_offset { blind.yaw } else { truth.yaw },
                robot.noise_rad,
                &mut generator,
            )),
            speed_mps: control.velocity,
            ..Odometry::default()
        };
        let published_ns = scan * PERIOD_NS + PERIOD_NS / 3;
        let at_scan = truth;
        let pose = estimator.step(&odometry, realised.as_ref(), published_ns).unwrap();

        let mut advance = |control: Control, duration: f64| {
            let steps = (duration / 1e-3).ceil();
            let step = duration / steps;
            for _ in 0..steps as usize {
                let actual = Control { steering: control.steering + robot.steering_offset, ..control };
                let next = rk4(&parameters, &truth, &actual, step);
                let next_blind = rk4(&parameters, &blind, &control, step);
                let (from, to) = if robot.blind_to_offset { (&blind, &next_blind) } else { (&truth, &next) };
                lateral += robot.odometry_lateral_rate * step;
                let missed =
                    to_track(from.yaw, robot.odometry_longitudinal, lateral) * (control.velocity * step);
                reported += nalgebra::Vector2::new(to.x - from.x, to.y - from.y) - missed;
                (truth, blind) = (next, next_blind);
            }
            truth
        };
        let at_publication = advance(control, 0.1 / 3.0);
        control = desired((scan - 1) as f64 * 0.1 + 0.1 / 3.0);
        advance(control, 0.2 / 3.0);
        realised = Some(actuation(scan, control));
        if robot.matched {
            let [yaw, ahead, left] = SCALED_NOISE.0.map(|variance| variance.sqrt() * normal(&mut generator));
            let pushed = to_track(truth.yaw, ahead, left);
            truth = State { yaw: truth.yaw + yaw, x: truth.x + pushed.x, y: truth.y + pushed.y, ..truth };
            reported += pushed;
        }

        let in_band = (NIS_BAND_95[0]..=NIS_BAND_95[1]).contains(&pose.nis);
        let unfiltered = estimator.state.correction.corrected();
        let unfiltered_error = (unfiltered.x - at_scan.x).hypot(unfiltered.y - at_scan.y);
        let difference =
            Vector3::new(wrap_angle(pose.yaw_rad - at_scan.yaw), pose.x_m - at_scan.x, pose.y_m - at_scan.y);
        let error = difference[1].hypot(difference[2]);
        let ahead = (pose.predicted_x_m - at_publication.x).hypot(pose.predicted_y_m - at_publication.y);
        let covariance = Matrix3::from_row_slice(&pose.covariance);
        errors = Errors {
            raw_end: (odometry.x_m - at_scan.x).hypot(odometry.y_m - at_scan.y),
            end: error,
            max: errors.max.max(error),
            settled_max: if scan > 10 { errors.settled_max.max(error) } else { 0.0 },
            sum: errors.sum + error,
            sum_of_squares: errors.sum_of_squares + error * error,
            yaw_max: errors.yaw_max.max(difference[0].abs()),
            predicted_max: errors.predicted_max.max(ahead),
            nis_sum: errors.nis_sum + pose.nis,
            nis_in_band: errors.nis_in_band + f64::from(u8::from(in_band)),
            unfiltered_max: errors.unfiltered_max.max(unfiltered_error),
            nees_sum: errors.nees_sum + difference.dot(&covariance.cholesky().unwrap().solve(&difference)),
            count: errors.count + 1.0,
        };
        let mut sample = pose;
        sample.header.layout = Pose::LAYOUT;
        assert_eq!(sample.check(), Ok(()));
    }
    errors
}

/// Steering as in the source's figure: amplitude 0.06 rad, period 5 s, at 1 m/s.
fn sine(time: f64) -> Control {
    Control { velocity: 1.0, steering: 0.06 * (std::f64::consts::TAU * time / 5.0).sin() }
}

#[test]
fn the_source_profile_brings_the_error_of_a_steering_offset_below_8_cm() {
    let robot =
        Robot { steering_offset: 0.0098, blind_to_offset: true, odometry_longitudinal: 0.01, ..PERFECT };
    let errors = run(&source(), robot, 5, 1, sine);
    assert!((errors.raw_end - 0.64).abs() < 0.03, "raw {}", errors.raw_end);
    assert!(errors.end <= 0.08, "corrected {}", errors.end);
}

#[test]
fn drift_as_modelled_with_noise_stays_below_10_cm_over_40_s() {
    let robot = Robot {
        odometry_longitudinal: 0.01,
        odometry_lateral_rate: 0.053,
        noise_m: 0.02,
        noise_rad: 0.01,
        ..PERFECT
    };
    let (mut better, mut worst) = (0, 0.0f64);
    for seed in 1..=50 {
        let errors = run(&source(), robot, 40, seed, sine);
        assert!(errors.mean() < 0.04, "seed {seed}: {}", errors.mean());
        assert!(errors.max < 0.10, "seed {seed}: {}", errors.max);
        better += u32::from(errors.max < errors.unfiltered_max);
        worst = worst.max(errors.max);
    }
    eprintln!("40 s with drift and noise, 50 seeds: worst {worst:.4} m, better than unfiltered in {better}");
    assert!(better >= 48, "better than the unfiltered correction in {better} of 50");
}

#[test]
fn on_matched_noise_the_nis_lies_in_its_95_percent_band_in_90_to_99_percent_of_steps() {
    // Noise of the measurement and of the process exactly as in R and Q.
    let robot =
        Robot { odometry_longitudinal: 0.01, noise_m: 0.02, noise_rad: 0.01, matched: true, ..PERFECT };
    let (mut lowest, mut highest) = (1.0f64, 0.0f64);
    for seed in 1..=50 {
        let errors = run(&at_once(), robot, 40, seed, sine);
        let share = errors.nis_in_band / errors.count;
        assert!((0.90..=0.99).contains(&share), "seed {seed}: {share}");
        (lowest, highest) = (lowest.min(share), highest.max(share));
    }
    eprintln!("NIS in its band: {:.1} to {:.1} % of steps over 50 seeds", 100.0 * lowest, 100.0 * highest);
}

#[test]
fn without_noise_the_scaled_profile_is_nearly_exact() {
    let robot = Robot { odometry_longitudinal: 0.01, ..PERFECT };
    let errors = run(&at_once(), robot, 20, 1, sine);
    // What remains: the yaw of the correction is the mean over 100 ms, 1 % of a few millimetres.
    assert!(errors.max < 1e-4 && errors.predicted_max < 1e-4, "{errors:?}");
    assert!(errors.yaw_max < 1e-6);
}

#[test]
fn the_scaled_profile_keeps_a_noisy_estimate_within_3_cm_and_1_cm_on_average_and_is_consistent() {
    let robot = Robot { odometry_longitudinal: 0.01, noise_m: 0.02, noise_rad: 0.01, ..PERFECT };
    let mut total = Errors::default();
    for seed in 1..=5 {
        let errors = run(&scaled(), robot, 40, seed, sine);
        assert!(errors.settled_max < 0.03, "seed {seed}: {errors:?}");
        total.sum_of_squares += errors.sum_of_squares;
        total.nis_sum += errors.nis_sum;
        total.nees_sum += errors.nees_sum;
        total.count += errors.count;
    }
    let rms = (total.sum_of_squares / total.count).sqrt();
    assert!(rms < 0.012, "{rms}");
    // The model is exact here, so process noise is assumed too large and both are below their mean of 3.
    assert!((2.0..3.3).contains(&(total.nis_sum / total.count)));
    assert!((0.5..3.3).contains(&(total.nees_sum / total.count)));
}

#[test]
fn the_turning_drift_follows_a_steering_offset_for_longer_than_the_printed_one() {
    let robot =
        Robot { steering_offset: 0.0098, blind_to_offset: true, odometry_longitudinal: 0.01, ..PERFECT };
    let turning = EstimatorConfig {
        correction: Some(CorrectionMode::Yaw),
        odometry_lateral_rate: Some(0.053),
        ..source()
    };
    let (printed, turned) = (run(&source(), robot, 20, 1, sine), run(&turning, robot, 20, 1, sine));
    assert!(turned.max < 0.2 && printed.max > 1.0, "{} {}", turned.max, printed.max);
}

#[test]
fn position_alone_determines_yaw_while_driving() {
    let config = EstimatorConfig { measure: vec![Measured::X, Measured::Y], ..at_once() };
    let robot = Robot { odometry_longitudinal: 0.01, noise_m: 0.02, noise_rad: 0.5, ..PERFECT };
    let errors = run(&config, robot, 40, 3, sine);
    assert!(errors.end < 0.06, "{errors:?}");
}

#[test]
fn yaw_alone_is_refused() {
    let config = EstimatorConfig { measure: vec![Measured::Yaw], ..at_once() };
    assert!(Estimator::new(&config).unwrap_err().to_string().contains("rank 1 of 3"));
}

#[test]
fn a_steering_offset_that_odometry_sees_costs_3_cm_in_the_scaled_profile() {
    // Play of 0.006 rad, used up on one side: 0.032 rad/s that the model does not know.
    let robot = Robot { steering_offset: 0.006, odometry_longitudinal: 0.01, ..PERFECT };
    let errors = run(&at_once(), robot, 20, 1, sine);
    assert!(errors.max < 0.03, "{errors:?}");
}
