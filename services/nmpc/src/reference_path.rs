//! The proposed path: a path past all obstacles in sight that the robot can steer.
//!
//! The solution of the optimal control problem is local: the first guess decides on which side an obstacle is passed. So a
//! search over the range of the scanner finds a path, which gives the sides and the guess. It is driven itself only where
//! a narrow place has to be passed slowly.
//!
//! The path is made of arcs of equal length along x. The sine of the course changes by curvature times length
//! exactly, so a path is a list of lateral positions and sines.

use vehicle::settings;

use crate::predicted_obstacle::PredictedObstacle;
use crate::side::Passing;

/// In how many places per arc the velocity is limited.
const LIMIT_PIECES: usize = 3;
/// Largest sine of the course.
pub(crate) const SINE_MAX: f64 = 0.8;

settings! {
    /// Settings of the lattice search for the reference path.
    #[derive(Copy)]
    pub struct LatticeSettings {
        /// How far the search looks ahead [m].
        pub range_m: f64 = 6.3, 2.0..=20.0;
        /// Length of one arc of the path along x [m].
        pub step_m: f64 = 0.45, 0.1..=1.0;
        /// Fraction of the largest curvature that the path may use; the rest is left for corrections.
        pub curvature_share: f64 = 0.95, 0.5..=1.0;
        /// Weight of the squared distance to the line through the goal, per metre of the path [1/m^3].
        pub lateral_weight: f64 = 1.0, 0.0..=100.0;
        /// Weight of the squared curvature, per metre of the path [m].
        pub curvature_weight: f64 = 3.0, 0.0..=100.0;
        /// Weight of the squared sine of the course angle, per metre of the path [1/m].
        pub course_weight: f64 = 0.1, 0.0..=100.0;
        /// Extra distance to an ellipse that is worth a detour [m].
        pub comfort_m: f64 = 0.20, 0.0..=0.5;
        /// Weight of each metre by which the path misses `comfort_m`, per metre of the path [1/m^2].
        pub comfort_weight: f64 = 30.0, 0.0..=100.0;
        /// Cost of a path that passes an obstacle on another side than the one chosen before.
        pub switch_cost: f64 = 1.0, 0.0..=100.0;
        /// Weight of the squared lateral distance at the goal [1/m^2].
        pub goal_weight: f64 = 20.0, 0.0..=100.0;
    }
}

/// A path y(x) of arcs from the start of the plan.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct ReferencePath {
    pub(crate) start_x: f64,
    pub(crate) step: f64,
    pub(crate) y: Vec<f64>,
    pub(crate) sine: Vec<f64>,
    /// Velocity that the path was searched for [m/s].
    pub(crate) speed: f64,
    /// Largest velocity at each of its points [m/s]; empty where `speed` holds everywhere.
    pub(crate) limits: Vec<f64>,
    /// Whether the path enters no ellipse (deeper than now) and leaves no bound.
    pub(crate) clear: bool,
    /// Whether the path passes the goal farther away than its tolerance.
    pub(crate) misses_goal: bool,
}

impl ReferencePath {
    /// Makes this the line y = `line`, clear by definition.
    pub(crate) fn set_line(&mut self, start_x: f64, line: f64, speed: f64) {
        self.y.clear();
        self.sine.clear();
        self.limits.clear();
        self.y.push(line);
        self.sine.push(0.0);
        (self.start_x, self.step, self.speed, self.clear) = (start_x, 1.0, speed, true);
        self.misses_goal = false;
    }

    /// Lateral position [m], course [rad] and curvature [1/m] at `x`; behind its end the path continues along x.
    pub(crate) fn at(&self, x: f64) -> (f64, f64, f64) {
        let Some(&end) = self.y.last() else { return (0.0, 0.0, 0.0) };
        let (along, last) = ((x - self.start_x) / self.step, self.y.len() - 1);
        if last == 0 || along >= last as f64 || along.is_nan() {
            return (end, 0.0, 0.0);
        }
        let index = along.max(0.0) as usize;
        let (from, to) = (self.sine[index], self.sine[index + 1]);
        let curvature = (to - from) / self.step;
        let sine =
            (from + curvature * (x - self.start_x - index as f64 * self.step)).clamp(-SINE_MAX, SINE_MAX);
        (
            self.y[index] + rise(from, sine, x - self.start_x - index as f64 * self.step),
            sine.asin(),
            curvature,
        )
    }

