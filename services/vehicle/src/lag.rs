//! A first-order lag with a limited rate, in closed form.
//!
//! The value follows value' = clamp((target - value) / T, -fall, rise). Far from the target the rate is constant; once
//! the difference is below the rate times T, it decays exponentially.

/// How a value follows its target.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lag {
    /// Time constant T; 0 for a value that follows at once, whatever the rates [s].
    pub time_constant_s: f64,
    /// Largest rate upwards [1/s].
    pub rise_per_s: f64,
    /// Largest rate downwards [1/s].
    pub fall_per_s: f64,
}

impl Lag {
    /// Whether the value follows at once.
    pub fn is_none(&self) -> bool {
        self.time_constant_s <= 0.0
    }

    /// The value some seconds later.
    #[must_use]
    pub fn after(&self, value: f64, target: f64, seconds: f64) -> f64 {
        if self.is_none() {
            return target;
        }
        let difference = target - value;
        let rate = if difference > 0.0 { self.rise_per_s } else { self.fall_per_s };
        let limited_s = (difference.abs() / rate - self.time_constant_s).max(0.0);
        if seconds <= limited_s {
            return value + (rate * seconds).copysign(difference);
        }
        let rest = difference - (rate * limited_s).copysign(difference);
        target - rest * (-(seconds - limited_s) / self.time_constant_s).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_step_decays_with_the_time_constant() {
        let lag = Lag { time_constant_s: 0.15, rise_per_s: 2.0, fall_per_s: 3.0 };
        // 0.2 m/s up: 0.2 / 0.15 = 1.33 m/s^2 is below the limit.
        let expected = 0.7 - 0.2 * (-0.1_f64 / 0.15).exp();
        assert!((lag.after(0.5, 0.7, 0.1) - expected).abs() < 1e-15);
        assert_eq!(lag.after(0.5, 0.5, 0.1), 0.5);
    }

    #[test]
    fn a_large_step_is_limited_first() {
        let lag = Lag { time_constant_s: 0.15, rise_per_s: 2.0, fall_per_s: 3.0 };
        // 2 m/s^2 for 0.35 s, until 0.3 m/s are left; then exponentially.
        assert!((lag.after(0.0, 1.0, 0.25) - 0.5).abs() < 1e-15);
        assert!((lag.after(0.0, 1.0, 0.35) - 0.7).abs() < 1e-15);
        assert!((lag.after(0.0, 1.0, 0.5) - (1.0 - 0.3 * (-1.0_f64).exp())).abs() < 1e-12);
        // 3 m/s^2 downwards.
        assert!((lag.after(1.0, 0.0, 0.1) - 0.7).abs() < 1e-15);
    }

    #[test]
    fn two_steps_are_one() {
        let lag = Lag { time_constant_s: 0.1, rise_per_s: 0.5, fall_per_s: 0.5 };
        let once = lag.after(-0.06, 0.06, 0.3);
        let twice = lag.after(lag.after(-0.06, 0.06, 0.11), 0.06, 0.19);
        assert!((once - twice).abs() < 1e-15);
    }

    #[test]
    fn without_a_time_constant_the_value_is_the_target() {
        assert_eq!(Lag::default().after(0.0, 1.0, 0.0), 1.0);
    }
}
