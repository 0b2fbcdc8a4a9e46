//! One run from its start to its end: a loop that observes the processes, decides, and publishes the directive.

pub mod adopt;
pub mod arguments;
mod companion_swaps;
pub mod control;
pub mod orphaned;
mod own_processes;
mod process_registry;
mod results;
pub mod run;
mod run_recorder;
mod service_manager;
mod session;
pub mod start;
pub mod startup;
mod survivors;
mod top_view;
mod vitals;

pub use own_processes::companion_delays;
pub use process_registry::driven_system;
pub use session::Session;
