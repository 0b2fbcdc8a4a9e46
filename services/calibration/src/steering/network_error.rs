//! Standard error of the output of a fitted network.
//!
//! First order in the weights: the covariance of the weights, projected on the gradient of the output at an angle. It
//! is the covariance of least squares with the weight decay of the training.

use nalgebra::{SMatrix, SVector};
use vehicle::network::{NEURONS, SteeringNetwork};

use crate::Estimate;

const WEIGHTS: usize = 3 * NEURONS + 1;

/// Weight decay of the training, per sample: it bounds the weights that no run determines.
const RIDGE: f64 = 1e-10;

/// The covariance of a network's weights.
pub(super) struct NetworkError {
    network: SteeringNetwork,
    covariance: SMatrix<f64, WEIGHTS, WEIGHTS>,
    freedom: usize,
    /// [`super::small_angle`] of the vehicle.
    small_angle: f64,
}

impl NetworkError {
    /// The error of a network that [`vehicle::network::train`] fitted to the samples.
    ///
    /// Every third sample (in order of the input) was held out there, so it determines no weights.
    pub(super) fn of(network: &SteeringNetwork, samples: &[(f64, f64)], small_angle: f64) -> Option<Self> {
        let mut sorted = samples.to_vec();
        sorted.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.total_cmp(&other.1)));
        let training: Vec<(f64, f64)> = sorted
            .into_iter()
            .enumerate()
            .filter(|(index, _)| index % 3 != 1)
            .map(|(_, sample)| sample)
            .collect();
        let rows: Vec<_> = training.iter().map(|sample| gradient(network, sample.0)).collect();
        let information = rows
            .iter()
            .fold(SMatrix::zeros(), |sum: SMatrix<f64, WEIGHTS, WEIGHTS>, row| sum + row * row.transpose());
        let scale = network.output_scale_rad * network.output_scale_rad;
        let ridge = SMatrix::identity() * (RIDGE * training.len() as f64 * scale);
        let inverse = (information + ridge).cholesky()?.inverse();
        let used = (inverse * information).trace().ceil() as usize;
        let freedom = training.len().checked_sub(used).filter(|freedom| *freedom > 0)?;
        let squares: f64 = training.iter().map(|(sent, angle)| (angle - network.eval(*sent)).powi(2)).sum();
        let covariance = inverse * information * inverse * (squares / freedom as f64);
        Some(Self { network: *network, covariance, freedom, small_angle })
    }

    /// The realised angle at a sent angle.
    pub(super) fn at(&self, sent: f64) -> Estimate {
        let row = gradient(&self.network, sent);
        let variance = (row.transpose() * self.covariance * row)[0].max(0.0);
        let angle = self.network.eval(sent);
        let geometry = self.small_angle * angle.abs().powi(3) / 3.0;
        Estimate::new(angle, variance.sqrt().hypot(geometry), self.freedom)
    }
}

/// Derivative of the network's output with respect to all weights [rad].
fn gradient(network: &SteeringNetwork, angle: f64) -> SVector<f64, WEIGHTS> {
    let input = angle / network.input_scale_rad;
    let mut gradient = SVector::zeros();
    for neuron in 0..NEURONS {
        let activation = (network.hidden_weights[neuron] * input + network.hidden_biases[neuron]).tanh();
        let inner = network.output_weights[neuron] * (1.0 - activation * activation);
        gradient[neuron] = inner * input;
        gradient[NEURONS + neuron] = inner;
        gradient[2 * NEURONS + neuron] = activation;
    }
    gradient[WEIGHTS - 1] = 1.0;
    gradient * network.output_scale_rad
}
