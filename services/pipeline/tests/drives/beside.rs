//! Bodies that come from the side, where no body is ahead, and scanners that are turned.

use emulator::Outcome;
use emulator::scenario::Preset;
use pipeline::{PipelineSettings, Tuning};
use vehicle::{Description, ScannerDescription};

use crate::{end, parse, seeds, shipped};

/// A cart that drives beside the robot and comes into its way: place ahead and velocity [m, m/s].
fn merging(seed: u64, side: f64, [x_m, ahead_mps, across_mps]: [f64; 3]) -> String {
    let preset = ["ideal", "summit"][(seed % 2) as usize];
    let (y_m, across_mps) = (1.4 * side, -across_mps * side);
    format!(
        "name = \"merging\"\nseed = {seed}\n[goal]\nx_m = 12.0\n[robot]\npreset = \"{preset}\"\n[[obstacle]]\nshape = \"box\"\n\
         x_m = {x_m:?}\ny_m = {y_m:?}\nlength_m = 0.4\nwidth_m = 0.3\nvelocity_x_mps = {ahead_mps:?}\n\
         velocity_y_mps = {across_mps:?}\n"
    )
}

#[test]
fn a_cart_that_comes_from_the_side_is_not_driven_into() {
    for motion in [[0.25, 0.9, 0.2], [0.0, 0.95, 0.2], [-0.3, 1.0, 0.2], [0.25, 0.85, 0.2], [0.1, 0.9, 0.3]] {
        for side in [1.0, -1.0] {
            for (seed, end) in
                seeds::each(1..=4, |seed| end(&PipelineSettings::of(parse(&merging(seed, side, motion)))))
            {
                assert_ne!(end.outcome, Outcome::Collision, "{motion:?}, side {side}, seed {seed}: {end:?}");
            }
        }
    }
}

#[test]
fn a_scanner_that_is_turned_as_far_as_allowed_finds_what_is_ahead() {
    for yaw_rad in [1.04, -1.04] {
        for (seed, end) in seeds::each(1..=3, |seed| {
            let mut scenario = shipped("corridor");
            (scenario.seed, scenario.robot.scanner_yaw_rad) = (seed, Some(yaw_rad));
            let mut settings = PipelineSettings::of(scenario);
            let vehicle = Description { scanner_yaw_rad: yaw_rad, ..settings.tuning.vehicle };
            settings.tuning = Tuning::of(vehicle);
            end(&settings)
        }) {
            assert!(end.is_untouched() && end.outcome == Outcome::Reached, "{yaw_rad}, seed {seed}: {end:?}");
        }
    }
}

/// 1,081 beams over 270 degrees and 10 m, and 360 all around and 3.5 m.
fn scanners() -> [ScannerDescription; 2] {
    let of = |beams, degrees: f64, range_m, sweep_share| ScannerDescription {
        beams,
        increment_rad: degrees.to_radians(),
        range_m,
        sweep_share,
        ..ScannerDescription::default()
    };
    [of(1081, 0.25, 10.0, 0.75), of(360, 1.0, 3.5, 1.0)]
}

#[test]
fn a_robot_with_another_scanner_reaches_its_goal() {
    for (scanner, preset) in
        scanners().into_iter().flat_map(|scanner| [(scanner, Preset::Ideal), (scanner, Preset::Summit)])
    {
        for (seed, end) in seeds::each(1..=3, |seed| {
            let mut scenario = shipped("corridor");
            (scenario.seed, scenario.robot.preset, scenario.robot.scanner) = (seed, preset, scanner.into());
            // Walls that the shorter range sees: without any, the scanner might be blind.
            scenario.track.y_m = [-1.0, 1.0];
            let mut settings = PipelineSettings::of(scenario);
            settings.tuning = Tuning::of(Description { scanner, ..settings.tuning.vehicle });
            end(&settings)
        }) {
            let beams = scanner.beams;
            assert!(
                end.is_untouched() && end.outcome == Outcome::Reached,
                "{beams} {preset:?} {seed}: {end:?}"
            );
        }
    }
}
