//! Whether the robot can be driven at a scan rate: it can stop in time, and it is driven as planned.

use emulator::Scenario;
use nmpc::{ControllerConfig, speed_limit};
use vehicle::{Description, Invalid, Surroundings};

/// Rates that a system file may have [Hz].
const RATES_HZ: [f64; 2] = [0.5, 1000.0];
/// The smallest allowed rate is found to this share.
const PRECISION: f64 = 1e-4;
/// A command is later by so many means of its jitter, once in 150.
const JITTERS: f64 = 5.0;
/// Share by which a period may exceed an interval by rounding.
const ROUNDING: f64 = 1e-6;

/// Passes when a safe speed is left at this rate, and a command is not held for longer than its interval of the plan.
///
/// # Errors
/// [`Invalid`] with the rate, the smallest allowed one, and the other keys that decide it.
pub(crate) fn require_rate(controller: &ControllerConfig, rate_hz: f64) -> Result<(), Invalid> {
    require_safe_speed(controller, rate_hz)?;
    let interval_s = controller.interval_s();
    if rate_hz * interval_s >= 1.0 - ROUNDING {
        return Ok(());
    }
    // A plan changes its control with each interval; the robot gets a new one with each scan.
    let allowed = format!(
        "at least {}, so that no command is held for longer than its interval of the plan, {:.3} s, which is \
         controller.horizon_s = {} by controller.intervals = {}",
        (1e3 / interval_s).ceil() / 1e3,
        interval_s,
        controller.horizon_s,
        controller.intervals
    );
    Err(Invalid::new("rate_hz", rate_hz, allowed))
}

/// Passes when no more commands are on their way to the wheels, one for each scan, than a robot may have; `jitter_s` is the mean
/// of a time that is added at random.
///
/// # Errors
/// [`Invalid`] with the key of this table, its value and the largest one.
pub(crate) fn require_few_on_the_way(
    table: &str,
    delay_s: f64,
    jitter_s: f64,
    rate_hz: f64,
) -> Result<(), Invalid> {
    let most = vehicle::MAX_ON_THE_WAY;
    let largest_s = most as f64 / rate_hz;
    let left_s = (largest_s - delay_s) / JITTERS;
    let refused = if left_s < 0.0 {
        let allowed = format!("at most {largest_s}, the time of {most} scans at rate_hz = {rate_hz}");
        Invalid::new("command_delay_s", delay_s, allowed)
    } else if jitter_s > left_s {
        let allowed = format!(
            "at most {}, so that {JITTERS} of it and command_delay_s = {delay_s} are the time of {most} scans at rate_hz = {rate_hz}",
            (left_s * 1e6).floor() / 1e6
        );
        Invalid::new("command_jitter_s", jitter_s, allowed)
    } else {
        return Ok(());
    };
    Err(refused.within(table))
}

/// The same of the emulated robot of a scenario, which has its values.
///
/// # Errors
/// As [`require_few_on_the_way`].
pub(crate) fn require_few_on_robots_way(scenario: &Scenario, rate_hz: f64) -> Result<(), Invalid> {
    let values = scenario.robot_values();
    require_few_on_the_way("robot", values.command_delay_s, values.command_jitter_s, rate_hz)
}

/// Passes when a safe speed is left at this rate.
fn require_safe_speed(controller: &ControllerConfig, rate_hz: f64) -> Result<(), Invalid> {
    if has_safe_speed(controller, rate_hz) {
        return Ok(());
    }
    let Description { sudden_m, blocked_deceleration_mps2, bounds, .. } = &controller.vehicle;
    let slowest_mps = bounds.velocity_min_mps;
    if controller.vehicle.surroundings == Surroundings::Open && controller.vehicle.careful_mps < slowest_mps {
        let allowed =
            format!("at least vehicle.bounds.velocity_min_mps = {slowest_mps} in open surroundings");
        return Err(Invalid::new("vehicle.careful_mps", controller.vehicle.careful_mps, allowed));
    }
    let rates = match smallest_rate(controller) {
        Some(rate_hz) => format!("at least {rate_hz}"),
        None => "no rate".to_owned(),
    };
    let allowed = format!(
        "{rates}, so that the robot can stop in time at vehicle.bounds.velocity_min_mps = {slowest_mps} with \
         vehicle.sudden_m = {sudden_m} and vehicle.blocked_deceleration_mps2 = {blocked_deceleration_mps2}"
    );
    Err(Invalid::new("rate_hz", rate_hz, allowed))
}

fn has_safe_speed(controller: &ControllerConfig, rate_hz: f64) -> bool {
    let controller = ControllerConfig { period_s: 1.0 / rate_hz, ..controller.clone() };
    speed_limit(&controller) >= controller.vehicle.bounds.velocity_min_mps
}

