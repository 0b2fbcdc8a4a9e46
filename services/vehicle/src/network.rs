//! A network with one hidden layer of six neurons that maps a desired steering angle to the angle to send.
//!
//! The linkage makes the steering angle a nonlinear function of the angle sent. Steady circle runs give pairs of
//! realised and sent angles. A network of one input, six hyperbolic tangents and one output is fitted to them, with
//! the realised angle as input. For a desired angle it returns the angle to send.
//!
//! Assumptions: the relation is smooth and monotone, and samples cover the angles asked for later; outside of
//! them the network saturates, it does not extrapolate. Hysteresis (backlash) is not a function of the angle and
//! stays in the remainder.

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// Neurons in the hidden layer.
pub const NEURONS: usize = 6;

/// Smallest number of samples for 19 weights: two thirds of them train, one third validates.
pub const MIN_SAMPLES: usize = 30;

/// All weights of a network, as one vector: hidden weights, hidden biases, output weights, output bias.
const WEIGHTS: usize = 3 * NEURONS + 1;

/// A 1-6-1 network with hyperbolic tangents; input and output are scaled inside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SteeringNetwork {
    /// Desired angle that stands for 1 at the input [rad].
    pub input_scale_rad: f64,
    /// Sent angle that stands for 1 at the output [rad].
    pub output_scale_rad: f64,
    /// Weight of the input in each neuron.
    pub hidden_weights: [f64; NEURONS],
    /// Bias of each neuron.
    pub hidden_biases: [f64; NEURONS],
    /// Weight of each neuron in the output.
    pub output_weights: [f64; NEURONS],
    /// Bias of the output.
    pub output_bias: f64,
}

impl SteeringNetwork {
    /// The angle to send for a desired angle [rad].
    pub fn eval(&self, desired_rad: f64) -> f64 {
        let input = desired_rad / self.input_scale_rad;
        let sum: f64 =
            (0..NEURONS).map(|neuron| self.output_weights[neuron] * self.activation(neuron, input)).sum();
        self.output_scale_rad * (self.output_bias + sum)
    }

    /// Derivative of [`Self::eval`] with respect to the desired angle.
    pub fn derivative(&self, desired_rad: f64) -> f64 {
        let input = desired_rad / self.input_scale_rad;
        let slope: f64 = (0..NEURONS)
            .map(|neuron| {
                let activation = self.activation(neuron, input);
                self.output_weights[neuron] * self.hidden_weights[neuron] * (1.0 - activation * activation)
            })
            .sum();
        self.output_scale_rad / self.input_scale_rad * slope
    }

    /// Whether the scales are above zero and no weight is so large that sums of them overflow.
    pub fn is_usable(&self) -> bool {
        let scales = [self.input_scale_rad, self.output_scale_rad];
        scales.iter().all(|scale| *scale >= 1e-6 && *scale <= 10.0)
            && self.weights().iter().all(|weight| weight.abs() <= 1e6)
    }

    fn activation(&self, neuron: usize, input: f64) -> f64 {
        (self.hidden_weights[neuron] * input + self.hidden_biases[neuron]).tanh()
    }

    fn weights(&self) -> SVector<f64, WEIGHTS> {
        let mut weights = SVector::zeros();
        for neuron in 0..NEURONS {
            weights[neuron] = self.hidden_weights[neuron];
            weights[NEURONS + neuron] = self.hidden_biases[neuron];
            weights[2 * NEURONS + neuron] = self.output_weights[neuron];
        }
        weights[WEIGHTS - 1] = self.output_bias;
        weights
    }

    fn with_weights(&self, weights: &SVector<f64, WEIGHTS>) -> Self {
        let part = |index: usize| std::array::from_fn(|neuron| weights[index * NEURONS + neuron]);
        Self {
            hidden_weights: part(0),
            hidden_biases: part(1),
            output_weights: part(2),
            output_bias: weights[WEIGHTS - 1],
            ..*self
        }
    }

    /// Derivative of the scaled output with respect to all weights at a scaled input.
    fn gradient(&self, input: f64) -> SVector<f64, WEIGHTS> {
        let mut gradient = SVector::zeros();
        for neuron in 0..NEURONS {
            let activation = self.activation(neuron, input);
            let inner = self.output_weights[neuron] * (1.0 - activation * activation);
            gradient[neuron] = inner * input;
            gradient[NEURONS + neuron] = inner;
            gradient[2 * NEURONS + neuron] = activation;
        }
        gradient[WEIGHTS - 1] = 1.0;
        gradient
    }
}

/// A fitted network and how well it maps the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainedNetwork {
    /// The network.
    pub network: SteeringNetwork,
    /// Largest error over the samples it was fitted to [rad].
    pub max_error: f64,
    /// Largest error over the third of the samples kept back [rad].
    pub held_out_error: f64,
    /// Accepted steps of the fit.
    pub steps: usize,
}

