//! Drives of other vehicles than the SUMMIT, each with the body of a small one.

use emulator::Outcome;
use emulator::scenario::Preset;
use pipeline::{PipelineSettings, Tuning};
use vehicle::correction::Calibration;
use vehicle::{Bounds, Description, VehicleModel};

use crate::{end, shipped};

/// A small vehicle whose wheels turn further than the SUMMIT's.
fn described(model: VehicleModel) -> Description {
    let bounds = Bounds {
        steering_max_rad: 0.3,
        sent_steering_max_rad: 0.4,
        sideslip_max_rad: 0.4,
        ..Bounds::default()
    };
    Description { model, bounds, yaw_lag_s: 0.08, ..Description::default() }
}

#[test]
fn each_model_drives_past_obstacles_to_its_goal() {
    for model in [VehicleModel::Bicycle, VehicleModel::Differential, VehicleModel::RearSteered] {
        for name in ["corridor", "slalom", "s-curve", "noisy"] {
            for preset in [Preset::Ideal, Preset::Summit, Preset::Worn] {
                let mut scenario = shipped(name);
                let surroundings = scenario.surroundings();
                let vehicle = Description { surroundings, ..described(model) };
                let vehicle = if preset == Preset::Ideal { vehicle.without_lag() } else { vehicle };
                scenario.robot.preset = preset;
                scenario.robot = scenario.robot.resolved(&vehicle, scenario.seed);
                let mut tuning = Tuning::of(vehicle);
                tuning.actuator.calibration = Calibration::Identity;
                let end = end(&PipelineSettings { tuning, ..PipelineSettings::of(scenario) });
                // A worn robot is not calibrated, and may land beside its goal.
                let is_there = end.outcome == Outcome::Reached || preset == Preset::Worn && end.goal_m < 0.3;
                assert!(is_there, "{model:?} {name} {preset:?}: {end:?}");
                assert!(end.clearance_m > 0.05, "{model:?} {name} {preset:?}: {end:?}");
            }
        }
    }
}
