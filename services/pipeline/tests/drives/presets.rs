//! Every shipped scenario with every preset.

use std::ops::RangeInclusive;

use emulator::scenario::Preset;
use emulator::{Outcome, Scenario};
use pipeline::{PipelineSettings, drive};

use crate::{End, end, seeds, shipped};

/// What a scenario is shipped for.
pub(crate) fn expected(name: &str) -> Outcome {
    if ["blocked", "sudden"].contains(&name) { Outcome::Stopped } else { Outcome::Reached }
}

/// All but the one without an end, and those that name a system of their own, which only the executable reads.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    Scenario::names().filter(|name| *name != "endless" && shipped(name).system.is_none())
}

fn ends(name: &str, preset: Preset, seeds: RangeInclusive<u64>) -> Vec<(u64, End)> {
    seeds::each(seeds, |seed| {
        let mut scenario = shipped(name);
        (scenario.robot.preset, scenario.seed) = (preset, seed);
        // A robot that rests for a second does not start again in these scenarios, unless it backs out.
        scenario.stop_final_s = if name == "dead-end" { scenario.stop_final_s } else { 1.0 };
        end(&PipelineSettings::of(scenario))
    })
}

/// Drives all scenarios; the seeds in which one is touched or ends otherwise.
fn assert_outcomes(preset: Preset, seeds: RangeInclusive<u64>) {
    for name in names() {
        let wrong = |(_, end): &(u64, End)| end.outcome != expected(name) || end.clearance_m < 0.05;
        let wrong: Vec<_> = ends(name, preset, seeds.clone()).into_iter().filter(wrong).collect();
        assert!(wrong.is_empty(), "{name}: {wrong:?}");
    }
}

fn assert_untouched(seeds: RangeInclusive<u64>) {
    for name in names() {
        let touched = |(_, end): &(u64, End)| !end.is_untouched();
        let touched: Vec<_> = ends(name, Preset::Worn, seeds.clone()).into_iter().filter(touched).collect();
        assert!(touched.is_empty(), "{name}: {touched:?}");
    }
}

#[test]
fn an_ideal_robot_ends_every_scenario_as_it_should() {
    assert_outcomes(Preset::Ideal, 1..=6);
}

#[test]
fn a_believable_robot_ends_every_scenario_as_it_should() {
    assert_outcomes(Preset::Summit, 1..=6);
}

#[test]
fn a_worn_robot_touches_nothing() {
    assert_untouched(1..=6);
}

#[test]
#[ignore = "880 drives"]
fn twenty_robots_end_every_scenario_as_they_should() {
    assert_outcomes(Preset::Ideal, 1..=20);
    assert_outcomes(Preset::Summit, 1..=20);
}

#[test]
#[ignore = "2200 drives"]
fn two_hundred_worn_robots_touch_nothing() {
    assert_untouched(1..=200);
}

#[test]
fn a_slow_robot_passes_an_obstacle_without_creeping() {
    let mut settings = PipelineSettings::of(shipped("corridor"));
    settings.tuning.controller.cruise_mps = 0.5;
    let (mut driven, mut last, mut step_rad) = (Vec::new(), None::<f64>, 0.0_f64);
    let end = drive(&settings, |step| {
        if let Some(command) = step.command.filter(|command| command.velocity_mps > 0.0) {
            step_rad = step_rad.max(last.map_or(0.0, |last| (command.steering_rad - last).abs()));
            last = Some(command.steering_rad);
            driven.push(command.velocity_mps);
        }
    })
    .unwrap();
    assert_eq!(end.outcome, Outcome::Reached, "{}", end.reason);
    // Half of the way lies behind the obstacle, and the landing takes the last second.
    let slowest = driven[5..driven.len() - 40].iter().copied().fold(1.0, f64::min);
    let fastest = driven.iter().copied().fold(0.0, f64::max);
    assert!(slowest > 0.4 && fastest < 0.6 && step_rad < 0.02, "{slowest} to {fastest} m/s, {step_rad} rad");
}
