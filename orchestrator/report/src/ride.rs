//! The ride: how well a drive was driven.
//!
//! [`measure`] turns the true trajectory of a drive into [`RideFigures`]; the most important one is the objective J, whose
//! weights are fixed in [`objective`]. [`RideRecording`] collects the trajectory from samples.

mod drive;
mod measure;
pub mod objective;
mod recording;

pub use drive::{Issued, RideMoment, RideTrace};
pub use measure::{RideFigures, measure};
pub use recording::RideRecording;
