//! The deceleration of blocked wheels, from several stops at different speeds.
//!
//! A stop from speed v covers v d + v^2 / (2 a): d is what the delay of the command differs by from its mean, the same in
//! all stops. Stops at two speeds tell both parts apart. They are fitted by least squares; the delay is known beforehand
//! with its own error, so that one stop alone, or equal speeds, also give a value.
//!
//! Limits: at 0.3 m/s and 5 m/s^2 the distance is 9 mm, near the resolution of an odometer. The standard error shows it.

use super::halt::Halt;

/// Standard error of a distance before the stops show it: encoder steps [m].
const DISTANCE_M: f64 = 1e-3;
/// Smallest standard error of a distance that the scatter of few stops may show [m].
const MIN_DISTANCE_M: f64 = 3e-4;
/// Standard error of the delay of the command, as `[vehicle]` describes it [s].
const DELAY_S: f64 = 0.005;
/// From so many stops on, their scatter shows the error of a distance.
const MIN_SCATTERED: usize = 4;
/// The range of `vehicle.blocked_deceleration_mps2`.
const RANGE_MPS2: [f64; 2] = [0.1, 50.0];

/// What stops have shown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Deceleration {
    /// The most probable value [m/s^2].
    pub(in super::super) estimate_mps2: f64,
    /// The value that is one standard error smaller, rounded down to a tenth: to be entered in `[vehicle]` [m/s^2].
    pub(in super::super) entered_mps2: f64,
}

impl Deceleration {
    /// The same, as far as tyres can decelerate; to be entered is the tenth below.
    pub(super) fn at_most(self, limit_mps2: f64) -> Self {
        Self {
            estimate_mps2: self.estimate_mps2.min(limit_mps2),
            entered_mps2: self.entered_mps2.min((10.0 * limit_mps2).floor() / 10.0),
        }
    }
}

/// The deceleration by all stops; there must be one.
pub(super) fn fit(halts: &[Halt]) -> Deceleration {
    let first = Fit::new(halts, DISTANCE_M);
    let squares: f64 = halts.iter().map(|halt| first.residual_m(halt).powi(2)).sum();
    let fit = match halts.len() {
        count if count >= MIN_SCATTERED => {
            Fit::new(halts, (squares / (count - 2) as f64).sqrt().max(MIN_DISTANCE_M))
        }
        _ => first,
    };
    let [low, high] = RANGE_MPS2;
    // A distance too short to be seen is the largest value.
    let of = |inverse: f64| if inverse > 0.0 { (0.5 / inverse).clamp(low, high) } else { high };
    let entered_mps2 = (10.0 * of(fit.inverse + fit.inverse_error)).floor() / 10.0;
    Deceleration { estimate_mps2: of(fit.inverse), entered_mps2: entered_mps2.max(low) }
}

/// A fit of 1 / (2 a) and of the difference of the delay.
#[derive(Debug, Clone, Copy)]
struct Fit {
    /// 1 / (2 a) [s^2/m].
    inverse: f64,
    /// Its standard error.
    inverse_error: f64,
    delay_s: f64,
}

impl Fit {
    fn new(halts: &[Halt], distance_error_m: f64) -> Self {
        let weight = distance_error_m.powi(-2);
        let sum = |of: &dyn Fn(&Halt) -> f64| weight * halts.iter().map(of).sum::<f64>();
        let power = |exponent: i32| sum(&|halt| halt.speed_mps.powi(exponent));
        let product = |exponent: i32| sum(&|halt| halt.speed_mps.powi(exponent) * halt.distance_m);
        let (fourth, third, second) = (power(4), power(3), power(2) + DELAY_S.powi(-2));
        let determinant = fourth * second - third * third;
        Self {
            inverse: (second * product(2) - third * product(1)) / determinant,
            inverse_error: (second / determinant).sqrt(),
            delay_s: (fourth * product(1) - third * product(2)) / determinant,
        }
    }

    fn residual_m(&self, halt: &Halt) -> f64 {
        let Halt { speed_mps, distance_m } = *halt;
        distance_m - speed_mps * self.delay_s - speed_mps * speed_mps * self.inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stops at these speeds with 5 m/s^2, a delay that is `delay_s` longer, and errors of the distances.
    fn stops(speeds: &[f64], delay_s: f64, errors_m: &[f64]) -> Vec<Halt> {
        let halt = |(speed, error): (&f64, &f64)| Halt {
            speed_mps: *speed,
            distance_m: speed * speed / 10.0 + speed * delay_s + error,
        };
        speeds.iter().zip(errors_m.iter().chain(std::iter::repeat(&0.0))).map(halt).collect()
    }

    const SPEEDS: [f64; 4] = [0.6, 0.3, 0.6, 0.3];

    #[test]
    fn exact_stops_give_the_value_within_few_percent() {
        let found = fit(&stops(&SPEEDS, 0.0, &[]));
        assert!((found.estimate_mps2 - 5.0).abs() < 1e-9 && found.entered_mps2 >= 4.7, "{found:?}");
    }

    #[test]
    fn a_delay_that_is_longer_in_all_stops_does_not_count() {
        let found = fit(&stops(&SPEEDS, 0.004, &[]));
        assert!((found.estimate_mps2 - 5.0).abs() < 0.25, "{found:?}");
        // One speed alone can't tell the delay apart: 2.4 mm of 38.4 mm.
        let same = fit(&stops(&[0.6; 4], 0.004, &[]));
        assert!(same.estimate_mps2 < 4.8 && same.entered_mps2 < found.entered_mps2, "{same:?}");
    }

    #[test]
    fn stops_that_scatter_give_a_smaller_value_to_enter() {
        let scattered = fit(&stops(&SPEEDS, 0.0, &[0.002, -0.002, -0.002, 0.002]));
        let exact = fit(&stops(&SPEEDS, 0.0, &[]));
        assert!(scattered.entered_mps2 < exact.entered_mps2 - 0.2, "{scattered:?}");
        assert!((scattered.estimate_mps2 - 5.0).abs() < 0.3, "{scattered:?}");
    }

    #[test]
    fn one_stop_and_a_distance_that_is_not_seen_give_values_in_the_range() {
        let one = fit(&stops(&[0.6], 0.0, &[]));
        assert!((4.0..5.0).contains(&one.entered_mps2), "{one:?}");
        let none = fit(&[Halt { speed_mps: 0.3, distance_m: -0.001 }]);
        assert_eq!(none.estimate_mps2, 50.0);
        assert!(none.entered_mps2 > 0.1, "{none:?}");
    }
}
