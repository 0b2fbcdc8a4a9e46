//! Out of a dead end: back over the way that the robot came, to where a path past the obstacles begins.
//!
//! A robot that stands too near before an obstacle can't turn away from it, and one in a pocket has no path at all. After
//! it has stood for a while, places on the way back are tried one after the other, one in each scan, until the path search
//! finds a clear path from one of them. The robot drives there backwards, and then on.
//!
//! Nothing is tried while a body moves: it may go. Assumed: what the robot has seen on its way still stands there.
//!
//! What stood in the dead end is remembered when the scanner does not show it any more, until the robot has come further, or
//! sees that it has gone. Else it would drive in again.

use shared_types::{MAX_OBSTACLES, Obstacle, Obstacles, Pose, plain_state};
use vehicle::State;
use vehicle::frame::to_robot;

/// How long a robot stands before it looks for a way back [s].
const WAIT_S: f64 = 1.5;
/// From one place that is tried to the next [m].
const STEP_M: f64 = 0.25;
/// How often the robot drives back without getting further than it was ...
const MAX_TRIES: u32 = 3;
/// ... by this [m].
const FURTHER_M: f64 = 1.0;
/// Ellipses whose centres are no further apart are of one body [m].
const SAME_M: f64 = 0.6;
/// So near ahead of the robot what stands there is described; what is not has gone [m].
const DESCRIBED_M: f64 = 2.0;
/// The same to the side, by the distance ahead.
const DESCRIBED_SIDE: f64 = 0.8;
/// What is added to the identity of what is remembered: another ellipse may have it now.
const REMEMBERED: u32 = 1 << 30;

plain_state! {
    /// The way out of a dead end.
    pub struct WayBack {
        /// Whether the robot drives it
        pub drives: u32,
        /// Scans in a row in which the robot stood without a plan
        pub stood: u32,
        /// How often the robot drove back without getting further than it was
        pub tries: u32,
        /// Number of ellipses that are remembered
        pub count: u32,
        /// Where on the course it began to drive back last [m]
        pub from_m: f64,
        /// Where on the course and to the left of it the way back ends [m]
        pub to_m: [f64; 2],
        /// What stood in the dead end
        pub known: [Obstacle; MAX_OBSTACLES],
    }
}

impl WayBack {
    /// Notes that the robot stands without a plan at `along_m`; how far behind it a path is looked for in this scan [m].
    pub(crate) fn stand(&mut self, along_m: f64, period_s: f64, farthest_m: f64) -> Option<f64> {
        self.stood = self.stood.saturating_add(1);
        if along_m > self.from_m + FURTHER_M {
            self.tries = 0;
        }
        let waited = (WAIT_S / period_s).ceil() as u32;
        let place = self.stood.checked_sub(waited)? % ((farthest_m / STEP_M) as u32 + waited).max(1);
        let way_m = STEP_M * f64::from(place + 1);
        (way_m <= farthest_m && self.tries < MAX_TRIES).then_some(way_m)
    }

    /// Tries the same place in the next scan again.
    pub(crate) fn stay(&mut self) {
        self.stood = self.stood.saturating_sub(1);
    }

    /// Drives back from `along_m` to a state on the course.
    pub(crate) fn begin(&mut self, along_m: f64, to: &State) {
        let tries = self.tries + 1;
        *self = Self { drives: 1, stood: 0, tries, from_m: along_m, to_m: [to.x, to.y], ..*self };
    }

    /// Length of the way out of what is remembered [m].
    pub(crate) fn length_m(&self) -> f64 {
        if self.count == 0 { 0.0 } else { (self.from_m - self.to_m[0]).max(0.0) }
    }

    /// Remembers what is described, and at rest, where the robot begins to drive back.
    pub(crate) fn remember(&mut self, obstacles: &Obstacles) {
        self.count = 0;
        for obstacle in obstacles.list() {
            let id = obstacle.id | REMEMBERED;
            let (velocity_x_mps, velocity_y_mps) = (0.0, 0.0);
            self.known[self.count as usize] = Obstacle { id, velocity_x_mps, velocity_y_mps, ..*obstacle };
            self.count += 1;
        }
    }

