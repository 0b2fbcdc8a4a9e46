//! Settings of all stages, and what the stages need to know of the scenario.

use emulator::Scenario;
use serde::{Deserialize, Serialize};
use vehicle::{Description, Invalid, Surroundings, Track};

/// Settings of the four stages behind the robot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tuning {
    /// What the stages believe about the robot; each has a copy in its own settings.
    pub vehicle: Description,
    /// Settings of the estimator.
    pub estimator: estimator::EstimatorConfig,
    /// Settings of the obstacle description.
    pub obstacles: obstacles::ObstaclesConfig,
    /// Settings of the controller.
    pub controller: nmpc::ControllerConfig,
    /// Settings of the actuator.
    pub actuator: actuation::ActuatorConfig,
}

impl Tuning {
    /// The default settings of all stages for another robot.
    pub fn of(vehicle: Description) -> Self {
        Self {
            vehicle,
            estimator: estimator::EstimatorConfig { vehicle, ..Default::default() },
            obstacles: obstacles::ObstaclesConfig { vehicle, ..Default::default() },
            controller: nmpc::ControllerConfig { vehicle, ..Default::default() },
            actuator: actuation::ActuatorConfig { vehicle, ..Default::default() },
        }
    }

    /// Checks every number of every stage.
    ///
    /// # Errors
    /// The first setting that is not allowed, with the table it stands in.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.estimator.validate().map_err(|error| error.within("estimator"))?;
        self.obstacles.validate().map_err(|error| error.within("obstacles"))?;
        self.controller.validate().map_err(|error| error.within("controller"))?;
        self.actuator.validate().map_err(|error| error.within("actuator"))
    }

    /// The same with what the stages know of the scenario: the course, and along and across it the goal, the track and its walls.
    ///
    /// Never the obstacles or the true parameters of the robot.
    #[must_use]
    pub fn for_scenario(mut self, scenario: &Scenario) -> Self {
        let track = scenario.track_on_course();
        self.controller.course = scenario.course.clone().unwrap_or_default();
        self.obstacles.course = self.controller.course.clone();
        let goals = scenario.goals_on_course();
        self.controller.goal = goals.first().copied().unwrap_or_default();
        self.controller.next_goals = goals.get(1..).unwrap_or_default().to_vec();
        self.controller.track = track;
        // Where the walls along a course stand is not stated.
        let is_stated = scenario.course.is_none();
        let surroundings = if is_stated { track.surroundings } else { Surroundings::Open };
        self.estimator.track = Track { surroundings, ..track };
        self.obstacles.walls = track.walls;
        self.obstacles.wall_y_m = track.y_m;
        self.obstacles.track_x_m = track.x_m;
        self
    }
}

/// Everything that a run is made from.
#[derive(Debug, Clone, PartialEq)]
pub struct PipelineSettings {
    /// What is driven.
    pub scenario: Scenario,
    /// Settings of the stages, without what they know of the scenario.
    pub tuning: Tuning,
    /// Scan period [ns].
    pub period_ns: u64,
}

impl PipelineSettings {
    /// A scenario with the default settings of all stages, which know its surroundings, at ten scans a second.
    pub fn of(scenario: Scenario) -> Self {
        let surroundings = scenario.surroundings();
        let tuning = Tuning::of(Description { surroundings, ..Description::default() });
        Self { scenario, tuning, period_ns: 100_000_000 }
    }
}
