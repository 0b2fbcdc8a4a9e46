//! The ride: how well a drive was driven, and how well it could have been driven.
//!
//! [`measure`] turns the true trajectory of a drive into [`Figures`]; the most important one is the objective J, whose
//! weights are fixed in [`objective`]. [`optimum`] computes the drive with the least J over the same course, with the
//! solver of the controller over the whole way. It knows an obstacle from the scan that first described it. The ratio
//! of both values of J is the regret of the drive.
//!
//! Everything here is a pure function: [`Recording`] and [`Sightings`] collect what it needs from samples.

mod course;
mod drive;
mod ellipse;
mod guess;
mod measure;
pub mod objective;
pub mod optimum;
mod plan;
mod recording;
mod sides;
mod sightings;

pub use drive::{Drive, Issued, Moment};
pub use ellipse::{Ellipse, Path};
pub use measure::{Figures, measure};
pub use recording::Recording;
pub use sightings::Sightings;
