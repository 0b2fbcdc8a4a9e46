//! The covariance of the pose: what the filter knows, and the drift of the odometry that it cannot see.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use vehicle::frame::heading;

use super::figures::normal;
use super::*;

/// 95 % quantile of the chi-squared distribution with two degrees of freedom.
const ELLIPSE_95: f64 = 5.991;

/// Wheel encoders and a gyro with the errors of a description, on a robot that drives straight at 1 m/s.
struct Encoders {
    vehicle: Description,
    generator: Pcg64,
    yaw: f64,
    bias: f64,
    x: f64,
    y: f64,
}

impl Encoders {
    fn new(seed: u64) -> Self {
        let (vehicle, generator) = (Description::default(), Pcg64::seed_from_u64(seed));
        Self { vehicle, generator, yaw: 0.0, bias: 0.0, x: 0.0, y: 0.0 }
    }

    /// The report after another 100 ms.
    fn report(&mut self, scan: u64) -> Odometry {
        let Description { encoder_slip_m, gyro_noise_rad, gyro_bias_walk_radps, .. } = self.vehicle;
        let mut noise = || normal(&mut self.generator);
        let root_s = 0.1_f64.sqrt();
        let (before, distance_m) = (self.yaw, 0.1 * 0.99 + encoder_slip_m * root_s * noise());
        self.yaw += 0.1 * self.bias + gyro_noise_rad * root_s * noise();
        self.bias += gyro_bias_walk_radps * root_s * noise();
        let forward = heading(f64::midpoint(before, self.yaw)) * distance_m;
        (self.x, self.y) = (self.x + forward.x, self.y + forward.y);
        Odometry { y_m: self.y, yaw_rad: self.yaw, ..odometry(scan, self.x, distance_m / 0.1) }
    }
}

/// Squared distance of (x, y) from the truth in standard deviations.
fn distance_squared(covariance: &[f64; 9], dx: f64, dy: f64) -> f64 {
    let [.., xx, xy, _, _, yy] = *covariance;
    (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
}

/// Share of the scans of `seconds` whose 95 % ellipse contains the true place, over 100 robots.
fn coverage(config: &EstimatorConfig, seconds: u64) -> f64 {
    let (mut inside, mut count) = (0_u32, 0_u32);
    for seed in 1..=100 {
        let (mut estimator, _) = straight(config, 0);
        let mut encoders = Encoders::new(seed);
        let first = Odometry { speed_mps: 1.0, ..odometry(1, 0.0, 1.0) };
        estimator.step(&first, None, at(1)).unwrap();
        for scan in 2..=10 * seconds {
            let pose = estimator.step(&encoders.report(scan), None, at(scan)).unwrap();
            let dx = pose.x_m - 0.1 * (scan - 1) as f64;
            inside += u32::from(distance_squared(&pose.covariance, dx, pose.y_m) <= ELLIPSE_95);
            count += 1;
        }
    }
    f64::from(inside) / f64::from(count)
}

#[test]
fn the_covariance_contains_the_drift_of_the_way_and_the_local_one_does_not() {
    let (estimator, pose) = straight(&scaled(), 201);
    let Pose { covariance, local_covariance, .. } = pose.unwrap();
    // 20 m at 1 m/s: slip of 5 mm per root of a metre, and the gyro's noise and bias integrated over 20 s.
    let (slip, noise, bias) = (25e-6 * 20.0, 4e-8 * 8000.0 / 3.0, 4e-10 * 3.2e6 / 20.0);
    let drift = |index: usize| covariance[index] - local_covariance[index];
    assert!((drift(4) / slip - 1.0).abs() < 0.01, "{}", drift(4));
    assert!((drift(8) / (noise + bias) - 1.0).abs() < 0.02, "{}", drift(8));
    // Innovations of nothing but the scale error are far below the noise expected.
    let local = MIN_MISFIT * estimator.state().covariance[4];
    assert!((local_covariance[4] - local).abs() < 1e-12 && estimator.state().misfit < MIN_MISFIT);
}

#[test]
fn innovations_larger_than_expected_inflate_the_local_covariance() {
    let mut estimator = Estimator::new(&ideal()).unwrap();
    let mut generator = Pcg64::seed_from_u64(3);
    for scan in 1..=300 {
        // 40 mm of noise, where R expects 20 mm.
        let sample = odometry(scan, 0.04 * normal(&mut generator), 0.0);
        let sample = Odometry { y_m: 0.04 * normal(&mut generator), ..sample };
        estimator.step(&sample, None, at(scan));
    }
    // The yaw is exact, and the other two of three states have a NIS of 4 / 1.2 each: 2.2 in the mean.
    let misfit = estimator.state().misfit;
    assert!((1.5..3.0).contains(&misfit), "{misfit}");
}

#[test]
fn the_ellipses_contain_the_truth_in_95_percent_of_scans() {
    // These robots have no other errors than those of the description.
    let known = EstimatorConfig {
        profile: NoiseProfile::Increments,
        gyro_bias_radps: 0.0,
        odometry_scale: 0.0,
        ..EstimatorConfig::default()
    };
    for (config, seconds) in [(&scaled(), 20), (&scaled(), 40), (&known, 20), (&known, 40)] {
        let share = coverage(config, seconds);
        // Errors within a drive are alike, so 100 drives give the share to 2 %. Before 20 s the covariance of the filter
        // outweighs the drift, and the ellipses are wider than they need to be on a straight line.
        assert!((0.92..=0.99).contains(&share), "{seconds} s: {share}");
    }
    let without = coverage(&EstimatorConfig { drift_scale: 0.0, ..scaled() }, 30);
    assert!(without < 0.5, "the filter alone knows nothing of the drift: {without}");
}

#[test]
fn the_printed_profile_has_the_covariance_of_the_filter() {
    let (estimator, pose) = straight(&source(), 100);
    let pose = pose.unwrap();
    assert_eq!(pose.covariance, estimator.state().covariance);
    // In units in which the measured yaw, 1 rad^2, has the noise of the scaled profile, 1e-4 rad^2.
    assert!((pose.local_covariance[0] / pose.covariance[0] - 1e-4).abs() < 1e-16);
    // x: 4e-4 m^2 in place of 1, y: 4e-4 in place of 10.
    assert!((pose.local_covariance[4] / pose.covariance[4] - 4e-4).abs() < 1e-15);
    assert!((pose.local_covariance[8] / pose.covariance[8] - 4e-5).abs() < 1e-16);
}
