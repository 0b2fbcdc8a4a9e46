//! After each command of a drive there is a way to rest without contact; and drives with a short budget keep it too.
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;

use courses::WayToRest;
use courses::course::{Family, of_campaign};
use emulator::Scenario;
use emulator::scenario::ScenarioObstacle;
use pipeline::{PipelineSettings, drive};
use shared_types::{CommandKind, Level};

fn shipped(name: &str) -> Scenario {
    Scenario::parse(Scenario::shipped(name).unwrap(), name).unwrap()
}

fn rest_of(settings: &PipelineSettings) -> WayToRest {
    WayToRest::new(&settings.scenario, settings.tuning.vehicle, settings.period_ns)
}

/// Drives to the end; returns the smallest clearance on a way to rest [m], and the commands per level.
fn driven(settings: &PipelineSettings) -> (f64, BTreeMap<u32, usize>) {
    let (mut rest, mut smallest_m, mut levels) = (rest_of(settings), f64::INFINITY, BTreeMap::new());
    drive(settings, |step| {
        smallest_m = smallest_m.min(rest.clearance(&step.truth));
        if let Some(command) = step.command {
            assert_eq!(command.kind == CommandKind::Drive.wire(), command.level != Level::Stop.wire());
            *levels.entry(command.level).or_default() += 1;
        }
    })
    .unwrap();
    (smallest_m, levels)
}

#[test]
fn every_command_of_random_courses_leaves_a_way_to_rest() {
    // In the last three a body moves into the robot, which rests.
    let first = |family: &Family| (0..400).filter(|seed| of_campaign(*seed).0 == *family).take(6).collect();
    for seed in Family::ALL.iter().flat_map::<Vec<u64>, _>(first).chain([260, 262, 452]) {
        let (family, scenario) = of_campaign(seed);
        let (smallest_m, _) = driven(&PipelineSettings::of(scenario));
        assert!(smallest_m > 0.0, "{} seed {seed}: {smallest_m} m", family.name());
    }
}

#[test]
fn plans_that_converged_best_ones_and_stops_occur_in_drives_and_leave_a_way_to_rest() {
    let mut reached = BTreeMap::new();
    for iterations in [1, 2, 60] {
        for name in ["corridor", "slalom", "noisy", "crossing", "sudden"] {
            let mut settings = PipelineSettings::of(shipped(name));
            settings.tuning.controller.budget_iterations = iterations;
            let (smallest_m, levels) = driven(&settings);
            assert!(smallest_m > 0.0, "{name} with {iterations}: {smallest_m} m");
            levels.into_iter().for_each(|(level, count)| *reached.entry(level).or_insert(0) += count);
        }
    }
    // The rest of the last plan is driven only when every other plan fails: the tests of the controller inject that.
    for level in [Level::Stop, Level::Converged, Level::BestIterate] {
        assert!(reached.contains_key(&level.wire()), "{level:?} of {reached:?}");
    }
}

#[test]
fn a_robot_that_drives_at_a_body_too_fast_has_no_way_to_rest() {
    let mut scenario = shipped("free");
    let shape = of_campaign(0).1.obstacles[0].shape;
    scenario.obstacles = vec![ScenarioObstacle::fixed(shape, 2.0, 0.0)];
    let settings = PipelineSettings::of(scenario);
    let mut rest = rest_of(&settings);
    let mut truth = shared_types::Truth { x_m: 1.0, speed_mps: 0.3, ..shared_types::Truth::default() };
    assert!(rest.clearance(&truth) > 0.0);
    truth.speed_mps = 3.0;
    assert!(rest.clearance(&truth) <= 0.0);
}
