//! Whether the robot can do what scenario and system ask of it together.
//!
//! Each key is allowed alone; the combination decides. What can't be done at all is refused: a velocity that may not be sent,
//! a goal that no turn leads to, a landing that is finer than the way of one scan period. What can be done but ends
//! otherwise than the user may think is a warning.

mod legs;

use emulator::Scenario;
use nmpc::{ControllerConfig, speed_limit};
use vehicle::Invalid;
use vehicle::correction::SENT_VELOCITY_MAX_MPS;

use crate::System;

use legs::{ceil, floor};
pub(crate) use legs::{legs, require_goals, require_legs};

/// Passes when the velocities that the controller may desire can be sent.
///
/// # Errors
/// [`Invalid`] with the velocity and the largest one that can be sent.
pub(crate) fn require_velocity(system: &System) -> Result<(), Invalid> {
    let factor = system.actuator.calibration.correction().velocity_factor;
    let fastest_mps = SENT_VELOCITY_MAX_MPS / factor;
    let controller = &system.controller;
    let velocities = [
        ("controller.cruise_mps", controller.cruise_mps),
        ("vehicle.bounds.velocity_max_mps", controller.vehicle.bounds.velocity_max_mps),
    ];
    for (key, velocity_mps) in velocities {
        if velocity_mps > fastest_mps {
            let allowed = format!(
                "at most {}, as {SENT_VELOCITY_MAX_MPS} m/s may be sent, and actuator.calibration sends {factor} times \
                 the velocity",
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

    #[test]
    fn a_timeout_before_the_goal_is_a_warning() {
        let warned = |timeout_s: f64| {
            warnings(&Scenario { timeout_s, ..Scenario::default() }, &ControllerConfig::default())
        };
        assert_eq!(warned(10.0), Vec::<String>::new());
        assert_eq!(warned(9.0), ["timeout_s = 9 is over before the goal: 9.9 m at 1 m/s take 9.9 s"]);
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
