//! Scan to command as plain calls in one process: read this first.
//!
//! ```text
//! robot -> odometry -> estimator -> pose -+-> obstacles -> ellipses -> controller -> command -> actuator
//!      \-> scan --------------------------+                                              |
//!      <------------------------------ actuation <--------------------------------------+
//! ```
//!
//! [`Pipeline::step`] runs this loop once in simulated time. In lock-step, the processes of a system make the same
//! calls with a bus between them and give bit-identical outputs. The difference in run time is the cost of separate
//! processes.

mod drive;
pub mod profile;
mod settings;
mod way_to_rest;

pub use drive::{DriveResult, drive};
pub use settings::{PipelineSettings, Tuning};
pub use way_to_rest::WayToRest;

use actuation::Actuator;
use emulator::Emulator;
use estimator::Estimator;
use nmpc::{Budget, Controller};
use obstacles::ObstacleDetector;
use shared_types::{
    Actuation, Command, Header, Obstacles, Odometry, Pose, Role, Sample, Scan, StageStamps, Truth,
};
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

/// All five stages.
pub struct Pipeline {
    emulator: Emulator,
    estimator: Estimator,
    detector: ObstacleDetector,
    controller: Controller,
    actuator: Actuator,
    iterations: u32,
    scan_id: u64,
    step: Box<Step>,
}

impl Pipeline {
    /// A robot at its start, and four stages without any input yet.
    ///
    /// # Errors
    /// The first setting that is not allowed.
    pub fn new(settings: &PipelineSettings) -> Result<Self, Invalid> {
        let PipelineSettings { scenario, tuning, period_ns } = settings;
        let tuning = tuning.clone().for_scenario(scenario);
        Ok(Self {
            emulator: Emulator::new(scenario, *period_ns),
            estimator: Estimator::new(&tuning.estimator).map_err(|error| error.within("estimator"))?,
            detector: ObstacleDetector::new(tuning.obstacles).map_err(|error| error.within("obstacles"))?,
            iterations: tuning.controller.budget_iterations,
            controller: Controller::new(tuning.controller).map_err(|error| error.within("controller"))?,
            actuator: Actuator::new(tuning.actuator, *period_ns).map_err(|error| error.within("actuator"))?,
            scan_id: 0,
            step: Box::default(),
        })
    }

    /// One scan: measure, estimate, describe, control, actuate.
    pub fn step(&mut self) -> &Step {
        self.scan_id += 1;
        let now_ns = self.emulator.scan_ready_ns(self.scan_id);
        let publish = Publisher { sequence: self.scan_id, now_ns };
        let step = &mut *self.step;
        (step.pose, step.obstacles, step.command, step.actuation) = (None, None, None, None);

        self.emulator.advance_to(now_ns);
        self.emulator.measure(self.scan_id, &mut step.scan, &mut step.odometry, &mut step.truth);
        let acquired_ns = self.emulator.stamp_ns(self.scan_id);
        for header in [&mut step.scan.header, &mut step.odometry.header, &mut step.truth.header] {
            *header = Header { scan_id: self.scan_id, acquired_ns, ..Header::default() };
        }
        publish.complete(Role::Robot, &mut step.scan);
        publish.complete(Role::Robot, &mut step.odometry);
        publish.complete(Role::Robot, &mut step.truth);

        let Some(mut pose) = self.estimator.step(&step.odometry, None, now_ns) else { return step };
        publish.complete(Role::Estimator, &mut pose);
        step.pose = Some(pose);

        let mut obstacles = self.detector.step(&step.scan, &pose);
        publish.complete(Role::Obstacles, &mut obstacles);
        step.obstacles = Some(obstacles);

        let mut command = self.controller.step(&pose, &obstacles, &Budget::Iterations(self.iterations));
        publish.complete(Role::Controller, &mut command);
        step.command = Some(command);
        step.active_ellipses = self.controller.active_ellipses();

        let mut actuation = self.actuator.answer(&command, now_ns);
        publish.complete(Role::Actuator, &mut actuation);
        step.actuation = Some(actuation);

        self.estimator.note(&actuation, now_ns);
        self.emulator.actuate(&actuation);
        step
    }
}

/// Completes headers as the bus does: one incarnation per role, one sample per topic and scan, simulated stamps.
struct Publisher {
    sequence: u64,
    now_ns: u64,
}

impl Publisher {
    fn complete<S: Sample>(&self, role: Role, sample: &mut S) {
        let header = sample.header_mut();
        header.layout = S::LAYOUT;
        header.incarnation = incarnation(role);
        header.sequence = self.sequence;
        let now = self.now_ns;
        *header.stage_mut(role) =
            StageStamps { woken_ns: now, taken_ns: now, computed_ns: now, published_ns: now };
    }
}

/// The incarnation of the first process of a role: the supervisor starts the roles from the actuator backwards.
fn incarnation(role: Role) -> u32 {
    5 - role as u32
}
