//! One run from its start to its end: a loop that watches, decides and speaks.

pub mod adopt;
pub mod arguments;
pub mod beginning;
pub mod control;
mod directives;
pub mod driverless;
mod results;
mod roster;
pub mod run;
mod service_manager;
mod session;
pub mod start;
mod survivors;
mod vitals;

pub use session::Session;
