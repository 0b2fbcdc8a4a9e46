//! The task of a lattice search.

use crate::scene::Scene;
use crate::side::{Passing, Sides};

/// What a reference path is searched for.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Query<'a> {
    /// Start, obstacles, goal and bounds.
    pub(crate) scene: Scene<'a>,
    /// Velocity along the path [m/s].
    pub(crate) speed: f64,
    /// Whether every centimetre across the track counts.
    pub(crate) narrow: bool,
    /// Sides on which the obstacles were passed before.
    pub(crate) sides: &'a Sides,
    /// The obstacle with this identity is passed on this side in any case.
    pub(crate) forced: Option<(u32, Passing)>,
}
