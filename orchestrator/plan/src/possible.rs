//! Whether the robot can do what scenario and system ask of it together.
//!
//! Each key is allowed alone; the combination decides. What can't be done at all is refused: a velocity that may not be sent,
//! a goal that no turn leads to, a landing that is finer than the way of one scan period. What can be done but ends
//! otherwise than the user may think is a warning.

mod legs;

use actuation::ActuatorConfig;
use emulator::Scenario;
use estimator::EstimatorConfig;
use estimator::correction::CorrectionMode;
use nmpc::{ControllerConfig, speed_limit};
use obstacles::{ObstaclesConfig, SWEEP_SHARE};
use vehicle::Invalid;
use vehicle::correction::SteeringCorrection;

use crate::System;

use legs::{ceil, floor};
pub(crate) use legs::{legs, require_goals, require_legs};

/// Share of the angles that a steering network was fitted to up to which it is one.
const MAPPED: f64 = 1.02;

/// Passes when the velocities that the controller may desire can be sent.
///
/// # Errors
/// [`Invalid`] with the velocity and the largest one that can be sent.
pub(crate) fn require_velocity(system: &System) -> Result<(), Invalid> {
    let factor = system.actuator.calibration.correction().velocity_factor;
    let controller = &system.controller;
    let sent_mps = system.vehicle.bounds.sent_velocity_max_mps;
    let fastest_mps = sent_mps / factor;
    let velocities = [
        ("controller.cruise_mps", controller.cruise_mps),
        ("vehicle.bounds.velocity_max_mps", controller.vehicle.bounds.velocity_max_mps),
    ];
    for (key, velocity_mps) in velocities {
        if velocity_mps > fastest_mps {
            let allowed = format!(
                "at most {}, as vehicle.bounds.sent_velocity_max_mps = {sent_mps} may be sent, and actuator.calibration \
                 sends {factor} times the velocity",
                floor(fastest_mps)
            );
            return Err(Invalid::new(key, velocity_mps, allowed));
        }
    }
    Ok(())
}

/// What ends otherwise than the user may think.
pub(crate) fn warnings(scenario: &Scenario, controller: &ControllerConfig) -> Vec<String> {
    let legs = legs::all(scenario);
    let limit_mps = speed_limit(controller);
    let speed_mps = controller.cruise_mps.min(limit_mps);
    let way_m: f64 = legs.iter().map(|leg| leg.goal.distance_m(leg.start.x_m, leg.start.y_m)).sum();
    let last_m = legs.last().map_or(0.0, |leg| leg.goal.tolerance_m);
    let way_m = (way_m - last_m).max(0.0);
    let stays_s: f64 = legs.iter().rev().skip(1).map(|leg| leg.goal.stay_s).sum();
    let shortest_s = way_m / speed_mps + stays_s;
    let over = (scenario.timeout_s < shortest_s).then(|| {
        format!(
            "timeout_s = {} is over before the goal: {} m at {} m/s take {} s",
            scenario.timeout_s,
            ceil(way_m),
            floor(speed_mps),
            ceil(shortest_s)
        )
    });
    over.into_iter().chain(unstable(controller)).collect()
}

/// A way so wide that the scanner sees no wall from where the robot starts, along a course from its middle.
pub(crate) fn blind(scenario: &Scenario, obstacles: &ObstaclesConfig) -> Option<String> {
    let start_y_m = if scenario.course.is_some() { 0.0 } else { scenario.start.y_m };
    let share = obstacles.wall_share(start_y_m).filter(|share| *share <= SWEEP_SHARE)?;
    let [low, high] = obstacles.wall_y_m;
    Some(format!(
        "the way is {} m wide: from {start_y_m} m beside its line {} % of the beams reach a wall, and a robot that sees less than \
         {} % is blind and stops; make it narrower, or set surroundings = \"open\" in the scenario and in [vehicle]",
        floor(high - low),
        floor(100.0 * share),
        100.0 * SWEEP_SHARE
    ))
}

