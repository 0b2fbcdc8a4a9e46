//! When to block the wheels so that the robot stands on the goal.
//!
//! The smallest velocity is 0.1 m/s, so the optimal control problem cannot end at rest: the last decision is a stop
//! at the closest approach. It uses the state at the time the command acts, which includes the delay of the loop, and
//! the stopping distance v^2 / (2 d). Stopping now is compared with stopping after the next scan, until when the robot
//! slows down to its smallest velocity: at the smallest velocity the stop is made half a step early.

use vehicle::{Description, Goal, State};

/// What to do at a position relative to the goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Approach {
    /// The goal is still ahead.
    Ahead,
    /// Stopping now ends within the tolerance, and later would be further away.
    Land,
    /// The goal is behind or beside the robot, further away than its tolerance: it cannot be reached forwards.
    Passed,
}

/// What to do at `state`, where the command acts, with `speed` [m/s], until the next scan `period_s` later.
pub(crate) fn approach(
    goal: &Goal,
    state: &State,
    speed: f64,
    period_s: f64,
    vehicle: &Description,
) -> Approach {
    let [along, across] = from_rest(goal, state, speed, vehicle);
    let ahead_x = goal.x_m - state.x;
    let (way, next_speed) = slowing(vehicle, speed, period_s);
    // How much further the robot comes to rest when it is stopped after the next scan.
    let later = way + slide(vehicle, next_speed) - slide(vehicle, speed);
    if along > later / 2.0 || ahead_x > goal.tolerance_m + speed * period_s {
        return Approach::Ahead;
    }
    if along.hypot(across) <= goal.tolerance_m { Approach::Land } else { Approach::Passed }
}

/// How far the goal is ahead and to the left of where the robot comes to rest when it is stopped now [m].
pub(crate) fn from_rest(goal: &Goal, state: &State, speed: f64, vehicle: &Description) -> [f64; 2] {
    let (sin, cos) = (state.yaw + state.sideslip).sin_cos();
    let (ahead_x, ahead_y) = (goal.x_m - state.x, goal.y_m - state.y);
    [ahead_x * cos + ahead_y * sin - slide(vehicle, speed), ahead_y * cos - ahead_x * sin]
}

fn slide(vehicle: &Description, speed: f64) -> f64 {
    speed * speed / (2.0 * vehicle.blocked_deceleration_mps2)
}

/// Way over a period [m], and the speed at its end [m/s], of a robot that slows down to its smallest velocity as fast as
/// its drive can.
fn slowing(vehicle: &Description, speed: f64, period_s: f64) -> (f64, f64) {
    let slowest = vehicle.bounds.velocity_min_mps;
    let excess = (speed - slowest).max(0.0);
    // The drive follows with its lag, but no faster than it can decelerate.
    let lag_s = vehicle.velocity_lag_s.max(excess / vehicle.deceleration_max_mps2);
    let left = if lag_s > 0.0 { (-period_s / lag_s).exp() } else { 0.0 };
    (speed.min(slowest) * period_s + excess * lag_s * (1.0 - left), speed.min(slowest) + excess * left)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, speed: f64) -> Approach {
        let state = State { x, y, ..State::default() };
        approach(&Goal::default(), &state, speed, 0.1, &Description::default())
    }

    #[test]
    fn the_wheels_are_blocked_at_the_closest_approach() {
        // At 0.1 m/s: 1 mm to stop and half a step of 5 mm.
        assert_eq!(at(9.993, 0.0, 0.1), Approach::Ahead);
        assert_eq!(at(9.995, 0.0, 0.1), Approach::Land);
    }

    #[test]
    fn a_robot_that_can_still_slow_down_lands_later_and_one_that_can_not_lands_at_once() {
        let of = |x: f64, deceleration_max_mps2: f64| {
            let vehicle = Description { deceleration_max_mps2, ..Description::default() };
            approach(&Goal::default(), &State { x, ..State::default() }, 1.0, 0.1, &vehicle)
        };
        // At 1 m/s blocked wheels slide 0.1 m. In 0.1 s the drive slows down by 0.25 m/s, with its limit as time constant:
        // 0.09 m, and 0.06 m of slide. So stopping later ends 0.05 m further on, and 2.5 cm before the goal is the place.
        assert_eq!([9.87, 9.88].map(|x| of(x, 3.0)), [Approach::Ahead, Approach::Land]);
        // A drive that does not slow down: half a step of 5 cm.
        assert_eq!([9.84, 9.86].map(|x| of(x, 0.01)), [Approach::Ahead, Approach::Land]);
    }

    #[test]
    fn the_period_decides_how_early_the_robot_lands() {
        let of = |x: f64, period_s: f64| {
            approach(
                &Goal::default(),
                &State { x, ..State::default() },
                0.1,
                period_s,
                &Description::default(),
            )
        };
        // Half a step of 0.1 m/s and 1 mm: 6 mm at 10 Hz, 51 mm at 1 Hz.
        assert_eq!([9.94, 9.96].map(|x| of(x, 1.0)), [Approach::Ahead, Approach::Land]);
        assert_eq!([9.94, 9.96].map(|x| of(x, 0.1)), [Approach::Ahead, Approach::Ahead]);
    }

    #[test]
    fn beside_the_goal_is_passed_and_not_landed() {
        assert_eq!(at(10.0, 0.15, 0.1), Approach::Passed);
        assert_eq!(at(10.3, 0.0, 0.0), Approach::Passed);
        assert_eq!(at(10.05, 0.05, 0.0), Approach::Land);
    }

    #[test]
    fn a_robot_that_faces_away_far_from_the_goal_has_not_passed_it() {
        let state = State { yaw: 2.0, ..State::default() };
        assert_eq!(approach(&Goal::default(), &state, 1.0, 0.1, &Description::default()), Approach::Ahead);
    }
}
