//! The controller of the source, `[controller] profile = "source"`, in the shipped scenarios.

use emulator::Outcome;
use emulator::scenario::Preset;
use pipeline::{PipelineSettings, Tuning, drive, profile};

use crate::presets::{expected, names};
use crate::{End, end, seeds, shipped};

/// The settings of the profile, with more keys of `[controller]`.
fn tuning(keys: &str) -> Tuning {
    let mut system = format!("[controller]\nprofile = \"source\"\n{keys}").parse().unwrap();
    profile::add(&mut system);
    system.try_into().unwrap()
}

fn settings(name: &str, preset: Preset, seed: u64, keys: &str) -> PipelineSettings {
    let mut scenario = shipped(name);
    (scenario.robot.preset, scenario.seed, scenario.stop_final_s) = (preset, seed, 1.0);
    PipelineSettings { tuning: tuning(keys), ..PipelineSettings::of(scenario) }
}

/// The source drives forwards only: here it has to touch nothing, and may stop or miss the goal.
const REVERSED: [&str; 4] = ["dead-end", "park-parallel", "park-perpendicular", "u-turn"];

/// Drives all scenarios; the seeds in which one is touched or ends otherwise than it should.
fn assert_outcomes(preset: Preset) {
    for name in names() {
        let is_wrong = |end: &End| !REVERSED.contains(&name) && end.outcome != expected(name);
        let wrong = |(_, end): &(u64, End)| is_wrong(end) || end.clearance_m < 0.05;
        let ends = seeds::each(1..=5, |seed| end(&settings(name, preset, seed, "")));
        let wrong: Vec<_> = ends.into_iter().filter(wrong).collect();
        assert!(wrong.is_empty(), "{name}: {wrong:?}");
    }
}

#[test]
fn the_controller_of_the_source_ends_every_scenario_with_an_ideal_robot_as_it_should() {
    assert_outcomes(Preset::Ideal);
}

#[test]
fn the_controller_of_the_source_ends_every_scenario_with_a_believable_robot_as_it_should() {
    assert_outcomes(Preset::Summit);
}

#[test]
fn a_centred_box_is_passed_on_the_side_of_the_key() {
    for (side, left) in [("left", true), ("right", false), ("nearest", true)] {
        let (mut highest, mut lowest) = (0.0_f64, 0.0_f64);
        let settings = settings("corridor", Preset::Ideal, 1, &format!("side = \"{side}\""));
        let drive = drive(&settings, |step| {
            (highest, lowest) = (highest.max(step.truth.y_m), lowest.min(step.truth.y_m));
        });
        assert_eq!(drive.unwrap().outcome, Outcome::Reached, "{side}");
        assert_eq!(highest > 0.8, left, "{side}: {lowest} to {highest}");
        assert_eq!(lowest < -0.8, !left, "{side}: {lowest} to {highest}");
    }
}

/// The box at y = -0.3 can't be passed on its right after one on its right at y = 0.3.
#[test]
fn sides_that_the_robot_cannot_steer_end_in_a_stop_before_the_obstacle() {
    for (name, side) in [("two-obstacles", "right"), ("long", "left")] {
        let end = end(&settings(name, Preset::Ideal, 1, &format!("side = \"{side}\"")));
        assert!(end.outcome == Outcome::Stopped && end.clearance_m > 0.3, "{name}: {end:?}");
    }
}
