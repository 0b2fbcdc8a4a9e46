//! Random courses for campaigns, and the judge of what was driven on them.
//!
//! It knows the true geometry and the true robot, and nothing of the stages. A course need not be passable:
//! [`feasible`] finds out whether there is a way, and [`judge`] whether a stop was right.

pub mod course;
pub mod feasible;
pub mod judge;
mod way_to_rest;

pub use way_to_rest::WayToRest;