    /// Smallest velocity along the path [m/s].
    pub(crate) fn slowest(&self) -> f64 {
        self.limits
            .iter()
            .fold(self.speed.max(*self.limits.first().unwrap_or(&0.0)), |slowest, limit| slowest.min(*limit))
    }

    /// Largest velocity at `x` [m/s].
    pub(crate) fn speed_at(&self, x: f64) -> f64 {
        let Some(last) = self.limits.len().checked_sub(1) else { return self.speed };
        let along = ((x - self.start_x) / self.step).clamp(0.0, last as f64);
        let (index, share) = (along as usize, along.fract());
        let next = self.limits[(index + 1).min(last)];
        self.limits[index] + share * (next - self.limits[index])
    }

    /// Smallest velocity from `x` on over `length` metres [m/s].
    pub(crate) fn speed_over(&self, x: f64, length: f64) -> f64 {
        let pieces = (length / self.step * 2.0).ceil().max(1.0);
        (0..=pieces as usize)
            .map(|piece| self.speed_at(x + length * piece as f64 / pieces))
            .fold(f64::INFINITY, f64::min)
    }

    /// Sets the velocities along a path that was searched for the slowest one: at each point as fast as `allowed` says,
    /// and slowing down in time.
    pub(crate) fn set_limits(&mut self, deceleration_mps2: f64, allowed: impl Fn(f64, f64, f64) -> f64) {
        let mut limits = std::mem::take(&mut self.limits);
        limits.clear();
        limits.resize(self.y.len(), f64::INFINITY);
        for piece in 0..LIMIT_PIECES * self.y.len() {
            let (index, x) =
                (piece / LIMIT_PIECES, self.start_x + piece as f64 * self.step / LIMIT_PIECES as f64);
            let (y, course, _) = self.at(x);
            let limit = allowed(x, y, course);
            // It holds at both ends of the arc.
            for end in [index, (index + 1).min(self.y.len() - 1)] {
                limits[end] = limits[end].min(limit);
            }
        }
        for index in (0..limits.len().saturating_sub(1)).rev() {
            let next = limits[index + 1];
            let reachable = (next * next + 2.0 * deceleration_mps2 * self.step).sqrt();
            limits[index] = limits[index].min(reachable);
        }
        self.limits = limits;
    }

    /// Side on which the path passes the obstacle; `None` when it does not get there.
    pub(crate) fn side_of(&self, obstacle: &PredictedObstacle) -> Option<Passing> {
        let (mut before, mut position) = (f64::NAN, self.start_x);
        for (index, &y) in self.y.iter().enumerate() {
            let t = index as f64 * self.step / self.speed;
            let [centre_x, centre_y] = obstacle.centre_at(t);
            let after = position - centre_x;
            if before < 0.0 && after >= 0.0 {
                let share = -before / (after - before);
                let crossing = self.y[index - 1] + share * (y - self.y[index - 1]);
                return Some(Passing::of(crossing, centre_y));
            }
            before = after;
            position += self.step;
        }
        None
    }
}

/// Lateral rise of an arc of `length` along x between two sines of the course.
pub(crate) fn rise(from: f64, to: f64, length: f64) -> f64 {
    // (cos from - cos to) / curvature, in the form that holds for curvature zero as well.
    let (cos_from, cos_to) = ((1.0 - from * from).sqrt(), (1.0 - to * to).sqrt());
    length * (from + to) / (cos_from + cos_to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rise_of_an_arc_is_that_of_the_circle() {
        // Quarter of the way round a circle of radius 2: from course 0 to sine 0.5 over 1 m.
        let expected = 2.0 * (1.0 - 0.75_f64.sqrt());
        assert!((rise(0.0, 0.5, 1.0) - expected).abs() < 1e-12);
        assert!((rise(0.6, 0.6, 1.0) - 0.75).abs() < 1e-12);
    }

    #[test]
    fn a_line_continues_for_ever() {
        let mut reference_path = ReferencePath::default();
        reference_path.set_line(2.0, 0.3, 1.0);
        assert_eq!(reference_path.at(1.0), (0.3, 0.0, 0.0));
        assert_eq!(reference_path.at(50.0), (0.3, 0.0, 0.0));
    }
}
