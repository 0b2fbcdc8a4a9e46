//! The pose that the base reports, at the time of the front beam, without a jump when the base starts again at zero.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

/// States that are kept: more than a base sends in two scan periods.
const MAX_STATES: usize = 256;

/// Pose and speed of the base.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Pose {
    /// Forward [m]
    pub(crate) x_m: f64,
    /// To the left [m]
    pub(crate) y_m: f64,
    /// Counter-clockwise [rad]
    pub(crate) yaw_rad: f64,
    /// Speed over ground [m/s]
    pub(crate) speed_mps: f64,
}

impl Pose {
    /// `self`, which is given from `origin`, in the frame of `origin`.
    fn from(self, origin: Pose) -> Self {
        let (sin, cos) = origin.yaw_rad.sin_cos();
        Self {
            x_m: origin.x_m + cos * self.x_m - sin * self.y_m,
            y_m: origin.y_m + sin * self.x_m + cos * self.y_m,
            yaw_rad: wrap(origin.yaw_rad + self.yaw_rad),
            ..self
        }
    }

    /// The origin from which `self` is `pose`.
    fn origin_of(self, pose: Pose) -> Self {
        let turn = Pose { yaw_rad: pose.yaw_rad - self.yaw_rad, ..Pose::default() };
        let moved = self.from(turn);
        Pose { x_m: pose.x_m - moved.x_m, y_m: pose.y_m - moved.y_m, ..turn }
    }

    /// Between two poses.
    fn between(self, other: Pose, share: f64) -> Self {
        let mix = |from: f64, to: f64| from + share * (to - from);
        Self {
            x_m: mix(self.x_m, other.x_m),
            y_m: mix(self.y_m, other.y_m),
            yaw_rad: wrap(self.yaw_rad + share * wrap(other.yaw_rad - self.yaw_rad)),
            speed_mps: mix(self.speed_mps, other.speed_mps),
        }
    }
}

/// The same angle in (-pi, pi].
pub(crate) fn wrap(angle_rad: f64) -> f64 {
    PI - (PI - angle_rad).rem_euclid(TAU)
}

/// The newest states of the base, oldest first.
#[derive(Debug, Default)]
pub(crate) struct History {
    states: VecDeque<(i64, Pose)>,
    origin: Pose,
    /// From the stamp of the newest state to its time [ns].
    behind_ns: i64,
}

impl History {
    /// Adds a state: by its stamp `at_ns` where base and scanner have one clock, else by its time `time_ns`, which is then
    /// given twice. After a restart the base counts from zero again; the robot has not moved by that.
    pub(crate) fn add(&mut self, [at_ns, time_ns]: [u64; 2], reported: Pose, restarted: bool) {
        let behind_ns = time_ns.wrapping_sub(at_ns).cast_signed();
        let last = self.states.back().copied();
        if let Some((_, before)) = last.filter(|_| restarted) {
            self.origin = reported.origin_of(before);
            // A clock that began again has another stamp for the states before.
            self.states.iter_mut().for_each(|(state_ns, _)| *state_ns += self.behind_ns - behind_ns);
        }
        self.behind_ns = behind_ns;
        if self.states.back().is_some_and(|(last_ns, _)| at_ns.cast_signed() <= *last_ns) {
            return;
        }
        if self.states.len() == MAX_STATES {
            self.states.pop_front();
        }
        self.states.push_back((at_ns.cast_signed(), reported.from(self.origin)));
    }

    /// The pose at a time between two states; `None` when there are none, or when they are further apart than `gap_ns`.
    pub(crate) fn at(&self, at_ns: u64, gap_ns: u64) -> Option<Pose> {
        let at_ns = at_ns.cast_signed();
        let after = self.states.partition_point(|(state_ns, _)| *state_ns < at_ns);
        let (after_ns, later) = *self.states.get(after)?;
        let (before_ns, earlier) = *self.states.get(after.checked_sub(1)?)?;
        let share = (at_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        (after_ns - before_ns <= gap_ns.cast_signed()).then(|| earlier.between(later, share))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn pose(x_m: f64, y_m: f64, yaw_rad: f64) -> Pose {
        Pose { x_m, y_m, yaw_rad, speed_mps: 1.0 }
    }

    #[test]
    fn the_pose_at_the_front_beam_lies_between_two_states() {
        let mut history = History::default();
        history.add([100; 2], pose(1.0, 0.0, 3.1), false);
        history.add([200; 2], pose(2.0, 0.0, -3.1), false);
        let found = history.at(150, 100).unwrap();
        assert!((found.x_m - 1.5).abs() < 1e-12 && (found.yaw_rad.abs() - PI).abs() < 1e-12, "{found:?}");
        assert_eq!((history.at(150, 99), history.at(201, 100), history.at(100, 100)), (None, None, None));
    }

    #[test]
    fn a_restart_of_the_base_does_not_move_the_robot() {
        let mut history = History::default();
        history.add([100; 2], pose(3.0, 2.0, PI / 2.0), false);
        history.add([200; 2], pose(0.0, 0.0, 0.0), true);
        history.add([300; 2], pose(1.0, 0.0, 0.0), false);
        let (still, moved) = (history.at(200, 100).unwrap(), history.at(300, 100).unwrap());
        assert!((still.x_m - 3.0).abs() < 1e-12 && (still.y_m - 2.0).abs() < 1e-12, "{still:?}");
        assert!((moved.x_m - 3.0).abs() < 1e-12 && (moved.y_m - 3.0).abs() < 1e-12, "{moved:?}");
    }

    #[test]
    fn a_clock_that_begins_again_loses_no_state() {
        let mut history = History::default();
        history.add([1000, 5000], pose(1.0, 0.0, 0.0), false);
        history.add([10, 5100], pose(0.0, 0.0, 0.0), true);
        // 5075 on CLOCK_MONOTONIC, 15 before the clock began.
        assert_eq!(history.at(10, 99), None);
        history.add([110, 5200], pose(1.0, 0.0, 0.0), false);
        let found = [history.at(10, 100).unwrap(), history.at(60, 100).unwrap()];
        assert!((found[0].x_m - 1.0).abs() < 1e-12 && (found[1].x_m - 1.5).abs() < 1e-12, "{found:?}");
    }
}
