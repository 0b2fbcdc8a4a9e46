//! The ride: how well a drive was driven.
//!
//! [`measure`] turns the true trajectory of a drive into [`Figures`]; the most important one is the objective J, whose
//! weights are fixed in [`objective`]. [`Recording`] collects the trajectory from samples.

mod drive;
mod measure;
pub mod objective;
mod recording;

pub use drive::{Drive, Issued, Moment};
pub use measure::{Figures, measure};
pub use recording::Recording;
