//! Hostile courses that were driven badly once.

use courses::course::hostile::{Hostile, hostile};
use emulator::scenario::Preset;
use emulator::{Outcome, Scenario};
use pipeline::PipelineSettings;

use crate::{End, end};

fn drive(family: Hostile, seed: u64) -> End {
    let mut scenario: Scenario = hostile(family, seed).scenario;
    scenario.robot.preset = Preset::Summit;
    end(&PipelineSettings::of(scenario))
}

#[test]
fn a_slow_body_whose_velocity_becomes_uncertain_near_the_robot_is_not_driven_into() {
    let end = drive(Hostile::Crossing, 140);
    assert!(end.outcome == Outcome::Reached && end.is_untouched(), "{end:?}");
}

#[test]
fn a_robot_in_the_way_of_a_crossing_body_gets_out_of_it() {
    for seed in [117, 20_050] {
        let end = drive(Hostile::Crossing, seed);
        assert!(end.outcome == Outcome::Reached && end.is_untouched(), "{seed}: {end:?}");
    }
}

#[test]
fn the_robot_swings_out_for_a_goal_behind_an_obstacle() {
    for (family, seed) in [(Hostile::Anywhere, 20_064), (Hostile::Width, 20_184), (Hostile::Turned, 20_247)] {
        let end = drive(family, seed);
        assert!(end.outcome == Outcome::Reached && end.is_untouched(), "{family} {seed}: {end:?}");
    }
}