/// An emulated robot whose odometry errs otherwise than the estimator corrects, so that it lands beside its goal.
pub(crate) fn drift(scenario: &Scenario, estimator: &EstimatorConfig) -> Option<String> {
    let truth = scenario.robot.odometry_longitudinal.filter(|_| scenario.robot.publish_truth)?;
    let drift = estimator.settings().ok()?.drift;
    let corrected = if drift.mode == CorrectionMode::Off { 0.0 } else { drift.longitudinal };
    let legs = legs::all(scenario);
    let way_m: f64 = legs.iter().map(|leg| leg.goal.distance_m(leg.start.x_m, leg.start.y_m)).sum();
    let tolerance_m = legs.iter().map(|leg| leg.goal.tolerance_m).fold(f64::INFINITY, f64::min);
    let error_m = way_m * (truth - corrected).abs();
    (error_m > tolerance_m).then(|| {
        format!(
            "the odometry does not report {} % of the way, and the estimator expects {} %: {} m are driven with an error of \
             {} m, and goal.tolerance_m is {tolerance_m}; `scanloop calibrate drift` or estimator.odometry_longitudinal mends that",
            floor(100.0 * truth),
            floor(100.0 * corrected),
            ceil(way_m),
            floor(error_m)
        )
    })
}

/// An emulated robot whose commands come so irregularly that its dead man blocks the wheels between them.
pub(crate) fn irregular(scenario: &Scenario, rate_hz: f64) -> Option<String> {
    let jitter_s = scenario.robot_values().command_jitter_s;
    // The dead man waits for two periods: with a mean delay of half of one, one gap in 24 is longer.
    let most_hz = 0.5 / jitter_s;
    (rate_hz > most_hz).then(|| {
        format!(
            "rate_hz = {rate_hz} with robot.command_jitter_s = {jitter_s}: the dead man of the robot blocks the wheels between \
             commands that are late, from {} Hz on; it drives slower or not at all",
            floor(most_hz)
        )
    })
}

/// A steering map that is not known as far as the wheels may turn.
pub(crate) fn unmapped(actuator: &ActuatorConfig) -> Option<String> {
    let steering_rad = actuator.vehicle.bounds.steering_max_rad;
    let SteeringCorrection::Network(network) = actuator.calibration.correction().steering else {
        return None;
    };
    (steering_rad > MAPPED * network.input_scale_rad).then(|| {
        format!(
            "actuator.calibration knows the steering up to {} rad, and vehicle.bounds.steering_max_rad is {steering_rad}: further \
             angles are not reached; `scanloop calibrate steering` or actuator.calibration = \"identity\" mends that",
            floor(network.input_scale_rad)
        )
    })
}

