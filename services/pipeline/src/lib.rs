//! The loop in one process and in simulated time.
//!
//! ```text
//! robot -> odometry -> estimator -> pose -+-> obstacles -> ellipses -> controller -> command -> actuator
//!      \-> scan --------------------------+                                              |
//!      <------------------------------ actuation <--------------------------------------+
//! ```
//!
//! [`Pipeline::step`] runs this loop once. In lock-step, the processes of a system make the same calls to the same
//! stages with a bus between them, and give bit-identical outputs. The difference in run time is the cost of separate
//! processes. [`SimulatedLoop`] is what runs it, also with faults between the stages.

mod drive;
mod node;
pub mod profile;
mod settings;
mod simulation;
mod wire;

pub use drive::{DriveResult, drive};
pub use node::SimulatedWriter;
pub use settings::{PipelineSettings, Tuning};
pub use simulation::{LoopWatch, SimulatedLoop, first_incarnation};
pub use wire::{ActiveChange, Wire};

use std::any::Any;

use nmpc::ControllerStage;
use shared_types::{Actuation, AnySample, AnyStage, Command, Obstacles, Odometry, Pose, Scan, Truth};
use vehicle::Invalid;

/// All samples of one scan.
#[derive(Debug, Clone, Copy, Default)]
pub struct Step {
    /// The sweep.
    pub scan: Scan,
    /// The reported pose.
    pub odometry: Odometry,
    /// The true state.
    pub truth: Truth,
    /// The estimated pose; `None` where the estimator gave none.
    pub pose: Option<Pose>,
    /// The described obstacles.
    pub obstacles: Option<Obstacles>,
    /// The command.
    pub command: Option<Command>,
    /// Ellipse constraints (7.34) that are active in its plan.
    pub active_ellipses: u32,
    /// What was sent to the robot.
    pub actuation: Option<Actuation>,
}

impl LoopWatch for Step {
    fn measured(&mut self, scan: &Scan, odometry: &Odometry, truth: &Truth) {
        (self.scan, self.odometry, self.truth) = (*scan, *odometry, *truth);
        (self.pose, self.obstacles, self.command, self.actuation) = (None, None, None, None);
    }

    fn stepped(&mut self, stage: &dyn AnyStage, output: Option<AnySample<'_>>) {
        let Some(output) = output else { return };
        self.pose = output.get().copied().or(self.pose);
        self.obstacles = output.get().copied().or(self.obstacles);
        self.command = output.get().copied().or(self.command);
        self.actuation = output.get().copied().or(self.actuation);
        if let Some(stage) = (stage as &dyn Any).downcast_ref::<ControllerStage>() {
            self.active_ellipses = stage.controller().active_ellipses();
        }
    }
}

/// All five stages, in lock-step.
pub struct Pipeline {
    simulation: SimulatedLoop,
    step: Box<Step>,
}

impl Pipeline {
    /// A robot at its start, and four stages without any input yet.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn new(settings: &PipelineSettings) -> Result<Self, Invalid> {
        Ok(Self { simulation: SimulatedLoop::new(settings, true)?, step: Box::default() })
    }

    /// One scan: measure, estimate, describe, control, actuate.
    pub fn step(&mut self) -> &Step {
        self.simulation.move_on();
        self.simulation.measure(&mut *self.step);
        self.simulation.settle(&mut *self.step);
        &self.step
    }
}