/// Why no network can be fitted.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// There are too few samples for the weights.
    #[error("{found} samples are too few to fit the steering network: at least {MIN_SAMPLES} are needed")]
    TooFew {
        /// Samples given.
        found: usize,
    },
    /// A sample is not a number.
    #[error("steering sample {index} is not finite")]
    NotFinite {
        /// Its place among the samples.
        index: usize,
    },
    /// All inputs or all outputs are zero, or inputs do not differ.
    #[error("the steering samples do not span a range of angles")]
    NoRange,
}

/// The network fitted to samples of (realised angle, sent angle) [rad] by Levenberg and Marquardt's method.
///
/// Every third sample (in order of the input) is kept back to judge the fit. The start is fixed (neurons spread
/// over the range of inputs), so the same samples always give the same network.
///
/// # Errors
/// [`TrainError`] when the samples are too few, not finite, or span no range.
pub fn train(samples: &[(f64, f64)]) -> Result<TrainedNetwork, TrainError> {
    if samples.len() < MIN_SAMPLES {
        return Err(TrainError::TooFew { found: samples.len() });
    }
    if let Some(index) = samples.iter().position(|(input, output)| !(input.is_finite() && output.is_finite()))
    {
        return Err(TrainError::NotFinite { index });
    }
    let largest =
        |value: fn(&(f64, f64)) -> f64| samples.iter().map(|sample| value(sample).abs()).fold(0.0, f64::max);
    let (input_scale_rad, output_scale_rad) = (largest(|sample| sample.0), largest(|sample| sample.1));
    let first = samples[0].0;
    let spread = samples.iter().map(|sample| (sample.0 - first).abs()).fold(0.0, f64::max);
    if !(spread > 1e-6 && input_scale_rad > 1e-6 && output_scale_rad > 1e-6) {
        return Err(TrainError::NoRange);
    }

    let mut sorted = samples.to_vec();
    sorted.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.total_cmp(&other.1)));
    let held = |index: &usize| index % 3 == 1;
    let training: Vec<_> =
        sorted.iter().enumerate().filter(|(index, _)| !held(index)).map(|(_, s)| *s).collect();
    let judging: Vec<_> =
        sorted.iter().enumerate().filter(|(index, _)| held(index)).map(|(_, s)| *s).collect();

    let (network, steps) = fit(start(input_scale_rad, output_scale_rad), &training);
    Ok(TrainedNetwork {
        network,
        max_error: largest_error(&network, &training),
        held_out_error: largest_error(&network, &judging),
        steps,
    })
}

/// Most trial steps of the fit; each costs one 19 x 19 Cholesky factorisation.
const MAX_TRIALS: usize = 2000;

/// Weight of the squared weights against the squared errors, per sample: keeps the six neurons from growing without
/// bound against each other where the samples do not tell them apart. Costs about 1e-6 of the range in accuracy.
const DECAY: f64 = 1e-10;

fn start(input_scale_rad: f64, output_scale_rad: f64) -> SteeringNetwork {
    let centre = |neuron: usize| (2.0 * neuron as f64 + 1.0) / NEURONS as f64 - 1.0;
    SteeringNetwork {
        input_scale_rad,
        output_scale_rad,
        hidden_weights: [1.0; NEURONS],
        hidden_biases: std::array::from_fn(|neuron| -centre(neuron)),
        output_weights: [1.0 / NEURONS as f64; NEURONS],
        output_bias: 0.0,
    }
}

fn fit(start: SteeringNetwork, samples: &[(f64, f64)]) -> (SteeringNetwork, usize) {
    let decay = DECAY * samples.len() as f64;
    let mut network = start;
    let mut cost = objective(&network, samples, decay);
    let (mut damping, mut steps) = (1e-2, 0);
    let mut normal = normal_equations(&network, samples, decay);
    for _ in 0..MAX_TRIALS {
        let (hessian, gradient) = normal;
        let mut damped = hessian;
        for index in 0..WEIGHTS {
            damped[(index, index)] += damping * (hessian[(index, index)] + 1e-9);
        }
        let trial = damped
            .cholesky()
            .map(|factor| network.with_weights(&(network.weights() - factor.solve(&gradient))));
        let trial_cost = trial.map_or(f64::INFINITY, |trial| objective(&trial, samples, decay));
        match trial {
            Some(better) if trial_cost < cost => {
                let settled = cost - trial_cost < 1e-12 * cost;
                (network, cost, steps) = (better, trial_cost, steps + 1);
                if settled {
                    break;
                }
                damping = (damping * 0.3).max(1e-15);
                normal = normal_equations(&network, samples, decay);
            }
            _ if damping > 1e12 => break,
            _ => damping *= 4.0,
        }
    }
    (network, steps)
}

