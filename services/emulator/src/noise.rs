//! Random numbers that depend on the seed, the purpose and the scan only.
//!
//! Each purpose has a stream of its own, and each scan starts it afresh. So a longer laser sweep never changes
//! the odometry, and an additional scan never changes the next one.

use rand::Rng;
use rand_pcg::Pcg64;

/// What random numbers are drawn for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Noise of the reported pose.
    Odometry = 1,
    /// Noise of the laser ranges.
    Laser = 2,
    /// Obstacles that the seed places along the track.
    Placement = 3,
    /// Random courses.
    Course = 4,
    /// Values of a worn robot, one stream for each key.
    Wear = 5,
    /// Time and loss of a command on its way.
    Command = 6,
    /// Errors of encoders and gyro.
    Encoders = 7,
    /// Errors of time stamps.
    Stamp = 8,
    /// Scans that are missing.
    Missing = 9,
    /// Error codes of beams without a return.
    Code = 10,
    /// Beams that a fault of the scanner loses.
    Dropout = 11,
    /// Random ranges within the whole reach.
    Salt = 12,
    /// Random ranges near the scanner.
    Dust = 13,
    /// Delays of irregular scans.
    Period = 14,
}

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct NoiseStream {
    generator: Pcg64,
    /// Box-Muller makes two numbers at once; this is the second.
    spare: Option<f64>,
}

impl NoiseStream {
    /// The stream of `purpose` for one scan (or any other running number) of a run.
    pub fn new(seed: u64, purpose: Purpose, number: u64) -> Self {
        let state = (u128::from(mix(seed)) << 64) | u128::from(mix(number ^ mix(seed)));
        Self { generator: Pcg64::new(state, purpose as u128), spare: None }
    }

    /// A number in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        // 53 random bits fill the mantissa exactly.
        (self.generator.next_u64() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// A number in [`low`, `high`).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Whether an event of this probability happens.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// A whole number from `low` to `high`, both included.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        low + ((high - low + 1) as f64 * self.uniform()) as usize
    }

    /// A number from the exponential distribution with mean 1.
    pub fn exponential(&mut self) -> f64 {
        -(1.0 - self.uniform()).ln()
    }

    /// A number from the normal distribution with mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // 1 - uniform is in (0, 1], so the logarithm is finite.
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.uniform()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

/// Spreads neighbouring numbers over all bits (the finaliser of SplitMix64).
fn mix(number: u64) -> u64 {
    let mut mixed = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_two_purposes_or_two_scans_differ_and_equal_ones_agree() {
        let first = |purpose, number| NoiseStream::new(1, purpose, number).uniform();
        assert_eq!(first(Purpose::Laser, 7), first(Purpose::Laser, 7));
        assert_ne!(first(Purpose::Laser, 7), first(Purpose::Odometry, 7));
        assert_ne!(first(Purpose::Laser, 7), first(Purpose::Laser, 8));
    }

    #[test]
    fn normal_numbers_have_mean_zero_and_deviation_one_across_scans() {
        let count = 20_000;
        let samples: Vec<f64> =
            (0..count).map(|scan| NoiseStream::new(3, Purpose::Odometry, scan).normal()).collect();
        let mean = samples.iter().sum::<f64>() / count as f64;
        let variance = samples.iter().map(|sample| (sample - mean).powi(2)).sum::<f64>() / count as f64;
        // Four standard errors: 1 / sqrt(20000) = 0.0071 for the mean, sqrt(2 / 20000) = 0.01 for the variance.
        assert!(mean.abs() < 0.028, "{mean}");
        assert!((variance - 1.0).abs() < 0.04, "{variance}");
    }
}
