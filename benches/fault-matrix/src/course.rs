//! The drive in which faults are injected, and where its phases begin.

use emulator::Scenario;
use faults::DrivePhase;
use pipeline::PipelineSettings;
use shared_types::{Role, Truth};

/// The course: the shipped corridor, shortened.
const COURSE: &str = include_str!("course.toml");
/// The course of [`DrivePhase::Bend`].
const BEND: &str = include_str!("bend.toml");
/// The course of [`DrivePhase::Reverse`].
const REVERSE: &str = include_str!("reverse.toml");
/// The robot drives backwards from this velocity on [m/s].
const REVERSE_MPS: f64 = -0.2;
/// The robot is in the bend from this direction on [rad].
const IN_BEND_RAD: f64 = 0.3;
/// Full speed is reached from here on [m].
const STRAIGHT_M: f64 = 1.6;
/// Distance of the centre to that of the obstacle from which on the robot is beside it [m].
const BESIDE_M: f64 = 0.25;
/// Distance to the goal at which the landing begins [m].
const LANDING_M: f64 = 0.8;
/// Where the swap is requested [m]: the fault begins while the new process computes in shadow.
const SWAP_M: f64 = 1.0;
/// Scans from the request of a swap to the fault.
pub(crate) const SHADOWED: u64 = 6;
/// Where a person takes over [m].
const PERSON_M: f64 = 1.0;
/// What the person asks for [m/s]: the robot is behind the obstacle to the end of a cell with real processes.
pub const BY_HAND_MPS: f64 = 0.3;
/// Scans that the person drives before the fault.
pub(crate) const BY_HAND: u64 = 6;
/// Scans that the person drives at all, before the controller drives again.
pub(crate) const HANDS_BACK: u64 = 14;
/// Scans that outlast a cell with real processes, in which the person does not hand back.
pub(crate) const OUTLASTS: u64 = 60;

/// The scenario that is driven.
///
/// # Panics
/// Never: a test reads it.
pub fn scenario() -> Scenario {
    Scenario::parse(COURSE, "course.toml").unwrap_or_default()
}

/// Scenario and default settings of all stages.
pub fn settings() -> PipelineSettings {
    PipelineSettings::of(scenario())
}

/// The same on the course of a phase.
///
/// # Panics
/// Never: a test reads it.
pub fn settings_of(phase: DrivePhase) -> PipelineSettings {
    let read = |text, name| PipelineSettings::of(Scenario::parse(text, name).unwrap_or_default());
    match phase {
        DrivePhase::Bend => read(BEND, "bend.toml"),
        DrivePhase::Reverse => read(REVERSE, "reverse.toml"),
        _ => settings(),
    }
}

/// The table of settings of the stage of a role, as TOML; `None` for the robot.
pub fn stage_settings(role: Role) -> Option<String> {
    let PipelineSettings { scenario, tuning, .. } = settings();
    let tuning = tuning.for_scenario(&scenario);
    match role {
        Role::Robot => None,
        Role::Estimator => toml::to_string(&tuning.estimator).ok(),
        Role::Obstacles => toml::to_string(&tuning.obstacles).ok(),
        Role::Controller => toml::to_string(&tuning.controller).ok(),
        Role::Actuator => toml::to_string(&tuning.actuator).ok(),
    }
}

/// The scenario of a cell with real processes: the same course from a place just before the phase.
pub fn live_scenario(phase: DrivePhase) -> Scenario {
    let mut scenario = scenario();
    match phase {
        DrivePhase::Bend | DrivePhase::Reverse => scenario = settings_of(phase).scenario,
        DrivePhase::Start | DrivePhase::Straight | DrivePhase::Swap | DrivePhase::Person => {}
        DrivePhase::Beside => (scenario.start.x_m, scenario.start.y_m) = (2.7, 0.75),
        DrivePhase::Landing => scenario.start.x_m = scenario.goal.last().x_m - 2.0,
    }
    scenario
}

/// Whether a phase begins with the scan after this one; for [`DrivePhase::Swap`] and [`DrivePhase::Person`] the request. All
/// lengths of the course are `scale` times as large.
pub fn begins(phase: DrivePhase, settings: &PipelineSettings, scale: f64, truth: &Truth) -> bool {
    let PipelineSettings { scenario, tuning, .. } = settings;
    let at_m = truth.x_m / scale;
    let first_m = scenario.obstacles.first().map(|body| body.x_m / scale);
    match phase {
        DrivePhase::Start => true,
        DrivePhase::Straight => at_m >= STRAIGHT_M,
        DrivePhase::Beside => first_m.is_some_and(|first_m| at_m >= first_m - BESIDE_M),
        DrivePhase::Bend => truth.yaw_rad >= IN_BEND_RAD,
        DrivePhase::Reverse => {
            truth.speed_mps <= REVERSE_MPS.max(-0.75 * tuning.vehicle.bounds.reverse_max_mps)
        }
        DrivePhase::Landing => truth.goal_distance_m / scale <= LANDING_M,
        DrivePhase::Swap => at_m >= SWAP_M,
        DrivePhase::Person => at_m >= PERSON_M,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_course_is_allowed_and_has_an_obstacle() {
        let scenario = Scenario::parse(COURSE, "course.toml").unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((scenario.obstacles.len(), scenario.name.as_str()), (1, "faults"));
        let bend = Scenario::parse(BEND, "bend.toml").unwrap_or_else(|error| panic!("{error}"));
        assert!(bend.course.is_some() && bend.obstacles.len() == 1);
        assert!(
            settings_of(DrivePhase::Reverse).scenario.course.is_some_and(|course| course.legs().len() == 3)
        );
        for phase in DrivePhase::ALL {
            assert_eq!(live_scenario(phase).validate(), Ok(()), "{phase}");
        }
    }
}