/// A robot that turns round by itself below its largest velocity.
fn unstable(controller: &ControllerConfig) -> Option<String> {
    let vehicle = &controller.vehicle;
    let fastest_mps = vehicle.bounds.velocity_max_mps;
    let critical_mps =
        vehicle.parameters().critical_mps().filter(|critical_mps| *critical_mps < fastest_mps)?;
    Some(format!(
        "vehicle.front_m = {} is above vehicle.rear_m = {}: with this mass and stiffness the robot turns round by itself from \
         {} m/s on, and vehicle.bounds.velocity_max_mps is {fastest_mps}; the estimator stops it then",
        vehicle.front_m,
        vehicle.rear_m,
        floor(critical_mps)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::correction::Calibration;

    #[test]
    fn a_timeout_before_the_goal_is_a_warning() {
        let warned = |timeout_s: f64| {
            warnings(&Scenario { timeout_s, ..Scenario::default() }, &ControllerConfig::default())
        };
        assert_eq!(warned(10.0), Vec::<String>::new());
        assert_eq!(warned(9.0), ["timeout_s = 9 is over before the goal: 9.9 m at 1 m/s take 9.9 s"]);
    }

    #[test]
    fn a_way_that_shows_the_scanner_no_wall_is_a_warning() {
        let warned = |text: &str| {
            let scenario = Scenario::parse(text, "wide").unwrap();
            blind(&scenario, &pipeline::Tuning::default().for_scenario(&scenario).obstacles)
        };
        let track = |half_m: f64| warned(&format!("[track]\ny_m = [-{half_m}, {half_m}]"));
        assert_eq!((warned(""), track(3.0)), (None, None));
        assert!(
            track(3.8)
                .is_some_and(|text| text.starts_with("the way is 7.6 m wide: from 0 m beside its line 0 %"))
        );
        // Near to one side that wall is seen; walls of the track itself are nearer than those of the hall.
        assert_eq!(warned("[track]\ny_m = [-3.8, 3.8]\n[start]\ny_m = -2"), None);
        assert_eq!(warned("[track]\ny_m = [-3.8, 3.8]\nwalls = true"), None);
        let course = "[course]\nwidth_m = 8\nwaypoints = [{}, { x_m = 20 }]";
        assert!(warned(course).is_some());
    }

    #[test]
    fn an_odometry_that_errs_otherwise_than_it_is_corrected_is_a_warning_on_a_long_way() {
        let warned = |x_m: f64, more: &str| {
            let text = format!("[goal]\nx_m = {x_m}\n[robot]\nodometry_longitudinal = 0.02\n{more}");
            drift(&Scenario::parse(&text, "worn").unwrap(), &EstimatorConfig::default())
        };
        let expected = "the odometry does not report 2 % of the way, and the estimator expects 1 %: 12 m are driven with an error \
                        of 0.12 m, and goal.tolerance_m is 0.1";
        assert!(warned(12.0, "").is_some_and(|text| text.starts_with(expected)), "{:?}", warned(12.0, ""));
        assert_eq!((warned(9.0, ""), warned(12.0, "publish_truth = false")), (None, None));
    }

    #[test]
    fn commands_that_come_less_regularly_than_the_dead_man_waits_are_a_warning() {
        let warned = |preset: &str, rate_hz: f64| {
            let text = format!("[robot]\npreset = \"{preset}\"");
            irregular(&Scenario::parse(&text, "fast").unwrap(), rate_hz)
        };
        assert!(warned("summit", 500.0).is_some_and(|text| text.contains("from 250 Hz on")));
        assert_eq!((warned("summit", 200.0), warned("ideal", 2000.0)), (None, None));
    }

    #[test]
    fn a_steering_map_that_ends_before_the_wheels_do_is_a_warning() {
        let warned = |steering_max_rad, calibration| {
            let mut actuator = ActuatorConfig { calibration, ..ActuatorConfig::default() };
            actuator.vehicle.bounds.steering_max_rad = steering_max_rad;
            unmapped(&actuator)
        };
        let expected = "actuator.calibration knows the steering up to 0.074 rad, and vehicle.bounds.steering_max_rad is 0.3";
        assert!(warned(0.3, Calibration::Default).is_some_and(|text| text.starts_with(expected)));
        assert_eq!((warned(0.07, Calibration::Default), warned(0.3, Calibration::Identity)), (None, None));
    }

    #[test]
    fn the_time_of_a_course_is_that_of_its_length_and_goals_are_stayed_at() {
        let text = "timeout_s = 10\n[course]\nwaypoints = [{ yaw_rad = 0 }, { x_m = 5, yaw_rad = 0 }, \
            { x_m = 9, y_m = 4, yaw_rad = 1.5707963267948966 }]\n";
        // 5 m and a quarter of a circle with 4 m radius, 0.1 m before its end.
        let expected = "timeout_s = 10 is over before the goal: 11.184 m at 1 m/s take 11.184 s";
        let corner = Scenario::parse(text, "corner").unwrap();
        assert_eq!(warnings(&corner, &ControllerConfig::default()), [expected]);
        let text = "timeout_s = 12\n[[goal]]\nx_m = 5\nstay_s = 3\n[[goal]]\nx_m = 10";
        let expected = "timeout_s = 12 is over before the goal: 9.9 m at 1 m/s take 12.9 s";
        assert_eq!(
            warnings(&Scenario::parse(text, "two").unwrap(), &ControllerConfig::default()),
            [expected]
        );
    }

    #[test]
    fn a_vehicle_that_turns_round_by_itself_is_a_warning_and_not_in_the_way_of_the_goal() {
        let mut controller = ControllerConfig::default();
        (controller.vehicle.front_m, controller.vehicle.mass_kg) = (0.3, 1e4);
        assert_eq!(require_goals(&Scenario::default(), &controller), Ok(()));
        let [warning] = warnings(&Scenario::default(), &controller).try_into().unwrap();
        // 0.4924 m, and 250 / (1e4 * 0.1076).
        assert!(warning.contains("by itself from 0.237 m/s on"), "{warning}");
        controller.vehicle.mass_kg = 14.695;
        assert!(warnings(&Scenario::default(), &controller).is_empty());
    }
}
