//! The optimal control problem of the benchmark: the published setting, not that of a run.
//!
//! With N = 6 node weights of (sideslip, yaw, yaw rate, x, y) are (0.1, 0.2, 0.1, 1, 1), at the end (0.1, 0.2, 0.1, 5,
//! 5), those of the controls (0.5, 5) about (0.9, 0), no weights on changes; one ellipse without margin; horizon 2.72
//! s. With another N the horizon stays, and node and control weights are multiplied by 6 / N, so that their sums
//! approximate the same integral. The weights at the end stay, because the end is one point for every N. Those of the
//! slacks stay too: a trajectory touches the ellipse at a few nodes for any N, and the penalty must exceed the
//! multipliers there.
//!
//! The reference moves from the robot to the goal at the velocity limit, so the robot can always reach it.

use std::sync::Arc;

use ocp::{Collocation, EllipsePath, Problem, Trajectory, Weights, roll_out};
use vehicle::{Bounds, Control, Parameters, State};

/// Length of the horizon, tf [s].
pub const HORIZON_S: f64 = 2.72;
/// Time between consecutive states of a lap [s].
pub const PERIOD_S: f64 = 0.1;
/// The number of intervals of the published weights.
const PUBLISHED_INTERVALS: f64 = 6.0;
/// Reference of the controls.
const CRUISE: Control = Control { velocity: 0.9, steering: 0.0 };

/// A static ellipse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StaticEllipse {
    /// Centre along the track [m].
    pub x: f64,
    /// Centre across the track [m].
    pub y: f64,
    /// Semi-axis along the track [m].
    pub a: f64,
    /// Semi-axis across the track [m].
    pub b: f64,
}

/// One initial state with obstacle and goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Line in the file.
    pub line: usize,
    /// State at node 0.
    pub state: State,
    /// The goal [m].
    pub goal: [f64; 2],
    /// The obstacle.
    pub obstacle: StaticEllipse,
    /// Consecutive cases of the same lap are a period apart; `None` belongs to no lap.
    pub lap: Option<u64>,
}

impl Default for Case {
    fn default() -> Self {
        let obstacle = StaticEllipse { x: 5.0, y: 0.1, a: 1.2, b: 0.8 };
        Self { line: 0, state: State::default(), goal: [10.0, 0.0], obstacle, lap: None }
    }
}

/// The problem of a case with `count` intervals.
pub fn problem(case: &Case, count: usize) -> Problem {
    let bounds = Bounds::default();
    let interval = HORIZON_S / count as f64;
    let share = PUBLISHED_INTERVALS / count as f64;
    let ahead = |node: usize| case.state.x + node as f64 * interval * bounds.velocity_max_mps;
    let StaticEllipse { x, y, a, b } = case.obstacle;
    Problem {
        model: Arc::new(Parameters::default()),
        bounds,
        x_range: [0.0, 22.0],
        y_range: [-1.5, 1.5],
        intervals: vec![interval; count],
        initial: case.state,
        previous: None,
        references: (1..=count)
            .map(|node| State { x: ahead(node).min(case.goal[0]), y: case.goal[1], ..State::default() })
            .collect(),
        control_reference: CRUISE,
        weights: Weights {
            node: [0.1, 0.2, 0.1, 1.0, 1.0].map(|weight| weight * share),
            terminal: [0.1, 0.2, 0.1, 5.0, 5.0],
            control: [0.5, 5.0].map(|weight| weight * share),
            change: [0.0, 0.0],
            slack_linear: 100.0,
            slack_quadratic: 100.0,
            goal: [(0, 0.0); 2],
        },
        ellipses: vec![EllipsePath { a, b, centres: vec![[x, y]; count + 1] }],
        frames: Vec::new(),
    }
}

/// The start of a case: the controls of `before`, a solution one period earlier, shifted in time, or straight on at the
/// reference velocity without one; and the states of the model with these controls from the present state on.
///
/// Without states where the model has no solution for them; a solver then starts as without a guess.
pub fn guess(problem: &Problem, collocation: &Collocation, before: Option<&Trajectory>) -> Trajectory {
    let count = problem.intervals.len();
    let mut controls = vec![CRUISE; count];
    if let Some(before) = before {
        nmpc::shift(&before.controls, problem.intervals[0], PERIOD_S, &mut controls);
    }
    roll_out(problem.model.as_ref(), collocation, &problem.initial, &controls, &problem.intervals)
        .unwrap_or(Trajectory { states: Vec::new(), controls })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn with_six_intervals_the_weights_are_the_published_ones() {
        let problem = problem(&Case::default(), 6);
        assert_eq!(problem.weights.node, [0.1, 0.2, 0.1, 1.0, 1.0]);
        assert_eq!(problem.weights.control, [0.5, 5.0]);
        assert!((problem.intervals[0] - 0.453_333).abs() < 1e-6);
        assert_eq!(problem.ellipses[0].centres.len(), 7);
    }

    #[test]
    fn the_sum_of_weights_does_not_depend_on_the_number_of_intervals() {
        for count in [6, 24, 96] {
            let problem = problem(&Case::default(), count);
            // One unit of distance along the whole horizon costs 6 times the published weight.
            assert!((problem.weights.node[4] * count as f64 - 6.0).abs() < 1e-12);
            assert_eq!(problem.weights.terminal[4], 5.0);
        }
    }

    #[test]
    fn the_reference_is_never_out_of_reach_nor_beyond_the_goal() {
        let near = Case { state: State { x: 8.5, ..State::default() }, ..Case::default() };
        let references = problem(&near, 6).references;
        assert!((references[0].x - (8.5 + 2.72 / 6.0)).abs() < 1e-12);
        assert_eq!(references[5].x, 10.0);
    }

    #[test]
    fn controls_move_on_by_a_share_of_an_interval_or_by_several() {
        let controls = [1.0, 0.6, 0.2].map(|velocity| Control { velocity, steering: 0.0 });
        let shifted = |intervals: f64| {
            let mut shifted = Vec::new();
            nmpc::shift(&controls, 1.0, intervals, &mut shifted);
            shifted.iter().map(|control| control.velocity).collect::<Vec<f64>>()
        };
        let (quarter, one_and_half) = (shifted(0.25), shifted(1.5));
        assert!((quarter[0] - 0.9).abs() < 1e-12 && (quarter[1] - 0.5).abs() < 1e-12 && quarter[2] == 0.2);
        assert!((one_and_half[0] - 0.4).abs() < 1e-12 && one_and_half[1] == 0.2);
    }
}
