//! A first-order lag with a limited rate, in closed form.
//!
//! The value follows value' = clamp((target - value) / T, -fall, rise). Far from the target the rate is constant; once
//! the difference is below the rate times T, it decays exponentially. A value that changes its sign falls to zero first and
//! rises from there.

/// How a value follows its target.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lag {
    /// Time constant T; 0 for a value that follows at once, whatever the rates [s].
    pub time_constant_s: f64,
    /// Largest rate away from zero [1/s].
    pub rise_per_s: f64,
    /// Largest rate towards zero [1/s].
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
        let crosses = value * target < 0.0;
        if crosses && self.rise_per_s != self.fall_per_s {
            let zero_s = self.until_zero(value, target);
            if seconds > zero_s {
                return self.limited(0.0, target, self.rise_per_s, seconds - zero_s);
            }
        }
        let rises = !crosses && target.abs() > value.abs();
        self.limited(value, target, if rises { self.rise_per_s } else { self.fall_per_s }, seconds)
    }

    /// When a value is zero on its way to a target beyond [s].
    fn until_zero(&self, value: f64, target: f64) -> f64 {
        let (rate, way) = (self.fall_per_s, (target - value).abs());
        let limited_s = (way / rate - self.time_constant_s).max(0.0);
        if value.abs() <= rate * limited_s {
            return value.abs() / rate;
        }
        limited_s + self.time_constant_s * ((way - rate * limited_s) / target.abs()).ln()
    }

    /// The value some seconds later with this largest rate.
    fn limited(&self, value: f64, target: f64, rate: f64, seconds: f64) -> f64 {
        let difference = target - value;
        let limited_s = (difference.abs() / rate - self.time_constant_s).max(0.0);
        if seconds <= limited_s {
            return value + (rate * seconds).copysign(difference);
        }
        let rest = difference - (rate * limited_s).copysign(difference);
        target - rest * (-(seconds - limited_s) / self.time_constant_s).exp()
    }
}

/// The speed of wheels that have slid, blocked, for some seconds with a constant deceleration [m/s^2]: to rest at most, from
/// either direction [m/s].
pub fn slid(speed: f64, deceleration_mps2: f64, seconds: f64) -> f64 {
    let left = (speed.abs() - deceleration_mps2 * seconds).max(0.0);
    if speed < 0.0 { 0.0 - left } else { left }
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
    fn a_value_below_zero_follows_as_its_opposite_does() {
        let lag = Lag { time_constant_s: 0.15, rise_per_s: 2.0, fall_per_s: 3.0 };
        for (value, target, seconds) in [(0.0, 1.0, 0.25), (1.0, 0.0, 0.1), (0.5, 0.7, 0.1), (0.7, 0.2, 0.4)]
        {
            assert_eq!(lag.after(-value, -target, seconds), -lag.after(value, target, seconds));
        }
    }

    #[test]
    fn a_value_falls_to_zero_before_it_rises_on_the_other_side() {
        let lag = Lag { time_constant_s: 0.15, rise_per_s: 2.0, fall_per_s: 3.0 };
        // 3 m/s^2 down to zero for 0.2 s, then 2 m/s^2 for 0.25 s, until 0.3 m/s are left.
        assert!((lag.after(0.6, -0.8, 0.2)).abs() < 1e-12);
        assert!((lag.after(0.6, -0.8, 0.3) + 0.2).abs() < 1e-12);
        assert!((lag.after(0.6, -0.8, 0.45) + 0.5).abs() < 1e-12);
        // 0.3 m/s in all are below 3 m/s^2 times 0.15 s: the target is twice as near at zero after 0.15 s ln 2.
        let zero_s = 0.15 * 2.0_f64.ln();
        assert!(lag.after(0.15, -0.15, zero_s).abs() < 1e-12);
        assert!(
            (lag.after(0.15, -0.15, zero_s + 0.1) + 0.15 * (1.0 - (-0.1_f64 / 0.15).exp())).abs() < 1e-12
        );
    }

    #[test]
    fn without_a_time_constant_the_value_is_the_target() {
        assert_eq!(Lag::default().after(0.0, 1.0, 0.0), 1.0);
    }
}
