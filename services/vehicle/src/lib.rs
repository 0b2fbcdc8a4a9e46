//! The robot as pure functions: model, bounds, integration, frames, body geometry, command correction.
//!
//! Nothing here knows processes, clocks or files. The model is by default the single-track model of a robot whose front
//! and rear axle steer by the same angle in opposite directions, (7.27)-(7.31); [`VehicleModel`] has the others.

pub mod bounds;
pub mod correction;
pub mod course;
mod description;
mod differential;
pub mod frame;
pub mod geometry;
mod goal;
pub mod integrate;
mod lag;
pub mod lateral;
pub mod model;
pub mod network;
mod parameters;
mod scanner;
mod single_track;
mod slipping;
mod state;
mod track;
pub mod tyre;
mod vehicle_model;

pub use bounds::Bounds;
pub use course::Course;
pub use description::{Description, MAX_ON_THE_WAY, SCANNER_YAW_MAX_RAD};
pub use goal::{Goal, Goals};
pub use key_table::{
    Ascending, Documented, Invalid, Key, KeyRule, Setting, did_you_mean, of_text, parse, read, require,
    schema_of, set_range, settings, text_of, toml_fault, toml_text,
};
pub use lag::{Lag, slid};
pub use parameters::Parameters;
pub use scanner::ScannerDescription;
pub use state::{Control, SIDEWAYS_RAD, State};
pub use track::{Surroundings, Track};
pub use vehicle_model::VehicleModel;
