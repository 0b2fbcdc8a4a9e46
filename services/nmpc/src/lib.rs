//! The controller of the robot: from pose and obstacles to one verified command per scan.
//!
//! A lattice search proposes on which side each obstacle is passed. The crate `ocp` solves the optimal control problem,
//! which keeps the plan outside of the ellipses, (7.34), and near the line to the goal or along the course. Every plan is
//! verified before it is driven. [`Controller`] holds the order of these decisions;
//! [`ControllerStage`] is the stage of the loop around it.

mod blocking;
mod braking;
mod by_person;
mod config;
mod contest;
mod controller;
mod ellipses;
mod escape;
mod explicit_side;
mod frames;
mod gear;
#[cfg(test)]
#[path = "../tests/common/independent.rs"]
mod independent;
#[cfg(test)]
mod injection;
mod landing;
mod lattice;
mod margin;
mod memory;
mod movers;
mod obstacle_cost;
mod planner;
mod predicted_obstacle;
mod query;
mod reference;
mod reference_path;
mod rehearsal;
mod rollout;
mod sampled;
mod scene;
mod side;
mod sights;
mod smoothing;
mod stage;
mod start;
mod state;
mod stop_rule;
mod verify;
mod warm;
mod way_back;
mod weights;

pub use braking::speed_limit;
pub use config::{ControllerConfig, ControllerProfile, MarginSettings, PersonMargin, SideRule, StopSettings};
pub use controller::{Controller, ShapedBy, Shaping, StopNumber};
pub use ocp::Budget;
pub use reference_path::LatticeSettings;
pub use side::Side;
pub use stage::ControllerStage;
pub use state::ControllerState;
pub use warm::shift;
pub use weights::WeightSettings;
