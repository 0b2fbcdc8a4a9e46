//! When to block the wheels so that the robot stands on the goal.
//!
//! The smallest velocity is 0.1 m/s, so the optimal control problem cannot end at rest: the last decision is a stop
//! at the closest approach. It uses the state at the time the command acts, which includes the delay of the loop, and
//! the stopping distance v^2 / (2 d). It is made half a step early, where stopping now and stopping one scan later
//! end equally far from the goal.

use vehicle::State;

use vehicle::Goal;

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
    deceleration_mps2: f64,
) -> Approach {
    let (sin, cos) = (state.yaw + state.sideslip).sin_cos();
    let (ahead_x, ahead_y) = (goal.x_m - state.x, goal.y_m - state.y);
    let along = ahead_x * cos + ahead_y * sin - speed * speed / (2.0 * deceleration_mps2);
    let across = ahead_y * cos - ahead_x * sin;
    if along > speed * period_s / 2.0 || ahead_x > goal.tolerance_m + speed * period_s {
        return Approach::Ahead;
    }
    if along.hypot(across) <= goal.tolerance_m { Approach::Land } else { Approach::Passed }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, speed: f64) -> Approach {
        approach(&Goal::default(), &State { x, y, ..State::default() }, speed, 0.1, 5.0)
    }

    #[test]
    fn the_wheels_are_blocked_at_the_closest_approach() {
        // At 0.2 m/s: 4 mm to stop and half a step of 1 cm.
        assert_eq!(at(9.98, 0.0, 0.2), Approach::Ahead);
        assert_eq!(at(9.987, 0.0, 0.2), Approach::Land);
    }

    #[test]
    fn the_stopping_distance_is_part_of_the_decision() {
        // At 1 m/s: 10 cm to stop and half a step of 5 cm.
        assert_eq!(at(9.84, 0.0, 1.0), Approach::Ahead);
        assert_eq!(at(9.86, 0.0, 1.0), Approach::Land);
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
        assert_eq!(approach(&Goal::default(), &state, 1.0, 0.1, 5.0), Approach::Ahead);
    }
}
