//! Out of a dead end: back over the way that the robot came, to where a path past the obstacles begins.
//!
//! A robot that stands too near before an obstacle can't turn away from it, and one in a pocket has no path at all. After
//! it has stood for a while, places on the way back are tried one after the other, one in each scan, until the path search
//! finds a clear path from one of them. The robot drives there backwards, and then on.
//!
//! A goal that was passed is come back to from behind: the robot drives on, straightens, and drives back.
//!
//! Nothing is tried while a body moves: it may go. Assumed: what the robot has seen on its way still stands there.
//!
//! What the robot remembers is planned for until it has come further than the dead end. Else it would drive in again.

use shared_types::plain_state;
use vehicle::{Goal, State};

/// How long a robot stands before it looks for a way back [s].
const WAIT_S: f64 = 1.5;
/// From one place that is tried to the next [m].
const STEP_M: f64 = 0.25;
/// How often the robot drives back without getting further than it was ...
const MAX_TRIES: u32 = 3;
/// ... by this [m].
const FURTHER_M: f64 = 1.0;
/// The way to behind a goal that was passed.
const BEHIND_GOAL: u32 = 2;

plain_state! {
    /// The way out of a dead end.
    pub struct WayBack {
        /// 0 while the robot does not drive it, 1 while it does, 2 on the way to where it turns behind a goal that was passed
        pub drives: u32,
        /// Scans in a row in which the robot stood without a plan
        pub stood: u32,
        /// How often the robot drove back without getting further than it was
        pub tries: u32,
        /// Whether the robot has not come further than the dead end since
        pub remembers: u32,
        /// Where on the course it began to drive back last [m]
        pub from_m: f64,
        /// Where on the course and to the left of it the way back ends [m]
        pub to_m: [f64; 2],
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
        *self = Self { drives: 1, stood: 0, tries, remembers: 1, from_m: along_m, to_m: [to.x, to.y] };
    }

    /// Drives on to behind a goal that was passed, to come back to it from there; false after some tries.
    pub(crate) fn overshoot(&mut self, goal: &Goal) -> bool {
        if self.tries >= MAX_TRIES {
            return false;
        }
        (self.drives, self.to_m) = (BEHIND_GOAL, [goal.x_m, goal.y_m]);
        true
    }

    /// Whether the robot drives on to behind its goal.
    pub(crate) fn overshoots(&self) -> bool {
        self.drives == BEHIND_GOAL
    }

    /// Whether the robot still has to pass the dead end; `along_m` is its place where that is known.
    pub(crate) fn is_before(&mut self, along_m: Option<f64>) -> bool {
        if self.drives == 0 && along_m.is_some_and(|along_m| along_m > self.from_m + FURTHER_M) {
            self.remembers = 0;
        }
        self.remembers == 1
    }

    /// Length of the way out of a dead end that is not passed [m].
    pub(crate) fn length_m(&self) -> f64 {
        if self.remembers == 0 { 0.0 } else { (self.from_m - self.to_m[0]).max(0.0) }
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
    fn a_dead_end_counts_until_the_robot_has_come_further() {
        let mut back = WayBack::default();
        assert!(!back.is_before(Some(1.0)) && back.length_m() == 0.0);
        back.begin(7.0, &State { x: 3.0, ..State::default() });
        assert!(back.is_before(Some(9.0)), "it drives back");
        back.end();
        assert!(back.is_before(Some(7.9)) && back.is_before(None) && back.length_m() == 4.0);
        assert!(!back.is_before(Some(8.1)));
    }

    #[test]
    fn a_goal_that_was_passed_is_come_back_to_three_times_at_most() {
        let mut back = WayBack::default();
        let goal = Goal { x_m: 9.0, y_m: 0.2, ..Goal::default() };
        for _ in 0..MAX_TRIES {
            assert!(back.overshoot(&goal) && back.overshoots() && back.to_m == [9.0, 0.2]);
            back.begin(12.0, &State { x: 9.0, y: 0.2, ..State::default() });
            assert!(!back.overshoots() && back.drives == 1);
            back.end();
        }
        assert!(!back.overshoot(&goal));
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
