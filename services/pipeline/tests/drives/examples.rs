//! The vehicles of `examples/vehicles`, on courses of their size.

use emulator::scenario::Preset;
use emulator::{Outcome, Scenario};
use pipeline::{PipelineSettings, Tuning};
use vehicle::correction::Calibration;
use vehicle::{Description, parse, read};

use crate::{End, end, seeds, shipped};

/// What the file of a vehicle makes of a scenario, as the executable reads both.
fn settings(vehicle: &str, mut scenario: Scenario, seed: u64) -> PipelineSettings {
    let path = format!("{}/../../examples/vehicles/{vehicle}.toml", env!("CARGO_MANIFEST_DIR"));
    let file = parse(&std::fs::read_to_string(path).unwrap()).unwrap();
    let described: Description = read(file["vehicle"].as_table().unwrap().clone()).unwrap();
    let described = Description { surroundings: scenario.surroundings(), ..described };
    let cruise = file.get("controller").and_then(|table| table["cruise_mps"].as_float());
    (scenario.robot.preset, scenario.seed) = (Preset::Summit, seed);
    scenario.robot = scenario.robot.resolved(&described, seed);
    let mut tuning = Tuning::of(described);
    let bounds = described.bounds;
    tuning.controller.cruise_mps = cruise.unwrap_or(1.0).min(bounds.velocity_max_mps);
    tuning.actuator.calibration = Calibration::Identity;
    PipelineSettings { tuning, ..PipelineSettings::of(scenario) }
}

/// Drives a course with some seeds; those in which the vehicle touches something or does not arrive.
fn wrong(vehicle: &str, scenario: &Scenario) -> Vec<(u64, End)> {
    let ends = seeds::each(1..=4, |seed| end(&settings(vehicle, scenario.clone(), seed)));
    ends.into_iter().filter(|(_, end)| end.outcome != Outcome::Reached || !end.is_untouched()).collect()
}

#[test]
fn small_vehicles_reach_the_goals_of_shipped_scenarios() {
    let names = ["free", "corridor", "two-obstacles", "slalom", "walls", "noisy", "bend", "s-curve"];
    for vehicle in ["racecar", "turtlebot"] {
        for name in names {
            let wrong = wrong(vehicle, &shipped(name));
            assert!(wrong.is_empty(), "{vehicle} {name}: {wrong:?}");
        }
    }
}

#[test]
fn a_car_reaches_the_end_of_its_yard() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/vehicles/car-yard.toml");
    let yard = Scenario::parse(&std::fs::read_to_string(path).unwrap(), "car-yard").unwrap();
    let wrong = wrong("car", &yard);
    assert!(wrong.is_empty(), "{wrong:?}");
}
