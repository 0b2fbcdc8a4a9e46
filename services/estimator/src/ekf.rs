//! The extended Kalman filter, (7.20)-(7.26), for N states.
//!
//! The process x_k = f(x_(k-1), u_k, w_(k-1)) and the measurement z_k = h(x_k, v_k), (7.14)-(7.19), with zero-mean noise
//! of covariance Q and R, (7.3)-(7.8), are the caller's. The caller linearises its model and passes the Jacobians (7.20),
//! (7.21): A and W of the state by state and process noise, and H and V of the measurement by state and measurement
//! noise. With constant A and H, and W = V = 1, it is the linear filter (7.9)-(7.13).
//!
//! Numerics: the update is in Joseph's form and the gain comes from a Cholesky factor, so that the covariance stays
//! symmetric and positive definite as long as process noise keeps it away from zero. The caller computes the
//! difference of measurements, and wraps angles there.

use nalgebra::{SMatrix, SVector};

/// State and covariance of a filter for a process and a measurement with noise of zero mean and covariances Q and R,
/// (7.3)-(7.8).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ekf<const N: usize> {
    /// Estimated state.
    pub state: SVector<f64, N>,
    /// Its covariance P, symmetric positive definite.
    pub covariance: SMatrix<f64, N, N>,
}

/// A measurement compared with what was expected, before it changes the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<const N: usize, const M: usize> {
    /// Measured minus expected.
    pub value: SVector<f64, M>,
    /// Kalman gain K, (7.24).
    pub gain: SMatrix<f64, N, M>,
    /// Normalised innovation squared: chi-squared with M degrees of freedom when the noise is as assumed.
    pub nis: f64,
    by_state: SMatrix<f64, M, N>,
    noise: SMatrix<f64, M, M>,
}

/// The covariance of an innovation is not positive definite, so no gain exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the covariance of the innovation is not positive definite")]
pub struct NotPositive;

impl<const N: usize> Ekf<N> {
    /// Time update, (7.22) and (7.23): the state becomes `predicted` = f(state, control, 0), and
    /// P = A P A' + W Q W' with A = `by_state` and W = `by_noise`, Jacobians of (7.20)-(7.21), and Q = `noise`.
    /// With constant A and W = 1 it is (7.9) and (7.10).
    pub fn predict<const W: usize>(
        &mut self,
        predicted: SVector<f64, N>,
        by_state: &SMatrix<f64, N, N>,
        by_noise: &SMatrix<f64, N, W>,
        noise: &SMatrix<f64, W, W>,
    ) {
        self.state = predicted;
        self.covariance = symmetric(
            by_state * self.covariance * by_state.transpose() + by_noise * noise * by_noise.transpose(),
        );
    }

    /// Compares a measurement with the `expected` one, h(state, 0), and computes the gain,
    /// K = P H' (H P H' + V R V')^-1, (7.24), with H = `by_state` and V = `by_noise`, Jacobians of (7.20)-(7.21), and
    /// R = `noise`. With constant H and V = 1 it is (7.11).
    ///
    /// # Errors
    /// [`NotPositive`] when H P H' + V R V' has no Cholesky factor.
    pub fn compare<const M: usize, const V: usize>(
        &self,
        measured: &SVector<f64, M>,
        expected: &SVector<f64, M>,
        by_state: &SMatrix<f64, M, N>,
        by_noise: &SMatrix<f64, M, V>,
        noise: &SMatrix<f64, V, V>,
        difference: impl Fn(&SVector<f64, M>, &SVector<f64, M>) -> SVector<f64, M>,
    ) -> Result<Innovation<N, M>, NotPositive> {
        let value = difference(measured, expected);
        let noise = by_noise * noise * by_noise.transpose();
        let cross = by_state * self.covariance;
        let factor = symmetric(cross * by_state.transpose() + noise).cholesky().ok_or(NotPositive)?;
        let gain = factor.solve(&cross).transpose();
        let nis = value.dot(&factor.solve(&value));
        Ok(Innovation { value, gain, nis, by_state: *by_state, noise })
    }

    /// Measurement update, (7.25) and (7.26): state + K (z - h), and P = (1 - K H) P in Joseph's form.
    /// With constant H it is (7.12) and (7.13).
    pub fn update<const M: usize>(&mut self, innovation: &Innovation<N, M>) {
        let Innovation { value, gain, by_state, noise, .. } = innovation;
        self.state += gain * value;
        let rest = SMatrix::<f64, N, N>::identity() - gain * by_state;
        self.covariance =
            symmetric(rest * self.covariance * rest.transpose() + gain * noise * gain.transpose());
    }
}