    /// What is described with what is remembered; `None` where nothing is. `along_m` is the place of the robot.
    pub(crate) fn recall(
        &mut self,
        obstacles: &Obstacles,
        pose: &Pose,
        along_m: Option<f64>,
    ) -> Option<Obstacles> {
        if self.drives == 0 && along_m.is_some_and(|along_m| along_m > self.from_m + FURTHER_M) {
            self.count = 0;
        }
        let is_described = |known: &Obstacle| {
            obstacles.list().iter().any(|one| (one.x_m - known.x_m).hypot(one.y_m - known.y_m) < SAME_M)
        };
        let mut kept = 0;
        let mut all = *obstacles;
        for index in 0..(self.count as usize).min(MAX_OBSTACLES) {
            let known = self.known[index];
            let from = to_robot(pose.yaw_rad, known.x_m - pose.x_m, known.y_m - pose.y_m);
            let is_near = (0.0..DESCRIBED_M).contains(&from.x) && from.y.abs() < DESCRIBED_SIDE * from.x;
            let described = is_described(&known);
            if is_near && !described {
                continue;
            }
            self.known[kept] = known;
            kept += 1;
            if !described && (all.count as usize) < MAX_OBSTACLES {
                all.items[all.count as usize] = known;
                all.count += 1;
            }
        }
        self.count = kept as u32;
        (kept > 0).then_some(all)
    }

    /// Has driven back, or can't drive further.
    pub(crate) fn end(&mut self) {
        (self.drives, self.stood) = (0, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_while_places_further_and_further_back_are_tried_and_then_again() {
        let mut back = WayBack::default();
        let tried: Vec<_> = (0..60).map(|_| back.stand(5.0, 0.1, 1.0)).collect();
        assert_eq!(tried[..14], [None; 14]);
        assert_eq!(tried[14..19], [Some(0.25), Some(0.5), Some(0.75), Some(1.0), None]);
        assert_eq!(tried[14 + 19], Some(0.25), "{tried:?}");
    }

    #[test]
    fn what_stood_in_the_dead_end_is_remembered_until_it_is_seen_to_have_gone() {
        let described = |x_m: f64| {
            let mut obstacles = Obstacles { count: 1, ..Obstacles::default() };
            obstacles.items[0] = Obstacle { id: 7, x_m, ..Obstacle::default() };
            obstacles
        };
        let mut back = WayBack::default();
        assert_eq!(back.recall(&described(9.0), &Pose::default(), Some(1.0)), None);
        back.remember(&described(9.0));
        back.from_m = 7.0;
        // Out of sight it is added, described it is not there twice, and near and not described it has gone.
        let recalled = back.recall(&Obstacles::default(), &Pose::default(), Some(1.0)).unwrap();
        assert_eq!((recalled.count, recalled.items[0].x_m), (1, 9.0));
        assert_eq!(back.recall(&described(9.2), &Pose::default(), Some(1.0)).unwrap().count, 1);
        let near = Pose { x_m: 7.5, ..Pose::default() };
        let mut gone = back;
        assert_eq!(gone.recall(&Obstacles::default(), &near, Some(7.5)), None);
        assert_eq!(back.recall(&Obstacles::default(), &Pose::default(), Some(8.1)), None, "further on");
    }

    #[test]
    fn a_robot_that_gets_no_further_gives_up() {
        let mut back = WayBack::default();
        let mut begin = |along_m: f64| {
            let found = (0..40).find_map(|_| back.stand(along_m, 0.1, 1.0));
            if found.is_some() {
                back.begin(along_m, &State::default());
                back.end();
            }
            found.is_some()
        };
        assert_eq!([5.0, 5.1, 5.2, 5.3].map(&mut begin), [true, true, true, false]);
        assert!(begin(6.3));
    }
}
