//! What a path is searched for, and among which obstacles.

use vehicle::State;

use crate::predicted_obstacle::PredictedObstacle;
use crate::side::Sides;

/// What a guide is searched for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query<'a> {
    /// State at the start of the plan.
    pub(crate) start: State,
    /// The line y = `line` that the path keeps to where it can [m].
    pub(crate) line: f64,
    /// Position along the track where the path ends at the latest [m].
    pub(crate) goal_x: f64,
    /// Bounds of the lateral position, (7.46) [m].
    pub(crate) y_range: [f64; 2],
    /// Largest curvature the robot can steer [1/m].
    pub(crate) curvature: f64,
    /// Distance that is kept to the ellipses [m].
    pub(crate) margin: f64,
    /// Velocity along the path [m/s].
    pub(crate) speed: f64,
    /// The obstacles.
    pub(crate) predicted: &'a [PredictedObstacle],
    /// Sides on which they were passed before.
    pub(crate) sides: &'a Sides,
}
