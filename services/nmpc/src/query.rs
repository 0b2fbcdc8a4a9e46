//! The task of a lattice search.

use crate::scene::Scene;
use crate::side::Sides;

/// What a reference path is searched for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query<'a> {
    /// Start, obstacles, goal and bounds.
    pub(crate) scene: Scene<'a>,
    /// Velocity along the path [m/s].
    pub(crate) speed: f64,
    /// Distance that the path keeps in addition to the margin [m]; with zero, a robot that is nearer may stay so near.
    pub(crate) spare_m: f64,
    /// Sides on which the obstacles were passed before.
    pub(crate) sides: &'a Sides,
}
