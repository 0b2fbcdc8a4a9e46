//! What is sent to the robot: corrected steering angle and velocity, limits, and the stop that always wins.
//!
//! One command in, one actuation out. Wheels turn only for a command that is new, young, verified, finite and
//! within its hard limits; everything else blocks them. Silence blocks them too, after 1.5 scan periods.

mod actuator;
mod config;
mod stage;
mod state;
mod verdict;

pub use actuator::Actuator;
pub use config::ActuatorConfig;
pub use stage::ActuatorStage;
pub use state::ActuatorState;
