//! How fast the robot may be to stop in time.
//!
//! A stop begins when the obstacle is measured, which is up to one scan period after it appeared, and acts when the data
//! have their full age. Until then the robot moves on at its speed, and then it slides with blocked wheels. The largest
//! speed v for a distance d solves v (T + age) + v^2 / (2 a) = d, where v is a little more than desired and a less than
//! described.
//!
//! In open surroundings a blind scanner can't be told from an empty track, so the robot is careful there at all times.

use vehicle::{Description, Surroundings};

use crate::config::ControllerConfig;

/// Distance that is left in front of what the robot stops for [m].
pub(crate) const STOP_MARGIN_M: f64 = 0.05;

/// What a stop takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stopping {
    /// Time from the appearance of an obstacle until the wheels are blocked, at most [s].
    pub(crate) reaction_s: f64,
    /// Deceleration while the wheels are blocked, at least [m/s^2].
    pub(crate) deceleration_mps2: f64,
    /// True speed per desired speed, at most.
    pub(crate) speed_ratio: f64,
}

impl Stopping {
    /// A stop with data of age `age_s` when they act, and scans every `period_s`.
    pub(crate) fn new(config: &ControllerConfig, period_s: f64, age_s: f64) -> Self {
        Self {
            reaction_s: period_s + age_s,
            deceleration_mps2: config.vehicle.blocked_deceleration_mps2
                * (1.0 - config.stop.deceleration_error),
            speed_ratio: 1.0 + config.stop.speed_error,
        }
    }

    /// Distance until the robot rests [m].
    pub(crate) fn distance(&self, speed: f64) -> f64 {
        speed * self.speed_ratio * self.reaction_s + self.slide(speed)
    }

    /// Distance that blocked wheels slide [m].
    pub(crate) fn slide(&self, speed: f64) -> f64 {
        (speed * self.speed_ratio).powi(2) / (2.0 * self.deceleration_mps2)
    }

    /// Largest speed at which the robot can stop for something that appears unseen [m/s]; in open surroundings at most
    /// the careful one.
    pub(crate) fn limit(&self, vehicle: &Description) -> f64 {
        let limit = self.speed(vehicle.sudden_m - STOP_MARGIN_M);
        match vehicle.surroundings {
            Surroundings::Hall => limit,
            Surroundings::Open => limit.min(vehicle.careful_mps),
        }
    }

    /// Largest speed from which the robot rests within `distance` [m/s]; zero for none.
    pub(crate) fn speed(&self, distance: f64) -> f64 {
        if distance <= 0.0 {
            return 0.0;
        }
        let delayed = self.reaction_s * self.deceleration_mps2;
        ((delayed * delayed + 2.0 * self.deceleration_mps2 * distance).sqrt() - delayed) / self.speed_ratio
    }
}

/// Largest speed at which the robot can stop for something that appears unseen at `config.vehicle.sudden_m`, with scans
/// every `config.period_s` whose commands act as soon as they can [m/s].
pub fn speed_limit(config: &ControllerConfig) -> f64 {
    let after_front_s = config.vehicle.scanner.after_front_share() * config.period_s;
    let age_s = after_front_s + config.vehicle.command_delay_s;
    Stopping::new(config, config.period_s, age_s).limit(&config.vehicle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_for_a_distance_needs_just_that_distance() {
        let stopping = Stopping { reaction_s: 0.25, deceleration_mps2: 5.0, speed_ratio: 1.0 };
        // 1 m/s: 0.25 m until the wheels are blocked and 0.1 m until they rest.
        assert!((stopping.distance(1.0) - 0.35).abs() < 1e-12);
        assert!((stopping.speed(0.35) - 1.0).abs() < 1e-12);
        // It may be a quarter faster: 1.25 m/s for 0.25 s, and 1.25^2 / 10 m.
        let faster = Stopping { speed_ratio: 1.25, ..stopping };
        assert!((faster.distance(1.0) - (0.3125 + 0.15625)).abs() < 1e-12);
        assert!((faster.speed(0.46875) - 1.0).abs() < 1e-12);
        assert_eq!(stopping.speed(0.0), 0.0);
        assert_eq!(stopping.speed(-1.0), 0.0);
    }

    #[test]
    fn the_limit_contains_braking_period_age_delay_and_sudden_distance() {
        let vehicle = Description::default();
        let of = |vehicle, period_s| {
            speed_limit(&ControllerConfig { vehicle, period_s, ..ControllerConfig::default() })
        };
        let limit = of(vehicle, 0.1);
        // v (0.1 + 0.0333 + 0.02) + v^2 / (2 * 0.8 * 5) = 1.15, with a true speed v 5 % above the limit.
        let fast = 1.05 * limit;
        assert!((fast * (0.4 / 3.0 + 0.02) + fast * fast / 8.0 - 1.15).abs() < 1e-12);
        let slower = |changed: Description, period_s| of(changed, period_s) < limit;
        assert!(slower(Description { blocked_deceleration_mps2: 4.0, ..vehicle }, 0.1));
        assert!(slower(Description { command_delay_s: 0.03, ..vehicle }, 0.1));
        assert!(slower(Description { sudden_m: 1.1, ..vehicle }, 0.1));
        assert!(slower(vehicle, 0.11));
    }

    #[test]
    fn in_open_surroundings_the_limit_is_the_careful_speed_unless_the_way_to_stop_is_too_short() {
        let of = |vehicle| speed_limit(&ControllerConfig { vehicle, ..ControllerConfig::default() });
        let open = Description { surroundings: Surroundings::Open, ..Description::default() };
        assert_eq!(of(open), 0.3);
        assert_eq!(of(Description { careful_mps: 0.7, ..open }), 0.7);
        let near = Description { sudden_m: 0.1, ..open };
        assert!(of(near) < 0.3 && of(near) == of(Description { surroundings: Surroundings::Hall, ..near }));
    }
}
