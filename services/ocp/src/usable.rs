//! Validity of problems and guesses: everything finite, of fitting length and in order.

use vehicle::{Control, State};

use crate::node_frame::NodeFrame;
use crate::problem::{Problem, Trajectory};

/// The largest number of intervals.
pub(crate) const MAX_INTERVALS: usize = 200;

/// Whether everything is finite, of fitting length and in order.
pub(crate) fn is_usable(problem: &Problem, guess: &Trajectory) -> bool {
    let count = problem.intervals.len();
    let bounds = &problem.bounds;
    let weights = &problem.weights;
    let positive = |value: f64| value > 0.0 && value.is_finite();
    let natural = |value: f64| value >= 0.0 && value.is_finite();
    (1..=MAX_INTERVALS).contains(&count)
        && problem.intervals.iter().all(|&length| positive(length))
        && problem.model.is_sound()
        && positive(bounds.velocity_min_mps)
        && bounds.velocity_max_mps.is_finite()
        && bounds.velocity_max_mps >= bounds.velocity_min_mps
        // The model divides by the tangent's range: steering stays below a right angle.
        && natural(bounds.steering_max_rad)
        && bounds.steering_max_rad < 1.5
        && bounds.sideslip_max_rad >= 0.0
        && bounds.yaw_max_rad >= 0.0
        && bounds.yaw_rate_max_radps >= 0.0
        && problem.x_range[0] <= problem.x_range[1]
        && problem.y_range[0] <= problem.y_range[1]
        && problem.initial.is_finite()
        && problem.previous.is_none_or(|control| control.is_finite())
        && problem.references.len() == count
        && problem.references.iter().all(State::is_finite)
        && problem.control_reference.is_finite()
        && (problem.frames.is_empty() || problem.frames.len() == count)
        && problem.frames.iter().all(NodeFrame::is_usable)
        && weights.node.iter().chain(&weights.terminal).all(|&weight| natural(weight))
        && weights.control.iter().chain(&weights.change).all(|&weight| natural(weight))
        && weights.goal.iter().all(|(_, weight)| natural(*weight))
        && natural(weights.slack_linear)
        && natural(weights.slack_quadratic)
        && problem.ellipses.iter().all(|ellipse| {
            positive(ellipse.a)
                && positive(ellipse.b)
                && ellipse.centres.len() == count + 1
                && ellipse.centres.iter().flatten().all(|value| value.is_finite())
        })
        && guess.states.iter().all(State::is_finite)
        && guess.controls.iter().all(Control::is_finite)
}
