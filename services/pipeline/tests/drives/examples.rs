//! The vehicles of `examples/vehicles`, on courses of their size.

use emulator::scenario::Preset;
use emulator::{Outcome, Scenario};
use pipeline::{PipelineSettings, Tuning};
use vehicle::correction::Calibration;
use vehicle::{Description, parse, read};

use crate::{End, end, seeds, shipped};

/// What the file of a vehicle makes of a scenario, as the executable reads both; `sudden_m` is that of the file if it is `None`.
fn settings(vehicle: &str, mut scenario: Scenario, seed: u64, sudden_m: Option<f64>) -> PipelineSettings {
    let path = format!("{}/../../examples/vehicles/{vehicle}.toml", env!("CARGO_MANIFEST_DIR"));
    let file = parse(&std::fs::read_to_string(path).unwrap()).unwrap();
    let described: Description = read(file["vehicle"].as_table().unwrap().clone()).unwrap();
    let sudden_m = sudden_m.unwrap_or(described.sudden_m);
    let described = Description { surroundings: scenario.surroundings(), sudden_m, ..described };
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
fn wrong(vehicle: &str, scenario: &Scenario, sudden_m: Option<f64>) -> Vec<(u64, End)> {
    let ends = seeds::each(1..=4, |seed| end(&settings(vehicle, scenario.clone(), seed, sudden_m)));
    ends.into_iter().filter(|(_, end)| end.outcome != Outcome::Reached || !end.is_untouched()).collect()
}

#[test]
fn small_vehicles_reach_the_goals_of_shipped_scenarios() {
    let names = ["free", "corridor", "two-obstacles", "slalom", "walls", "noisy", "bend", "s-curve"];
    for vehicle in ["racecar", "turtlebot"] {
        for name in names {
            let wrong = wrong(vehicle, &shipped(name), None);
            assert!(wrong.is_empty(), "{vehicle} {name}: {wrong:?}");
        }
    }
}

/// A scenario beside the vehicles.
fn beside(name: &str) -> Scenario {
    let path = format!("{}/../../examples/vehicles/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    Scenario::parse(&std::fs::read_to_string(path).unwrap(), name).unwrap()
}

#[test]
fn a_car_reaches_the_end_of_its_yard() {
    let wrong = wrong("car", &beside("car-yard"), None);
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// In the bends its tyres slip by 4 degrees, which its odometer does not see.
#[test]
fn a_racecar_ends_three_laps_at_five_metres_a_second() {
    let race = beside("race");
    let wrong = wrong("racecar", &race, Some(4.5));
    assert!(wrong.is_empty(), "{wrong:?}");
    let mut fastest_mps = 0.0_f64;
    let settings = settings("racecar", race, 1, Some(4.5));
    pipeline::drive(&settings, |step| fastest_mps = fastest_mps.max(step.truth.speed_mps)).unwrap();
    assert!(fastest_mps > 4.7, "{fastest_mps}");
}
