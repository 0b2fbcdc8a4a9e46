//! What the optimum drives, and where one of its plans starts.

use vehicle::{Bounds, Control, Goal, Parameters, State};

use super::ellipse::Ellipse;
use report::ride::objective::BEFORE_GOAL_M;

/// What is driven.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Course {
    /// The vehicle.
    pub parameters: Parameters,
    /// Hard bounds of the controls and soft bounds of the lateral state.
    pub bounds: Bounds,
    /// Bounds of the position along the track [m].
    pub x_range: [f64; 2],
    /// Bounds of the lateral position [m].
    pub y_range: [f64; 2],
    /// The goal; its lateral position is the line.
    pub goal: Goal,
    /// When the first drive command acts [s].
    pub start_s: f64,
    /// The state then.
    pub start: State,
    /// The ellipses, with their margin.
    pub ellipses: Vec<Ellipse>,
}

impl Course {
    /// Where the measured part of the drive ends [m].
    pub(crate) fn end_x_m(&self) -> f64 {
        self.goal.x_m - BEFORE_GOAL_M
    }
}

/// Where a plan starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct From {
    pub(crate) time_s: f64,
    pub(crate) state: State,
    pub(crate) previous: Option<Control>,
}
