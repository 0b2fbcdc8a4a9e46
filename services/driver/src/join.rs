//! Joins sweeps with the odometry: the pose at the time of the front beam.

use crate::motion::Motion;

/// Remembered states: two scan periods of 1 s at 100 Hz.
const REMEMBERED: usize = 256;

/// The newest motions of the base.
#[derive(Debug, Clone)]
pub struct Motions {
    newest_last: [Motion; REMEMBERED],
    count: usize,
}

impl Default for Motions {
    fn default() -> Self {
        Self { newest_last: [Motion::default(); REMEMBERED], count: 0 }
    }
}

impl Motions {
    /// Adds a motion; one of the time of the newest replaces it, and an older one changes nothing.
    pub fn add(&mut self, motion: Motion) {
        if self.newest().is_some_and(|newest| motion.time_ns < newest.time_ns) {
            return;
        }
        let is_newer = self.newest().is_none_or(|newest| motion.time_ns > newest.time_ns);
        if is_newer && self.count == REMEMBERED {
            self.newest_last.rotate_left(1);
        } else if is_newer {
            self.count += 1;
        }
        self.newest_last[self.count - 1] = motion;
    }

    /// The newest motion.
    pub fn newest(&self) -> Option<&Motion> {
        self.newest_last[..self.count].last()
    }

    /// Forgets all: the connection is new.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Whether the motion at a time is known without looking further than `ahead_ns` ahead of the newest state.
    pub fn covers(&self, time_ns: u64, ahead_ns: u64) -> bool {
        self.newest().is_some_and(|newest| newest.time_ns.saturating_add(ahead_ns) >= time_ns)
    }

    /// The motion at a time: between two states, or with the velocities of the nearest one. `None` without any state.
    pub fn at(&self, time_ns: u64) -> Option<Motion> {
        let known = &self.newest_last[..self.count];
        let after = known.iter().position(|motion| motion.time_ns >= time_ns);
        Some(match after {
            None => known.last()?.at(time_ns),
            Some(0) => known.first()?.at(time_ns),
            Some(after) => Motion::between(&known[after - 1], &known[after], time_ns),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(time_ms: u64, x_m: f64) -> Motion {
        Motion { time_ns: time_ms * 1_000_000, pose: [x_m, 0.0, 0.0], speed_mps: 1.0, yaw_rate_radps: 0.0 }
    }

    #[test]
    fn a_pose_is_interpolated_or_moved_on() {
        let mut motions = Motions::default();
        assert!(motions.at(0).is_none() && !motions.covers(0, 5_000_000));
        for step in 0..40 {
            motions.add(motion(100 * step, 0.1 * step as f64));
        }
        let x_m = |time_ms: u64| motions.at(time_ms * 1_000_000).unwrap().pose[0];
        assert!((x_m(3850) - 3.85).abs() < 1e-9, "between two");
        assert!((x_m(3950) - 3.95).abs() < 1e-9, "after the newest");
        assert!((x_m(2000) - 2.0).abs() < 1e-9, "before the oldest");
        assert!(motions.covers(3_904_000_000, 5_000_000) && !motions.covers(3_906_000_000, 5_000_000));
    }

    #[test]
    fn a_state_of_the_same_time_replaces_the_newest_and_an_older_one_does_not() {
        let mut motions = Motions::default();
        motions.add(motion(100, 1.0));
        motions.add(motion(100, 2.0));
        motions.add(motion(99, 3.0));
        assert_eq!((motions.count, motions.newest().unwrap().pose[0]), (1, 2.0));
    }
}