fn objective(network: &SteeringNetwork, samples: &[(f64, f64)], decay: f64) -> f64 {
    samples.iter().map(|sample| residual(network, sample).powi(2)).sum::<f64>()
        + decay * network.weights().norm_squared()
}

fn residual(network: &SteeringNetwork, (input, output): &(f64, f64)) -> f64 {
    (network.eval(*input) - output) / network.output_scale_rad
}

fn normal_equations(
    network: &SteeringNetwork,
    samples: &[(f64, f64)],
    decay: f64,
) -> (SMatrix<f64, WEIGHTS, WEIGHTS>, SVector<f64, WEIGHTS>) {
    let mut hessian = SMatrix::identity() * decay;
    let mut gradient = network.weights() * decay;
    for sample in samples {
        let row = network.gradient(sample.0 / network.input_scale_rad);
        hessian += row * row.transpose();
        gradient += row * residual(network, sample);
    }
    (hessian, gradient)
}

fn largest_error(network: &SteeringNetwork, samples: &[(f64, f64)]) -> f64 {
    samples.iter().map(|(input, output)| (network.eval(*input) - output).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correction::SHIPPED_NETWORK;

    /// The steering map of the emulated robot: realised angle for a sent angle.
    fn realised(sent: f64) -> f64 {
        let share = (sent / 0.12).clamp(-1.0, 1.0);
        sent * (1.2 - 0.3 * share * share + 0.05 * share)
    }

    /// Sent angles from -0.065 to 0.065 rad, which realise a little more than the desired range.
    fn circle_runs(count: usize) -> Vec<(f64, f64)> {
        (0..count)
            .map(|index| -0.065 + 0.13 * index as f64 / (count - 1) as f64)
            .map(|sent| (realised(sent), sent))
            .collect()
    }

    fn worst_inversion(network: &SteeringNetwork) -> f64 {
        (0..=1200)
            .map(|index| -0.06 + 1e-4 * f64::from(index))
            .map(|desired| (realised(network.eval(desired)) - desired).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn the_shipped_network_inverts_the_map_of_the_emulated_robot() {
        let worst = worst_inversion(&SHIPPED_NETWORK);
        assert!(worst < 1e-4, "{worst:e}");
    }

    #[test]
    fn the_shipped_network_is_monotone_over_all_sent_angles() {
        for index in -60..=60 {
            let slope = SHIPPED_NETWORK.derivative(1e-3 * f64::from(index));
            assert!(slope > 0.5 && slope < 1.5, "{index} mrad: {slope}");
        }
    }

    #[test]
    fn training_reproduces_the_accuracy_of_the_shipped_network() {
        let trained = train(&circle_runs(91)).unwrap();
        assert!(trained.max_error < 1e-5 && trained.held_out_error < 1e-5, "{trained:?}");
        assert!(worst_inversion(&trained.network) < 1e-5, "{trained:?}");
        assert_eq!(train(&circle_runs(91)), Ok(trained), "the fit is not deterministic");
    }

    #[test]
    fn noise_of_the_samples_is_not_learnt() {
        // A fixed pattern of +-1 mrad; a network that went through every sample would be off by as much.
        let noisy: Vec<_> = circle_runs(91)
            .iter()
            .enumerate()
            .map(|(index, (input, output))| (*input, output + 1e-3 * ((index * index) as f64 * 1.7).sin()))
            .collect();
        let trained = train(&noisy).unwrap();
        assert!(worst_inversion(&trained.network) < 1e-3, "{}", worst_inversion(&trained.network));
    }

    #[test]
    fn the_derivative_is_that_of_central_differences() {
        for desired in [-0.06, -0.013, 0.0, 0.02, 0.06] {
            let step = 1e-6;
            let difference =
                (SHIPPED_NETWORK.eval(desired + step) - SHIPPED_NETWORK.eval(desired - step)) / (2.0 * step);
            // Values of 0.06 carry 1e-17 of rounding; divided by the step that is 1e-11.
            assert!((SHIPPED_NETWORK.derivative(desired) - difference).abs() < 1e-8);
        }
    }

    #[test]
    fn samples_that_cannot_be_fitted_are_refused() {
        assert_eq!(train(&[(0.0, 0.0); 5]), Err(TrainError::TooFew { found: 5 }));
        assert_eq!(train(&[(0.01, 0.01); 40]), Err(TrainError::NoRange));
        let mut samples = circle_runs(40);
        samples[7].1 = f64::NAN;
        assert_eq!(train(&samples), Err(TrainError::NotFinite { index: 7 }));
    }
}