/// The matrix without the asymmetry of rounding.
fn symmetric<const N: usize>(matrix: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, SMatrix, Vector1, Vector2, matrix, vector};
    use proptest::prelude::*;

    fn minus<const M: usize>(one: &SVector<f64, M>, other: &SVector<f64, M>) -> SVector<f64, M> {
        one - other
    }

    #[test]
    fn a_scalar_filter_weighs_by_the_variances() {
        let mut filter = Ekf { state: Vector1::new(2.0), covariance: Matrix1::new(3.0) };
        let one = Matrix1::new(1.0);
        let innovation =
            filter.compare(&Vector1::new(6.0), &filter.state, &one, &one, &Matrix1::new(1.0), minus).unwrap();
        filter.update(&innovation);
        // 3 / (3 + 1) of the way from 2 to 6; 3 * 1 / (3 + 1) remains; 4^2 / (3 + 1).
        assert!((filter.state[0] - 5.0).abs() < 1e-15);
        assert!((filter.covariance[0] - 0.75).abs() < 1e-15);
        assert!((innovation.nis - 4.0).abs() < 1e-15);
    }

    #[test]
    fn with_constant_matrices_it_is_the_linear_filter() {
        // Position and velocity with a measured position, after the textbook form (7.9)-(7.13).
        let a: Matrix2<f64> = matrix![1.0, 0.1; 0.0, 1.0];
        let h: SMatrix<f64, 1, 2> = matrix![1.0, 0.0];
        let (q, r) = (matrix![1e-3, 2e-4; 2e-4, 5e-3], Matrix1::new(0.04));
        let mut filter = Ekf { state: vector![0.0, 1.0], covariance: Matrix2::identity() };
        let (mut state, mut covariance): (Vector2<f64>, Matrix2<f64>) = (filter.state, filter.covariance);
        for step in 0..50 {
            let measured = Vector1::new(0.1 * f64::from(step) + 0.02 * f64::from(step % 3));
            filter.predict(a * filter.state, &a, &Matrix2::identity(), &q);
            let expected = h * filter.state;
            let innovation =
                filter.compare(&measured, &expected, &h, &Matrix1::identity(), &r, minus).unwrap();
            filter.update(&innovation);

            state = a * state; // (7.9)
            covariance = a * covariance * a.transpose() + q; // (7.10)
            let gain = covariance * h.transpose() / (h * covariance * h.transpose() + r)[0]; // (7.11)
            state += gain * (measured - h * state); // (7.12)
            covariance = (Matrix2::identity() - gain * h) * covariance; // (7.13)
            assert!((filter.state - state).amax() < 1e-12);
            assert!((filter.covariance - covariance).amax() < 1e-12);
        }
    }

    #[test]
    fn jacobians_of_the_noise_scale_the_noise() {
        let filter = Ekf { state: Vector1::new(0.0), covariance: Matrix1::new(1.0) };
        let mut predicted = filter;
        predicted.predict(
            Vector1::new(0.0),
            &Matrix1::new(2.0),
            &matrix![3.0, 1.0],
            &matrix![0.5, 0.0; 0.0, 0.25],
        );
        // 2 * 1 * 2 + 3 * 0.5 * 3 + 1 * 0.25 * 1.
        assert!((predicted.covariance[0] - 8.75).abs() < 1e-15);
        let innovation = filter
            .compare(
                &Vector1::new(1.0),
                &filter.state,
                &Matrix1::new(1.0),
                &Matrix1::new(2.0),
                &Matrix1::new(0.25),
                minus,
            )
            .unwrap();
        assert!((innovation.gain[0] - 0.5).abs() < 1e-15, "1 / (1 + 2 * 0.25 * 2)");
    }

    #[test]
    fn the_innovation_is_wrapped_by_the_caller() {
        let filter = Ekf { state: Vector1::new(3.1), covariance: Matrix1::new(1.0) };
        let one = Matrix1::new(1.0);
        let wrapped =
            |z: &Vector1<f64>, h: &Vector1<f64>| Vector1::new(vehicle::frame::wrap_angle(z[0] - h[0]));
        let innovation =
            filter.compare(&Vector1::new(-3.1), &filter.state, &one, &one, &one, wrapped).unwrap();
        assert!((innovation.value[0] - (std::f64::consts::TAU - 6.2)).abs() < 1e-12);
    }

    #[test]
    fn a_covariance_that_is_none_gives_no_gain() {
        let one = Matrix1::new(1.0);
        for bad in [-2.0, f64::NAN] {
            let filter = Ekf { state: Vector1::new(0.0), covariance: Matrix1::new(bad) };
            assert_eq!(
                filter.compare(&Vector1::new(1.0), &filter.state, &one, &one, &one, minus),
                Err(NotPositive)
            );
        }
    }

    proptest! {
        #[test]
        fn the_covariance_stays_symmetric_positive_definite(
            steps in proptest::collection::vec((-1.0..1.0f64, -1.0..1.0f64, 1e-6..1e2f64, 1e-6..1e2f64), 1..80),
        ) {
            let mut filter = Ekf { state: vector![0.0, 0.0, 0.0], covariance: SMatrix::<f64, 3, 3>::identity() };
            for (first, second, process, measurement) in steps {
                let a = matrix![1.0, 0.0, 0.0; first, 1.0, 0.0; second, 0.0, 1.0];
                filter.predict(a * filter.state, &a, &SMatrix::identity(), &(SMatrix::<f64, 3, 3>::identity() * process));
                let h = matrix![0.0, 1.0, 0.0; 0.0, 0.0, 1.0];
                let expected = h * filter.state;
                let innovation = filter
                    .compare(&vector![first, second], &expected, &h, &SMatrix::identity(),
                        &(Matrix2::identity() * measurement), minus)
                    .unwrap();
                filter.update(&innovation);
                prop_assert_eq!(filter.covariance, filter.covariance.transpose());
                prop_assert!(filter.covariance.symmetric_eigenvalues().min() > 0.0);
                prop_assert!(innovation.nis >= 0.0);
            }
        }
    }
}
