//! The optimal control problem of the benchmark: the published setting, not that of a run.
//!
//! With N = 6 node weights of (sideslip, yaw, yaw rate, x, y) are (0.1, 0.2, 0.1, 1, 1), at the end (0.1, 0.2, 0.1, 5, 5),
//! those of the controls (0.5, 5) about (0.9, 0), no weights on changes; one ellipse without margin; horizon 2.72 s. With
//! another N the horizon stays, and node and control weights are multiplied by 6 / N, so that their sums approximate
//! the same integral. The weights at the end stay, because the end is one point for every N, and so do those of the
//! slacks: a trajectory touches the ellipse at a few nodes however many there are, and the penalty has to exceed what
//! the ellipse costs at those.
//!
//! The reference moves from the robot to the goal at the velocity limit, so it is never out of reach.

use std::sync::Arc;

use ocp::{Collocation, EllipsePath, Problem, Trajectory, Weights, roll_out};
use vehicle::{Bounds, Control, Parameters, State};

/// Length of the horizon, tf [s].
pub const HORIZON_S: f64 = 2.72;
/// Time between consecutive states of a lap [s].
pub const PERIOD_S: f64 = 0.1;
/// The number of intervals that the weights are written down for.
const WEIGHTS_FOR: f64 = 6.0;
/// Reference of the controls.
const CRUISE: Control = Control { velocity: 0.9, steering: 0.0 };

/// An ellipse that stands still.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Centre along the track [m].
    pub x: f64,
    /// Centre across the track [m].
    pub y: f64,
    /// Semi-axis along the track [m].
    pub a: f64,
    /// Semi-axis across the track [m].
    pub b: f64,
}

/// One initial state with what there is to drive around and to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Line in the file.
    pub line: usize,
    /// State at node 0.
    pub state: State,
    /// Where to go [m].
    pub goal: [f64; 2],
    /// What is in the way.
    pub obstacle: Ellipse,
    /// Consecutive cases of the same lap are a period apart; `None` belongs to no lap.
    pub lap: Option<u64>,
}

impl Default for Case {
    fn default() -> Self {
        let obstacle = Ellipse { x: 5.0, y: 0.1, a: 1.2, b: 0.8 };
        Self { line: 0, state: State::default(), goal: [10.0, 0.0], obstacle, lap: None }
    }
}

/// The problem of a case with `count` intervals.
pub fn problem(case: &Case, count: usize) -> Problem {
    let bounds = Bounds::default();
    let interval = HORIZON_S / count as f64;
    let share = WEIGHTS_FOR / count as f64;
    let ahead = |node: usize| case.state.x + node as f64 * interval * bounds.velocity_max_mps;
    let Ellipse { x, y, a, b } = case.obstacle;
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
        },
        ellipses: vec![EllipsePath { a, b, centres: vec![[x, y]; count + 1] }],
    }
}

/// The start of a case: `before`, a solution one period earlier, moved on in time and driven through the model from
/// the present state; or straight on at the reference velocity, where there is none.
///
/// No states where the model has no solution for them; a solver then does what it does without a guess.
pub fn guess(problem: &Problem, collocation: &Collocation, before: Option<&Trajectory>) -> Trajectory {
    let count = problem.intervals.len();
    let controls = match before {
        Some(before) => shifted(&before.controls, PERIOD_S / problem.intervals[0]),
        None => vec![CRUISE; count],
    };
    roll_out(problem.model.as_ref(), collocation, &problem.initial, &controls, &problem.intervals)
        .unwrap_or(Trajectory { states: Vec::new(), controls })
}

/// Controls as they are `intervals` later, the mean over each interval's time; the last one is held.
fn shifted(controls: &[Control], intervals: f64) -> Vec<Control> {
    let (whole, share) = (intervals as usize, intervals.fract());
    let at = |index: usize| controls[index.min(controls.len() - 1)];
    (0..controls.len())
        .map(|index| {
            let (early, late) = (at(index + whole), at(index + whole + 1));
            Control {
                velocity: early.velocity + share * (late.velocity - early.velocity),
                steering: early.steering + share * (late.steering - early.steering),
            }
        })
        .collect()
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
        let quarter: Vec<f64> = shifted(&controls, 0.25).iter().map(|control| control.velocity).collect();
        assert!((quarter[0] - 0.9).abs() < 1e-12 && (quarter[1] - 0.5).abs() < 1e-12 && quarter[2] == 0.2);
        let one_and_half: Vec<f64> = shifted(&controls, 1.5).iter().map(|control| control.velocity).collect();
        assert!((one_and_half[0] - 0.4).abs() < 1e-12 && one_and_half[1] == 0.2);
    }
}
