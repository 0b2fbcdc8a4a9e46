//! The lateral motion (7.27), (7.29) in closed form, exact for every stiffness.
//!
//! At constant speed, steering angle and cosine of the sideslip, z = (sideslip, yaw rate) follows z' = A z + b. With
//! r = A z(0) + b, z(t) is z(0) + F r, where F is the integral of exp(A t), and the yaw turns by the second component of
//! z(0) t + G r, where G is the integral of F.
//!
//! A function of A is the sum of its values at the two eigenvalues, each times a projector. The eigenvalues differ by up
//! to 20 orders of magnitude over the allowed vehicles. So the slow one is the determinant over the fast one, the
//! determinant is taken from the parameters, and the smaller entry of a projector from the product of the others: nothing
//! cancels. Where both are nearly equal, they are moved apart by 1e-7 of their size.

use nalgebra::Complex;

use crate::state::SPIN_RADPS;
use crate::{Control, Parameters, State, differential};

/// Share of the eigenvalues by which two equal ones are moved apart: half of the digits remain in their difference.
const APART: f64 = 1e-7;

/// Largest exponent of a motion that grows: its result is beyond any robot, and still finite.
const MAX_EXPONENT: f64 = 300.0;

/// RK4 stays for damped motions up to this decay in a step. There its step leaves 0.33 of a deviation where 0.14 is exact,
/// and it is stable up to 2.78. The shipped vehicle has at most 1.4.
const MAX_DECAY: f64 = 2.0;

/// RK4 stays for motions that swing or grow by at most this exponent in a step: its error is 3e-6 of them.
const MAX_SWING: f64 = 0.2;

/// The lateral motion under one control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lateral {
    matrix: [[f64; 2]; 2],
    constant: [f64; 2],
    determinant: f64,
}

impl Lateral {
    /// The motion with this cosine of the sideslip; `stiffness` of the front and rear axle [N/rad], positive.
    pub fn new(parameters: &Parameters, stiffness: [f64; 2], control: &Control, cosine: f64) -> Self {
        let Parameters { mass_kg, rear_m, front_m, inertia_kgm2, .. } = *parameters;
        let Control { velocity, steering } = *control;
        let Some(shares) = parameters.model.shares() else {
            let rate = 1.0 / parameters.yaw_lag_s;
            let (_, command) = differential::steady_turn(parameters, control);
            return Self {
                matrix: [[-rate, 0.0], [0.0, -rate]],
                constant: [0.0, rate * command],
                determinant: rate * rate,
            };
        };
        let [front, rear] =
            [0, 1].map(|axle| stiffness[axle].copysign(velocity) * (shares[axle] * steering).cos());
        let mobility = 1.0 / (mass_kg * velocity * cosine);
        let couple = rear * rear_m - front * front_m;
        let damping = rear * rear_m * rear_m + front * front_m * front_m;
        let sum = rear_m + front_m;
        Self {
            matrix: [
                [-(front + rear) * mobility, couple * mobility / velocity - 1.0],
                [couple / inertia_kgm2, -damping / (velocity * inertia_kgm2)],
            ],
            constant: [
                steering * (front * shares[0] + rear * shares[1]) * mobility,
                steering * (front * front_m * shares[0] - rear * rear_m * shares[1]) / inertia_kgm2,
            ],
            determinant: (front * rear * sum * sum * mobility / velocity + couple) / inertia_kgm2,
        }
    }

    /// The mean of the eigenvalues, half the difference of the diagonal, and the square of half their own difference.
    fn spectrum(&self) -> (f64, f64, f64) {
        let [[first, right], [left, last]] = self.matrix;
        let half = (first - last) / 2.0;
        (f64::midpoint(first, last), half, half * half + left * right)
    }

    /// Whether a step of RK4 of so many seconds is outside of the region in which it is stable and exact enough.
    pub fn is_stiff(&self, seconds: f64) -> bool {
        let (mean, _, square) = self.spectrum();
        let root = square.abs().sqrt();
        let (decay, swing) = if square > 0.0 { (root - mean, root + mean) } else { (-mean, root) };
        let is_mild = decay * seconds <= MAX_DECAY && swing * seconds <= MAX_SWING;
        !is_mild
    }

