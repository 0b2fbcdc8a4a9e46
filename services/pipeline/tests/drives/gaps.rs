//! Gaps that a robot fits through, eight metres ahead of a start in the middle of the track.

use emulator::noise::{NoiseStream, Purpose};
use emulator::scenario::{Preset, ScenarioObstacle, Shape};
use emulator::{Outcome, Scenario};
use obstacles::CoverRule;
use pipeline::PipelineSettings;

use crate::{End, end, parse, seeds};

/// Width of the body [m].
const BODY_M: f64 = 0.4;

fn scenario(preset: Preset, seed: u64) -> Scenario {
    let mut scenario = parse("name = \"gap\"\ntimeout_s = 90.0\nstop_final_s = 1.0\n[goal]\nx_m = 16.0\n");
    (scenario.robot.preset, scenario.seed) = (preset, seed);
    scenario
}

/// A box from the right to the left edge.
pub(crate) fn block(depth_m: f64, [right_m, left_m]: [f64; 2]) -> ScenarioObstacle {
    let shape = Shape::Box { length_m: depth_m, width_m: left_m - right_m, yaw_rad: 0.0 };
    ScenarioObstacle::fixed(shape, 8.0, f64::midpoint(right_m, left_m))
}

/// Two boxes that close the track but for a gap, whose centre the seed draws from |y| <= 0.5 m.
pub(crate) fn gap(preset: Preset, width_m: f64, depth_m: f64, seed: u64) -> Scenario {
    let centre = NoiseStream::new(seed, Purpose::Placement, 0).between(-0.5, 0.5);
    let [right, left] = [centre - width_m / 2.0, centre + width_m / 2.0];
    let mut scenario = scenario(preset, seed);
    scenario.obstacles = vec![block(depth_m, [right - 1.6, right]), block(depth_m, [left, left + 1.6])];
    scenario
}

/// Passes when at least 95 % of the drives reach the goal and none touches anything.
fn assert_passed(preset: Preset, width_m: f64, depth_m: f64, drives: u64) {
    let ends =
        seeds::each(1..=drives, |seed| end(&PipelineSettings::of(gap(preset, width_m, depth_m, seed))));
    let stopped: Vec<_> = ends.iter().filter(|(_, end)| end.outcome != Outcome::Reached).collect();
    assert!(20 * stopped.len() as u64 <= drives, "{preset:?}, {width_m} m: {stopped:?}");
    let touched: Vec<_> = ends.iter().filter(|(_, end)| !end.is_untouched()).collect();
    assert!(touched.is_empty(), "{preset:?}, {width_m} m: {touched:?}");
}

#[test]
fn an_ideal_robot_drives_through_a_gap_of_its_body_and_35_centimetres() {
    assert_passed(Preset::Ideal, BODY_M + 0.35, 0.1, 40);
}

#[test]
fn a_believable_robot_drives_through_a_gap_of_its_body_and_50_centimetres() {
    assert_passed(Preset::Summit, BODY_M + 0.5, 0.1, 40);
}

#[test]
#[ignore = "200 drives"]
fn a_hundred_robots_drive_through_these_gaps() {
    assert_passed(Preset::Ideal, BODY_M + 0.35, 0.1, 100);
    assert_passed(Preset::Summit, BODY_M + 0.5, 0.1, 100);
}

#[test]
fn boxes_of_half_a_metre_depth_leave_the_same_gaps() {
    assert_passed(Preset::Ideal, BODY_M + 0.35, 0.5, 20);
    assert_passed(Preset::Summit, BODY_M + 0.5, 0.5, 20);
}

#[test]
fn centred_boxes_and_a_gap_of_120_centimetres_are_passed_at_every_seed() {
    for (preset, depth_m) in [Preset::Ideal, Preset::Summit].into_iter().flat_map(|it| [(it, 0.1), (it, 0.5)])
    {
        let reached = |end: &End| end.outcome == Outcome::Reached && end.clearance_m > 0.15;
        for width_m in [1.1, 1.4, 1.6] {
            for (seed, end) in seeds::each(1..=2, |seed| {
                let mut scenario = scenario(preset, seed);
                scenario.obstacles = vec![block(depth_m, [-width_m / 2.0, width_m / 2.0])];
                end(&PipelineSettings::of(scenario))
            }) {
                assert!(reached(&end), "{preset:?}, box of {width_m} m, seed {seed}: {end:?}");
            }
        }
        for (seed, end) in
            seeds::each(1..=2, |seed| end(&PipelineSettings::of(gap(preset, 1.2, depth_m, seed))))
        {
            assert!(reached(&end), "{preset:?}, gap, seed {seed}: {end:?}");
        }
    }
}

/// (7.35) uses the whole width plus 2 theta as a semi-axis, which closes the gap.
#[test]
fn the_ellipses_of_the_source_close_the_same_gap() {
    for (seed, end) in seeds::each(1..=10, |seed| {
        let mut settings = PipelineSettings::of(gap(Preset::Ideal, BODY_M + 0.5, 0.1, seed));
        settings.tuning.obstacles.cover = CoverRule::Source;
        end(&settings)
    }) {
        let stopped = end.outcome == Outcome::Stopped && end.reason.ends_with("blocked");
        assert!(stopped && end.clearance_m > 0.5, "seed {seed}: {end:?}");
    }
}
