//! An emulated inertial sensor: it reads the true yaw and publishes the mean yaw rate between two scans.
//!
//! Its gyro is a good small one: white noise of 2e-4 rad/sqrt(s), and a bias that walks by 2e-5 rad/s per sqrt(s). The
//! argument is the seed of the noise.

mod imu;

use std::process::ExitCode;

use imu::Imu;
use runtime::{Companion, RuntimeError};
use shared_types::Truth;

/// White noise of the gyro: standard deviation of the integrated yaw after one second [rad].
const NOISE_RAD: f64 = 2e-4;
/// Random walk of its bias: standard deviation after one second [rad/s].
const BIAS_WALK_RADPS: f64 = 2e-5;

fn main() -> ExitCode {
    runtime::start_logging();
    let seed = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(1);
    match run(seed) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(seed: u64) -> Result<(), RuntimeError> {
    let mut companion = Companion::attach()?;
    let truths = companion.input::<Truth>()?;
    let imu = companion.open::<Imu>("imu")?;
    if !companion.start()? {
        return Ok(());
    }
    let mut gyro = Gyro { noise: Noise(seed), bias_radps: 0.0, last: None };
    while companion.wait(None)? {
        while let Some(truth) = truths.take()? {
            let (yaw_rate_radps, dt_s) = gyro.measure(&truth);
            imu.publish(&mut Imu { header: truth.header.answer(), yaw_rate_radps, dt_s, ..Imu::default() })?;
        }
    }
    Ok(())
}

/// A gyro with noise and a bias.
struct Gyro {
    noise: Noise,
    bias_radps: f64,
    /// Time [s] and yaw [rad] of the sample before.
    last: Option<(f64, f64)>,
}

impl Gyro {
    /// The mean yaw rate since the sample before [rad/s], and the time since then [s].
    fn measure(&mut self, truth: &Truth) -> (f64, f64) {
        let Some((time_s, yaw_rad)) = self.last.replace((truth.time_s, truth.yaw_rad)) else {
            return (0.0, 0.0);
        };
        let dt_s = truth.time_s - time_s;
        if dt_s <= 0.0 {
            return (0.0, 0.0);
        }
        self.bias_radps += BIAS_WALK_RADPS * dt_s.sqrt() * self.noise.normal();
        let turned_rad = wrapped(truth.yaw_rad - yaw_rad);
        (turned_rad / dt_s + self.bias_radps + NOISE_RAD / dt_s.sqrt() * self.noise.normal(), dt_s)
    }
}

/// An angle in [-pi, pi).
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

/// Random numbers of the generator SplitMix64.
struct Noise(u64);

impl Noise {
    /// A number in (0, 1].
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^= bits >> 31;
        ((bits >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    /// A number of the standard normal distribution (Box-Muller).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}