    /// Sideslip and yaw rate that stay as they are, and the matrix A.
    pub fn equilibrium(&self) -> ([f64; 2], [[f64; 2]; 2]) {
        let Self { matrix: [[first, right], [left, last]], constant, determinant } = *self;
        let still = [
            (right * constant[1] - last * constant[0]) / determinant,
            (left * constant[0] - first * constant[1]) / determinant,
        ];
        (still, self.matrix)
    }

    /// Whether deviations decay: a robot with the longer axle distance in front turns round by itself above some velocity.
    pub fn is_stable(&self) -> bool {
        self.determinant > 0.0
    }

    /// Largest size of the two eigenvalues, and the smallest [1/s].
    pub fn rates(&self) -> [f64; 2] {
        let (mean, _, square) = self.spectrum();
        let root = square.abs().sqrt();
        let fast = if square > 0.0 { root - mean } else { mean.hypot(root) };
        [fast, (self.determinant / fast).abs()]
    }

    /// The motion over so many seconds.
    pub fn over(&self, seconds: f64) -> LateralStep {
        let (mean, half, square) = self.spectrum();
        let [[_, right], [left, _]] = self.matrix;
        let is_double = square.abs().sqrt() <= APART * mean.abs();
        let root = if is_double { Complex::from(APART * mean.abs()) } else { Complex::from(square).sqrt() };
        let product = if is_double { root * root - half * half } else { Complex::from(left * right) };
        let fast = Complex::from(mean) - root;
        let slow = Complex::from(self.determinant) / fast;
        let large = root + half.abs();
        let (large, small) = (large / (root * 2.0), product / (large * root * 2.0));
        let (first, last) = if half >= 0.0 { (large, small) } else { (small, large) };
        // A function of the matrix from its values at the two eigenvalues.
        let function = |of: fn(Complex<f64>) -> Complex<f64>, scale: f64| {
            let [slow, fast] = [slow, fast].map(|value| {
                of(Complex::new((value.re * seconds).min(MAX_EXPONENT), value.im * seconds)) * scale
            });
            let skew = ((slow - fast) / (root * 2.0)).re;
            let [first, last] = [slow * first + fast * last, slow * last + fast * first].map(|sum| sum.re);
            [[first, skew * right], [skew * left, last]]
        };
        LateralStep {
            lateral: *self,
            seconds,
            once: function(first_integral, seconds),
            twice: function(second_integral, seconds * seconds)[1],
        }
    }
}

/// The lateral motion over a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LateralStep {
    lateral: Lateral,
    seconds: f64,
    /// Integral of exp(A t).
    once: [[f64; 2]; 2],
    /// Second row of the integral of `once`.
    twice: [f64; 2],
}

impl LateralStep {
    /// The state at the end, at the same place.
    pub fn moved(&self, state: &State) -> State {
        let Self { lateral: Lateral { matrix, constant, .. }, seconds, once, twice } = self;
        let State { sideslip, yaw, yaw_rate, .. } = *state;
        let [first, last] =
            [0, 1].map(|row| matrix[row][0] * sideslip + matrix[row][1] * yaw_rate + constant[row]);
        let turned = yaw_rate * seconds + twice[0] * first + twice[1] * last;
        State {
            sideslip: sideslip + once[0][0] * first + once[0][1] * last,
            yaw_rate: yaw_rate + once[1][0] * first + once[1][1] * last,
            yaw: yaw + turned.clamp(-SPIN_RADPS, SPIN_RADPS),
            ..*state
        }
        .bounded()
    }
}

/// (exp(z) - 1) / z.
fn first_integral(z: Complex<f64>) -> Complex<f64> {
    if z.norm_sqr() < SERIES { series(z, 1.0) } else { (z.exp() - 1.0) / z }
}

/// (exp(z) - 1 - z) / z^2.
fn second_integral(z: Complex<f64>) -> Complex<f64> {
    if z.norm_sqr() < SERIES { series(z, 2.0) } else { (z.exp() - 1.0 - z) / (z * z) }
}

/// Square of the size up to which the series are used: above it their closed forms lose one digit.
const SERIES: f64 = 0.25;

/// The sum of z^k `order`! / (k + `order`)! over `order`!, to the last digit for sizes up to a half.
fn series(z: Complex<f64>, order: f64) -> Complex<f64> {
    let sum = (1..=13).rev().fold(Complex::from(1.0), |sum, k| sum * z / (f64::from(k) + order) + 1.0);
    sum / order
}