/// The smallest rate with a safe speed, rounded up to three decimals; the speed limit grows with the rate [Hz].
fn smallest_rate(controller: &ControllerConfig) -> Option<f64> {
    let [mut low, mut high] = RATES_HZ;
    if !has_safe_speed(controller, high) {
        return None;
    }
    while high > low * (1.0 + PRECISION) {
        let middle = (low * high).sqrt();
        if has_safe_speed(controller, middle) { high = middle } else { low = middle }
    }
    Some((high * 1e3).ceil() / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_commands_are_on_their_way_than_are_remembered() {
        assert_eq!(require_few_on_the_way("vehicle", 0.32, 0.0, 200.0), Ok(()));
        let refused = require_few_on_the_way("vehicle", 0.33, 0.0, 200.0).unwrap_err().to_string();
        assert!(
            refused.contains(
                "vehicle.command_delay_s = 0.33 is not allowed: at most 0.32, the time of 64 scans"
            ),
            "{refused}"
        );
    }

    #[test]
    fn commands_that_come_at_random_may_not_be_too_many_either() {
        assert_eq!(require_few_on_the_way("robot", 0.02, 0.06, 200.0), Ok(()));
        let refused = require_few_on_the_way("robot", 0.02, 0.061, 200.0).unwrap_err().to_string();
        let expected = "robot.command_jitter_s = 0.061 is not allowed: at most 0.06, so that 5 of it and command_delay_s = 0.02";
        assert!(refused.starts_with(expected), "{refused}");
        // The largest values of a scenario.
        assert_eq!(require_few_on_the_way("robot", 0.5, 0.5, 20.0), Ok(()));
    }

    #[test]
    fn the_smallest_rate_in_the_message_is_the_limit() {
        let vehicle = Description { sudden_m: 0.3, ..Description::default() };
        let controller = ControllerConfig { vehicle, ..ControllerConfig::default() };
        assert_eq!(require_safe_speed(&controller, 10.0), Ok(()));
        let refused = require_safe_speed(&controller, 0.5).unwrap_err();
        let named: f64 =
            refused.allowed.split(&[' ', ','][..]).find_map(|word| word.parse().ok()).expect("a rate");
        assert_eq!(require_safe_speed(&controller, named), Ok(()));
        assert!(require_safe_speed(&controller, 0.99 * named).is_err());
        assert_eq!(refused.key, "rate_hz");
        for name in ["vehicle.sudden_m = 0.3", "vehicle.blocked_deceleration_mps2 = 5"] {
            assert!(refused.to_string().contains(name), "{refused}");
        }
    }

    #[test]
    fn a_rate_at_which_commands_are_held_for_longer_than_an_interval_is_refused_with_the_smallest_one() {
        // 5.44 s by 12 are 0.4533 s.
        let controller = ControllerConfig::default();
        let refused = require_rate(&controller, 1.0).unwrap_err().to_string();
        assert!(refused.starts_with("rate_hz = 1 is not allowed: at least 2.206, "), "{refused}");
        assert_eq!(require_rate(&controller, 2.206), Ok(()));
        assert!(require_rate(&controller, 2.2).is_err());
        let long = ControllerConfig { horizon_s: 10.0, intervals: 10, ..controller };
        assert_eq!(require_rate(&long, 1.0), Ok(()));
    }

    #[test]
    fn a_careful_speed_below_the_smallest_velocity_is_refused_in_open_surroundings_only() {
        let of = |surroundings, careful_mps| {
            let vehicle = Description { surroundings, careful_mps, ..Description::default() };
            require_safe_speed(&ControllerConfig { vehicle, ..ControllerConfig::default() }, 10.0)
        };
        assert_eq!(of(Surroundings::Hall, 0.09), Ok(()));
        assert_eq!(of(Surroundings::Open, 0.1), Ok(()));
        let refused = of(Surroundings::Open, 0.09).unwrap_err().to_string();
        assert!(refused.starts_with("vehicle.careful_mps = 0.09 is not allowed: at least "), "{refused}");
    }

    #[test]
    fn a_robot_that_can_stop_at_no_rate_is_told_so() {
        let mut vehicle =
            Description { sudden_m: 0.1, blocked_deceleration_mps2: 0.1, ..Description::default() };
        vehicle.bounds.velocity_min_mps = 1.0;
        let refused = require_safe_speed(&ControllerConfig { vehicle, ..ControllerConfig::default() }, 10.0)
            .unwrap_err();
        assert!(refused.allowed.starts_with("no rate, "), "{refused}");
    }
}
