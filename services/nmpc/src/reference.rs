//! The reference of the optimal control problem: a point that moves along the reference path ahead of the robot.
//!
//! The point starts at the robot's x and keeps the cruising velocity until the distance to the goal over the landing
//! time is less. Then it slows down exponentially to the smallest velocity, with which it passes the goal: the stop
//! is not part of the problem. The robot can always reach the point: full-step Gauss-Newton diverges when the
//! reference is too far away, and a point that waits at the goal would slow the robot down long before.

use vehicle::{Control, State};

use crate::reference_path::ReferencePath;

/// Velocity of the moving point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pace {
    /// Velocity far from the goal [m/s].
    pub(crate) cruise: f64,
    /// Smallest velocity [m/s].
    pub(crate) slowest: f64,
    /// Position of the goal along the track [m].
    pub(crate) goal_x: f64,
    /// Time constant of the approach [s].
    pub(crate) landing_time: f64,
}

impl Pace {
    /// Velocity of the point at `x` [m/s].
    pub(crate) fn velocity(&self, x: f64) -> f64 {
        ((self.goal_x - x) / self.landing_time).clamp(self.slowest, self.cruise.max(self.slowest))
    }

    /// The same where the path allows less [m/s].
    pub(crate) fn along(&self, reference_path: &ReferencePath, x: f64) -> f64 {
        self.velocity(x).min(reference_path.speed_at(x).max(self.slowest))
    }
}

/// Steps per interval with which the point is moved.
const STEPS: usize = 4;

/// Fills `references` for nodes 1 to `intervals` and returns the reference of the controls.
pub(crate) fn fill(
    reference_path: &ReferencePath,
    pace: &Pace,
    line: Option<f64>,
    start_x: f64,
    interval_s: f64,
    intervals: usize,
    references: &mut Vec<State>,
) -> Control {
    references.clear();
    let mut x = start_x;
    let step = interval_s / STEPS as f64;
    for _ in 0..intervals {
        for _ in 0..STEPS {
            let direction = if line.is_some() { 0.0 } else { reference_path.at(x).1 };
            x += pace.along(reference_path, x) * direction.cos() * step;
        }
        let (y, direction, curvature) = line.map_or_else(|| reference_path.at(x), |y| (y, 0.0, 0.0));
        references.push(State {
            sideslip: 0.0,
            yaw: direction,
            yaw_rate: curvature * pace.along(reference_path, x),
            x,
            y,
        });
    }
    Control { velocity: pace.along(reference_path, start_x), steering: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn references(start_x: f64) -> (Vec<State>, Control) {
        let pace = Pace { cruise: 1.0, slowest: 0.1, goal_x: 10.0, landing_time: 0.8 };
        let (mut reference_path, mut states) = (ReferencePath::default(), Vec::new());
        reference_path.set_line(start_x, 0.3, 1.0);
        let control = fill(&reference_path, &pace, None, start_x, 0.4, 5, &mut states);
        (states, control)
    }

    #[test]
    fn far_from_the_goal_the_point_moves_at_cruising_velocity() {
        let (states, control) = references(2.0);
        assert!((states[4].x - 4.0).abs() < 1e-12 && states[4].y == 0.3);
        assert_eq!(control.velocity, 1.0);
    }

    #[test]
    fn near_the_goal_the_point_slows_down_to_the_smallest_velocity() {
        let (states, control) = references(9.6);
        assert!((control.velocity - 0.5).abs() < 1e-12);
        assert!(states[0].x > 9.6 && states[4].x > 9.9 && states[4].x < 10.1);
        let (behind, _) = references(10.2);
        assert!((behind[4].x - 10.4).abs() < 1e-12);
    }
}
